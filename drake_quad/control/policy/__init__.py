"""Policies: networks that were trained, what they see, and what their actions mean."""
