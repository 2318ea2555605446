"""Records with one number for each axis, or for each angle."""

from typing import Literal, NamedTuple

from drake_quad.signals import Row

Axis = Literal["x", "y", "z"]


class PerAxis(NamedTuple):
    """Numbers for the axes of W, such as gains."""

    x: Row
    y: Row
    z: Row


class PerAngle(NamedTuple):
    """Numbers for roll, pitch and yaw, such as gains."""

    roll: Row
    pitch: Row
    yaw: Row
