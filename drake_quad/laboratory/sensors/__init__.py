"""Sensors on board beside motion capture: each is a law, which one system samples."""
