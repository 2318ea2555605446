"""Attitudes, axes and the differential flatness of a quadrotor."""
