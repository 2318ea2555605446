"""Identification of vehicles from flight logs, and prediction of flights."""
