"""Identification of the position control law from the log of a flight under this law."""
