"""Positions as arrays for drawing."""

import numpy as np

from drake_quad.signals import Reference, State


def places(signal: State | Reference) -> np.ndarray:
    """Return the positions (n, 3) of a signal of n instants, or the position (3,) of a single instant, m."""
    return np.stack([signal.x, signal.y, signal.z], axis=-1)


def place_by_axis(signal: State | Reference) -> dict[str, np.ndarray]:
    """Return the coordinates (n,) of a signal by axis, m."""
    return {axis: np.asarray(getattr(signal, axis)) for axis in "xyz"}
