"""Readers of scenario files and of the files to which they refer."""
