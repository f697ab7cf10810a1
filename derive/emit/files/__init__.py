"""The files of a generation: one family of files a module."""
