"""Comparison of logged flights with predictions, in open loop or under a controller."""
