"""Comparison of controllers by one protocol: equal budgets and limits of tuning, and the same samples."""
