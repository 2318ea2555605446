"""Simulation of fleets in one diagram, by Drake's simulator."""
