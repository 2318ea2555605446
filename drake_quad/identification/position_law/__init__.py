"""Identification of the position law that flew a log."""
