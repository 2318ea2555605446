"""Fleets in one diagram under Drake's simulator."""
