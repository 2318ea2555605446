"""Fuzzy networks of the scenario language, which learn in flight."""
