"""Diagrams compiled to machine code."""
