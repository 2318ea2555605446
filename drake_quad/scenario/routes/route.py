"""Routes, and the questions about them that the rest of the library asks.

A route of your own is a class that extends `MissionRoute` and is registered with `ROUTES.member`.
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
from drake_quad.reference.yaw import constant_yaw, yaw_along
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Direction, Positive
from drake_quad.scenario.unions import OpenUnion
from drake_quad.space.space import Space

Laps = Annotated[int, Field(ge=1, le=100)]
KnownEnd = tuple[tuple[str | int, ...], float | None]
"""Path of a field of a scenario, and the time that it determines, s."""


class Planned(NamedTuple):
    """Plan of a route, and the problem that it solves.

    Attributes:
        plan: plan to fly.
        problem: problem that the path of a route through waypoints solves, with the corridors around obstacles if
            there are any.
        waypoints: (waypoints,) indices of the route's waypoints among those of the problem, without repeats; None
            unless the path was planned around the obstacles of a space.
        space: space in which the path was planned, if there is one.
    """

    plan: Plan
    problem: PathProblem | None = None
    waypoints: np.ndarray | None = None
    space: Space | None = None


class MissionRoute(Model):
    """Route of a mission. The methods are called for a route without distributions."""

    kind: str

    def known_end(self) -> KnownEnd:
        """Return the field that determines the end of the route, and this time, s; None if a plan determines it."""
        return ("route",), None

    def limits(self) -> PathLimits:
        """Return the limits of the path."""
        return PathLimits()

    @abstractmethod
    def plan(self, space: Space | None) -> Planned:
        """Return the plan of the route, in a space if there are obstacles.

        Obstacles, rotors and the duration are checked for all routes. Only a route that can be led around obstacles
        needs the space.

        Raises:
            InputError: no path satisfies the constraints of the route, or the obstacles leave no way.
        """


ROUTES = OpenUnion(MissionRoute)
"""Kinds of routes."""

AnyRoute = Annotated[MissionRoute, ROUTES]


class MovingRoute(MissionRoute):
    """Route that moves, with limits on its path."""

    yaw: Direction = Field(default=0.0, description="yaw of the reference where the heading is constant (rad)")
    heading: Literal["constant", "along_path"] = Field(
        default="constant", description="what the yaw follows; along_path looks where the path goes"
    )
    top_speed: Positive = Field(default=2.0, description="limit on the speed (m/s); the paper's 2 m/s")
    top_acceleration: Positive = Field(
        default=0.7, description="limit on the acceleration (m/s²); the paper's 0.7 m/s²"
    )

    def limits(self) -> PathLimits:
        """Return the limits of the path; the route holds no distributions."""
        given = {"speed": self.top_speed, "acceleration": self.top_acceleration}
        return PathLimits(**{name: limit for name, limit in given.items() if limit is not None})

    def yaw_of(self, path: PolynomialPath) -> PolynomialPath:
        """Return the yaw along a path."""
        return (
            yaw_along(path) if self.heading == "along_path" else constant_yaw(path.times[0], path.times[-1], self.yaw)
        )

    def stretched(self, geometry: Route, cruise_speed: float) -> Plan:
        """Return the plan along a geometry that meets one of the limits exactly.

        Args:
            geometry: waypoints and legs.
            cruise_speed: speed by which the times are first shared out among the waypoints, m/s.
        """
        times = trapezoid_times(geometry.waypoints, speed=cruise_speed, acceleration=self.top_acceleration)
        path = minimum_snap(geometry.waypoints, times)
        path = path.stretched(stretch_factor(path, self.limits()))
        return Plan(path, self.yaw_of(path), geometry.legs)


def of_three_laps(durations: np.ndarray, segments: int) -> LapDurations:
    """Return the durations of three laps of so many segments; the first one includes the way to the lap."""
    first, between, last = np.split(durations, [len(durations) - 2 * segments, len(durations) - segments])
    return LapDurations(first, between, last)
