"""Readers of flight logs, which convert a log to a `FlightRecord`."""
