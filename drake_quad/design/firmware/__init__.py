"""Conversion of a vehicle's firmware parameters to controllers of the scenario language."""
