"""Obstacles, and planning of collision-free corridors between them."""
