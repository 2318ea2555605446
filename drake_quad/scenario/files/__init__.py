"""Readers of scenario files, and of the files that they name."""
