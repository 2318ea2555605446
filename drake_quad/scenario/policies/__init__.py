"""Policies in the scenario language: trained networks and their observations."""
