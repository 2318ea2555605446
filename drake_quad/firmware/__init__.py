"""Firmware of flight controllers, which flies in lockstep with the simulation."""
