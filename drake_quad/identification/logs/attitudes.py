"""Attitudes of many samples at once, as rotation matrices."""

import numpy as np

_MIN_SINC = 1e-3  # keeps the vector of half a turn finite


def rotation_matrices(attitude: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (n, 3, 3) from body to world of roll, pitch and yaw (n, 3) in rad."""
    (c_r, c_p, c_y), (s_r, s_p, s_y) = np.cos(attitude).T, np.sin(attitude).T
    rows = (
        (c_y * c_p, c_y * s_p * s_r - s_y * c_r, c_y * s_p * c_r + s_y * s_r),
        (s_y * c_p, s_y * s_p * s_r + c_y * c_r, s_y * s_p * c_r - c_y * s_r),
        (-s_p, c_p * s_r, c_p * c_r),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def rotation_vectors(rotation: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (n, 3) in rad of rotation matrices (n, 3, 3), whose angles are below π."""
    cosine = 0.5 * (np.trace(rotation, axis1=1, axis2=2) - 1.0)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    twice_sine = np.column_stack([rotation[:, k, j] - rotation[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))])
    return twice_sine * (0.5 / np.maximum(np.sinc(angle / np.pi), _MIN_SINC))[:, np.newaxis]
