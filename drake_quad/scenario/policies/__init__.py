"""Policies of the scenario language: trained networks and their observations."""
