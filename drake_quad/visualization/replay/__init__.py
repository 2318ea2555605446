"""Flights in three dimensions: live in a browser, or as a page that any browser replays."""
