"""Trained policies: networks, their observations, and the conversion of their actions to commands."""
