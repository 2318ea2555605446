"""Surroundings of the vehicle: motion capture, command link, wind, flight monitor."""
