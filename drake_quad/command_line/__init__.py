"""The command `drake-quad`, and all that is printed."""
