"""Experiments with many flights, claims with verdicts, and reports with figures."""
