"""Trained policies: networks, their observations, and the meaning of their actions."""
