"""Attitudes as quaternions, for files of other programs."""

from typing import NamedTuple

import numpy as np


class Quaternion(NamedTuple):
    """Turns from B to W; (ticks,) arrays.

    Attributes:
        w: the scalar.
        x: along x of B and W.
        y: along y.
        z: along z.
    """

    w: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray

    @classmethod
    def of(cls, roll: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> "Quaternion":
        """Of a turn by yaw about z, then pitch about y, then roll about x, rad."""
        (c_r, s_r), (c_p, s_p), (c_y, s_y) = ((np.cos(half), np.sin(half)) for half in (roll / 2, pitch / 2, yaw / 2))
        return cls(
            c_r * c_p * c_y + s_r * s_p * s_y,
            s_r * c_p * c_y - c_r * s_p * s_y,
            c_r * s_p * c_y + s_r * c_p * s_y,
            c_r * c_p * s_y - s_r * s_p * c_y,
        )
