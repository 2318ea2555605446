"""Routes: sequences of waypoints without times, divided into named parts."""

import math
from typing import NamedTuple

import numpy as np


class Leg(NamedTuple):
    """Named part of a route.

    Attributes:
        name: name of the part, such as "climb".
        first: index of the waypoint at which the part begins.
    """

    name: str
    first: int


class Route(NamedTuple):
    """Waypoints in W.

    Attributes:
        waypoints: (segments + 1, 3) points in W, m.
        legs: named parts in order; the first part begins at waypoint 0.
    """

    waypoints: np.ndarray
    legs: tuple[Leg, ...]


# Largest angle between successive waypoints on a circle. The minimum-snap path then deviates from the circle by less
# than 1 % of its radius.
_MAX_ARC = math.radians(46.0)


def figure_eight(
    *, lower_height: float = 1.0, upper_height: float = 2.0, radius: float = 1.4, offset: float = 1.9
) -> Route:
    """Return the paper's route: two circles in opposite directions at different heights, and their tangents.

    The route leads from the ground up to the lower height, along a tangent to the upper height, and around the first
    circle. It returns along the other tangent, passes over the start, descends, follows the second circle in the
    opposite direction, and leads straight back to the point above the start. The defaults give the extent of the
    paper's figures, about ±1.4 m by ±3.3 m.

    Args:
        lower_height: height of the second circle and of the end of the route, m.
        upper_height: height of the first circle, m.
        radius: radius of both circles, m.
        offset: distance of the circles' centres from the start, in the directions of Y and -Y, m; larger than the
            radius.
    """
    # Angle between the Y axis and the tangent through the start. The path follows each circle for half a turn plus
    # twice this angle.
    tangent = math.asin(radius / offset)
    sweep = math.pi + 2.0 * tangent
    count = math.ceil(sweep / _MAX_ARC)
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
    """Return laps of a level circle around the Z axis of W, anticlockwise from the positive X axis.

    Args:
        radius: radius of the circle, m.
        height: height of the circle, m.
        laps: number of full turns.
    """
    per_lap = math.ceil(math.tau / _MAX_ARC)
    angle = np.linspace(0.0, math.tau * laps, per_lap * laps + 1)
    waypoints = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, height)])
    return Route(waypoints, tuple(Leg(f"lap {i + 1}", i * per_lap) for i in range(laps)))
