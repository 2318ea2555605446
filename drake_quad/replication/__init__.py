"""Replication of the paper: its experiment, its claims, and a report."""
