"""Policies of the scenario language: trained networks and what they see."""
