"""Adaptive fuzzy networks, whose output corrects the command of a controller."""
