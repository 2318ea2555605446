"""Flights in three dimensions, live or as a page that any browser replays."""
