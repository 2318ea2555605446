"""Models of everything around the vehicle: motion capture, sensors, command link, wind and flight monitor."""
