"""Identification of vehicles and position laws from flight logs, and prediction of logged flights."""
