"""Sensors on board: a measurement equation for each, and one system that samples it."""
