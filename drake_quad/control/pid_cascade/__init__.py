"""Cascades of PIDs on position and velocity, as flight controllers have them."""
