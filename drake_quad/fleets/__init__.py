"""Simulation of fleets in one diagram with Drake's simulator."""
