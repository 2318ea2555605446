"""Fuzzy networks that learn in flight, in the scenario language."""
