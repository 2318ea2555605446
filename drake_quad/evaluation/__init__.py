"""Comparison of tuned controllers by one protocol, and a report."""
