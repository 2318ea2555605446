"""Conversion of attitudes to rotations, for many samples at once."""

import numpy as np
import scipy


def rotations(attitude: np.ndarray) -> "scipy.spatial.transform.Rotation":
    """Return the rotations from body to world of roll, pitch and yaw (3,) or (n, 3) in rad."""
    return scipy.spatial.transform.Rotation.from_euler("ZYX", attitude[..., ::-1])
