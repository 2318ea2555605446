"""The command `drake-quad` and its output."""
