"""Compilation of diagrams to machine code.

Throughout this package,

- a row contains one number for each vehicle of a fleet: one component of a port, state or parameter;
- a vector consists of the vehicles that the machine code computes at once in one SIMD register, each in its own lane;
- an instant is a multiple of the shortest period of a diagram, and a cycle is the least common multiple of all periods;
- an event is compiled code that simulates one instant or several.
"""
