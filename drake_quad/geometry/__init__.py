"""Vectors, attitudes, kinematics and differential flatness."""
