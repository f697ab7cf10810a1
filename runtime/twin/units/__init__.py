"""The control units that fly on the twin."""
