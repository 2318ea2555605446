"""Surroundings of the vehicle: motion capture, command link, wind, and the monitor of a flight."""
