"""Attitudes of many samples at once, as rotations."""

import numpy as np
from scipy.spatial.transform import Rotation


def rotations(attitude: np.ndarray) -> Rotation:
    """Return the rotations from body to world of roll, pitch and yaw (n, 3) in rad."""
    return Rotation.from_euler("ZYX", attitude[:, ::-1])
