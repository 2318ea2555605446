"""Comparison of controllers that are tuned by the same protocol, and a report."""
