"""Compilation of diagrams to machine code."""
