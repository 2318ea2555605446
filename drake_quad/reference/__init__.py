"""The reference: minimum snap, routes, time allocation, feasibility."""
