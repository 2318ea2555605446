"""Attitudes, axes and differential flatness."""
