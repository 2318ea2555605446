"""Readers of flight logs; each gives a `FlightRecord`."""
