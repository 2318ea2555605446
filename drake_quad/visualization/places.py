"""Where something is, as arrays to draw."""

import numpy as np

from drake_quad.signals import Reference, State


def places(signal: State | Reference) -> np.ndarray:
    """The (n, 3) positions in a signal of n instants, or the (3,) position in that of one, m."""
    return np.stack([signal.x, signal.y, signal.z], axis=-1)


def place_by_axis(signal: State | Reference) -> dict[str, np.ndarray]:
    """The (n,) coordinates in a signal by the name of their axis, m."""
    return {axis: np.asarray(getattr(signal, axis)) for axis in "xyz"}
