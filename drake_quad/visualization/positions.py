"""Positions of vehicles and references as arrays."""

import numpy as np

from drake_quad.signals import Reference, State


def positions(signal: State | Reference) -> np.ndarray:
    """Return the positions (n, 3) in a signal with n instants, or the position (3,) in a single instant, m."""
    return np.stack([signal.x, signal.y, signal.z], axis=-1)


def coordinates_by_axis(signal: State | Reference) -> dict[str, np.ndarray]:
    """Return the coordinates of a signal by axis, each (n,), m."""
    return {axis: np.asarray(getattr(signal, axis)) for axis in "xyz"}
