"""Flights of a scenario: plan, simulation, recorded signals, export."""
