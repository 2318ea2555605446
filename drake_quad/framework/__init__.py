"""Base class of systems for fleets, and compilation of their formulas to machine code."""
