"""Adaptive fuzzy networks around a controller."""
