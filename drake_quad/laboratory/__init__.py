"""Surroundings of the vehicle: motion capture, sensors, command link, wind, flight monitor."""
