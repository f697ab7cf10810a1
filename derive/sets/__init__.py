"""Parameter, controller and plan files: read, completed, judged."""
