"""Base classes of the routes, and their registry `ROUTES`.

To add a route, extend `MissionRoute` and register the class with `ROUTES.register`.
"""

from abc import abstractmethod
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from drake_quad.reference.laps import LapDurations
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.path_problem import PathLimits, PathProblem
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.routes import Route
from drake_quad.reference.time_allocation import stretch_factor, trapezoid_times
from drake_quad.reference.yaw import constant_yaw, yaw_along_path
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.quantities import Direction, Positive
from drake_quad.scenario.unions import OpenUnion
from drake_quad.space.space import Space

Laps = Annotated[int, Field(ge=1, le=100)]
KnownEnd = tuple[tuple[str | int, ...], float | None]
"""Path of the field of a scenario that determines the end time of its route, and this time, s."""


class PlannedRoute(NamedTuple):
    """Plan of a route, and the planning problem that it solves.

    Attributes:
        plan: plan to fly.
        problem: planning problem, including corridors around obstacles, for a route through waypoints; None for other
            routes.
        waypoints: (waypoints,) index of each waypoint of the route in the waypoints of `problem`, which also contain
            detours; None unless the path was planned around obstacles.
        space: space in which the path was planned, if there is one.
    """

    plan: Plan
    problem: PathProblem | None = None
    waypoints: np.ndarray | None = None
    space: Space | None = None


class MissionRoute(Model):
    """Route of a mission. Its methods require a route without distributions."""

    kind: str

    def known_end_time(self) -> KnownEnd:
        """Return the field that sets the end time of the route, and this time (s), or None if it must be planned."""
        return ("route",), None

    def limits(self) -> PathLimits:
        """Return the limits of speed and acceleration of the planned path."""
        return PathLimits()

    @abstractmethod
    def plan(self, space: Space | None) -> PlannedRoute:
        """Return the plan of the route.

        The caller checks the plan for obstacles, rotor limits and duration.

        Args:
            space: space with obstacles, which some routes can avoid; None if there are no obstacles.

        Raises:
            InputError: if no path satisfies the constraints of the route, or none avoids the obstacles.
        """


ROUTES = OpenUnion(MissionRoute)
"""Registry of the kinds of routes."""

AnyRoute = Annotated[MissionRoute, ROUTES]


class MovingRoute(MissionRoute):
    """Route with limits on speed and acceleration."""

    yaw: Annotated[Direction, needs("heading", value="constant")] = Field(
        default=0.0, description="yaw of the reference, for heading: constant (rad)"
    )
    heading: Literal["constant", "along_path"] = Field(
        default="constant", description="rule for the yaw; along_path sets the yaw to the direction of the velocity"
    )
    top_speed: Positive = Field(default=2.0, description="limit on the speed (m/s); the default is the paper's")
    top_acceleration: Positive = Field(
        default=0.7, description="limit on the acceleration (m/s²); the default is the paper's"
    )

    def limits(self) -> PathLimits:
        """Return the limits of speed and acceleration of the planned path."""
        # A subclass may allow None, which means that there is no limit.
        specified = {"speed": self.top_speed, "acceleration": self.top_acceleration}
        return PathLimits(**{name: limit for name, limit in specified.items() if limit is not None})

    def yaw_profile(self, path: PolynomialPath) -> PolynomialPath:
        """Return the yaw of the reference along a path."""
        return (
            yaw_along_path(path)
            if self.heading == "along_path"
            else constant_yaw(path.times[0], path.times[-1], self.yaw)
        )

    def scaled_in_time(self, geometry: Route, cruise_speed: float) -> Plan:
        """Return the plan through given waypoints, scaled in time until it meets one of the limits exactly.

        Args:
            geometry: waypoints and legs.
            cruise_speed: top speed of the trapezoidal profile that determines the times before scaling, m/s.
        """
        times = trapezoid_times(geometry.waypoints, speed=cruise_speed, acceleration=self.top_acceleration)
        path = minimum_snap(geometry.waypoints, times)
        path = path.scaled_in_time(stretch_factor(path, self.limits()))
        return Plan(path, self.yaw_profile(path), geometry.legs)


def split_three_laps(durations: np.ndarray, segments: int) -> LapDurations:
    """Return the durations of the first, a middle and the last of three laps, s.

    Args:
        durations: durations of all segments, including those before the first lap, s.
        segments: number of segments of a lap.
    """
    first, between, last = np.split(durations, [len(durations) - 2 * segments, len(durations) - segments])
    return LapDurations(first, between, last)
