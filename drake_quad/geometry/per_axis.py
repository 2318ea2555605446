"""Named tuples with one value for each axis, or for each angle."""

from typing import Literal, NamedTuple

from drake_quad.signals import Row

Axis = Literal["x", "y", "z"]


class PerAxis(NamedTuple):
    """Values for the axes X, Y and Z of W, for example gains."""

    x: Row
    y: Row
    z: Row


class PerAngle(NamedTuple):
    """Values for roll, pitch and yaw, for example gains."""

    roll: Row
    pitch: Row
    yaw: Row
