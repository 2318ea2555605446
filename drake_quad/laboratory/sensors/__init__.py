"""Sensors on board beside motion capture, each a system of its own with a port that is called after it."""
