"""Obstacles, and corridors between them."""
