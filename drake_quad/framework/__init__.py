"""Systems that carry fleets and say what they compute, and their formulas, from Python to machine code."""
