"""Flights of a scenario: plan, simulation, records and export."""
