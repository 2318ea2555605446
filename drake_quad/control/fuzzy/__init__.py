"""Fuzzy neural networks that learn in flight."""
