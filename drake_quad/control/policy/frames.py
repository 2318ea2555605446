"""Coordinate frames with a vertical z axis for the observations and actions of a policy.

    world                W
    heading              W rotated about Z by the vehicle's yaw: x points along the heading of the vehicle
    reference_heading    W rotated about Z by the reference's yaw: x points along the heading of the reference

A policy that was trained with a reference at yaw 0 does not generalise to another yaw, unless its observations and
actions are in `reference_heading`. In this frame, they do not change when vehicle and reference are rotated together
about Z.
"""

from typing import Literal

from drake_quad.geometry.axes import BodyAxes
from drake_quad.signals import Angle

LevelFrame = Literal["world", "heading", "reference_heading"]


def level_axes(frame: LevelFrame, yaw: Angle, reference_yaw: Angle, turn: Angle) -> BodyAxes | None:
    """Return the axes of a frame in W; None for W itself.

    Args:
        frame: name of the frame.
        yaw: yaw of the vehicle, rad.
        reference_yaw: yaw of the reference, rad.
        turn: additional rotation of `heading` and `reference_heading` about Z, rad.
    """
    match frame:
        case "world":
            return None
        case "heading":
            return BodyAxes.of(0.0, 0.0, yaw + turn)
        case "reference_heading":
            return BodyAxes.of(0.0, 0.0, reference_yaw + turn)
