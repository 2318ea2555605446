"""Cascades of PIDs on position and velocity, as in flight controllers."""
