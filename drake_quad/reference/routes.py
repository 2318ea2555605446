"""Routes: where to fly. When to be where is a matter of `time_allocation`."""

import math
from typing import NamedTuple

import numpy as np


class Leg(NamedTuple):
    """A named part of a route.

    Attributes:
        name: what the vehicle does on it.
        first: index of the waypoint at which it begins.
    """

    name: str
    first: int


class Route(NamedTuple):
    """Waypoints in W.

    Attributes:
        waypoints: (segments + 1, 3), m.
        legs: in order, the first one at waypoint 0.
    """

    waypoints: np.ndarray
    legs: tuple[Leg, ...]


# Waypoints on a circle are at most this far apart; minimum snap then stays within 1 % of the radius of it.
_ARC = math.radians(46.0)


def figure_eight(
    *, lower_height: float = 1.0, upper_height: float = 2.0, radius: float = 1.4, offset: float = 1.9
) -> Route:
    """Returns the paper's route: two circles in opposite senses, one above the other's height, and their tangents.

    From the ground up to the lower height; a straight climb along a tangent; a level circle; the other tangent back
    over the start and down; a level curve in the opposite sense; straight back to the start. The defaults give the
    extent of the paper's figures, about ±1.4 m by ±3.3 m.

    Args:
        lower_height: of the second circle and of the crossing at the end, m.
        upper_height: of the first circle, m.
        radius: of both circles, m.
        offset: of their centres from the start, along Y and against it; larger than the radius, m.
    """
    # Angle at the start between Y and a tangent; the circles sweep half a turn and twice this angle.
    tangent = math.asin(radius / offset)
    sweep = math.pi + 2.0 * tangent
    count = math.ceil(sweep / _ARC)
    angle = np.linspace(-tangent, sweep - tangent, count + 1)
    x, y = radius * np.cos(angle), offset + radius * np.sin(angle)
    upper = np.column_stack([x, y, np.full_like(x, upper_height)])
    lower = np.column_stack([x, -y, np.full_like(x, lower_height)])
    start = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, lower_height]])
    waypoints = np.vstack([start, upper, [[0.0, 0.0, upper_height]], lower, start[1:]])
    crossing = 2 + len(upper)
    half = crossing + 1 + count // 2
    legs = (
        Leg("rise", 0),
        Leg("climb", 1),
        Leg("circle", 2),
        Leg("straight", crossing - 1),
        Leg("descent", crossing),
        Leg("turn", crossing + 1),
        Leg("curve", half),
        Leg("return", len(waypoints) - 2),
    )
    return Route(waypoints, legs)


def circle(*, radius: float, height: float, laps: int) -> Route:
    """Returns laps of a level circle about the Z axis of W, anticlockwise from the positive X axis.

    Args:
        radius: m.
        height: m.
        laps: number of full turns.
    """
    per_lap = math.ceil(math.tau / _ARC)
    angle = np.linspace(0.0, math.tau * laps, per_lap * laps + 1)
    waypoints = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, height)])
    return Route(waypoints, tuple(Leg(f"lap {i + 1}", i * per_lap) for i in range(laps)))
