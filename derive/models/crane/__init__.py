"""The overhead crane: a force on a trolley moves a load that hangs from it."""
