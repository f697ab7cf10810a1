"""Machines and compilers: the host, emulated targets, and what builds for them."""
