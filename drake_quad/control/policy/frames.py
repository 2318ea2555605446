"""Frames with a vertical z in which a policy sees and acts.

    world                W
    heading              W turned about Z by the vehicle's yaw, so that x points where the vehicle looks
    reference_heading    W turned about Z by the reference's yaw, so that x points where the vehicle should look

A policy that was trained to look along X does not know what to do at another yaw of the reference, unless it sees and
acts in `reference_heading`: there nothing changes when vehicle and reference are turned together about Z.
"""

from typing import Literal

from drake_quad.axes import BodyAxes
from drake_quad.signals import Angle

LevelFrame = Literal["world", "heading", "reference_heading"]


def level_axes(frame: LevelFrame, yaw: Angle, reference_yaw: Angle, turn: Angle) -> BodyAxes | None:
    """Return the axes of a frame in W; None for W itself.

    Args:
        frame: name of the frame.
        yaw: yaw of the vehicle, rad.
        reference_yaw: yaw of the reference, rad.
        turn: angle about Z by which `heading` and `reference_heading` are turned further, rad.
    """
    match frame:
        case "world":
            return None
        case "heading":
            return BodyAxes.of(0.0, 0.0, yaw + turn)
        case "reference_heading":
            return BodyAxes.of(0.0, 0.0, reference_yaw + turn)
