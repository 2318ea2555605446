"""Plots, drawings of diagrams, and replays."""
