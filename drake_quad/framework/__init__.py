"""Declared systems for fleets, and their formulas, from Python to machine code."""
