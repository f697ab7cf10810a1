"""The equations of the Pendubot's source, and what it says around them, one part a module."""
