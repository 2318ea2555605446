"""Sensors on board: their measurement equations, and the system that samples a measurement equation."""
