"""Compilation of diagrams to machine code.

Throughout this package, a row contains one number for each vehicle of a fleet: one component of a port, state or
parameter.
"""
