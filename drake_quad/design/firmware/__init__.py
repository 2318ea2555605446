"""Conversion of a vehicle's firmware parameters to controllers in the scenario language."""
