"""Wind: sources of moving air, each a system of its own, and their sum.

A source samples at every step of the vehicle and holds: what the vehicle feels from t to t + h is the air at t, at the
place where it was then; of a gust or a sine, which are known beforehand, that of t + h / 2.
"""
