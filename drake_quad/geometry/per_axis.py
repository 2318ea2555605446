"""Numbers for each axis."""

from typing import Literal, NamedTuple

from drake_quad.signals import Row

Axis = Literal["x", "y", "z"]


class PerAxis(NamedTuple):
    """A number for each axis of W."""

    x: Row
    y: Row
    z: Row


class PerAngle(NamedTuple):
    """A number for each angle."""

    roll: Row
    pitch: Row
    yaw: Row
