"""Jinja templates, one per generated file, by language: text and loops only."""
