"""Minimum-snap path through waypoints."""

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.errors import InputError
from drake_quad.framework.result_cache import cached_on_disk
from drake_quad.reference.laps import LapDurations, flown_in_laps
from drake_quad.reference.minimum_snap import rest_at_ends
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.plan import Plan
from drake_quad.reference.planner import merged, passing_times, plan_path
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.regions import Box, Corridor, Sphere, common
from drake_quad.reference.routes import Leg
from drake_quad.reference.time_allocation import stretch_factor
from drake_quad.reference.yaw import yaw_through
from drake_quad.scenario.distributions import Model, Real, refused
from drake_quad.scenario.limits import MOST_WAYPOINTS
from drake_quad.scenario.paths import distributions_in
from drake_quad.scenario.quantities import TWO_TURNS, Point, Position, Positive, radians_demand
from drake_quad.scenario.regions import BoxRegion, CorridorRegion, SphereRegion
from drake_quad.scenario.routes.route import ROUTES, KnownEnd, Laps, MovingRoute, Planned, of_three_laps
from drake_quad.scenario.routes.waypoint_times import Given, LeastSnapTimes, ShortestTimes, Times
from drake_quad.space.distance import nearest_approach
from drake_quad.space.space import Space

if TYPE_CHECKING:
    from drake_quad.space.around import WayAround

# Half a turn plus a tolerance for rounding, rad. If consecutive yaws differ by no more, they describe continuous turns.
_HALF_TURN = math.pi + 1e-6


class Waypoint(Model):
    """Place to pass, with velocity and derivatives if they are given; [x, y, z] is short for a point."""

    point: Position | None = Field(default=None, description="exactly here, in W (m)")
    box: BoxRegion | None = Field(default=None, description="somewhere in this box")
    sphere: SphereRegion | None = Field(default=None, description="somewhere in this sphere")
    velocity: Point | None = Field(default=None, description="given velocity, in W (m/s); free by default")
    acceleration: Point | None = Field(default=None, description="given acceleration, in W (m/s²); free by default")
    jerk: Point | None = Field(default=None, description="given jerk, in W (m/s³); free by default")
    stop: bool = Field(default=False, description="whether velocity, acceleration and jerk are zero here")
    yaw: Real | None = Field(default=None, description="yaw here (rad), for heading: waypoints; free by default")

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: Any) -> Any:
        return {"point": data} if isinstance(data, list | tuple) else data

    @model_validator(mode="after")
    def _one_place(self) -> "Waypoint":
        given = [name for name in ("point", "box", "sphere") if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            raise refused(f"must have one of point, box and sphere, not {found}")
        if self.stop and any(value is not None for value in (self.velocity, self.acceleration, self.jerk)):
            raise refused("must not have both stop and given derivatives")
        return self

    def place(self) -> Box | Sphere:
        """Return the place as the planner has it; it holds no distributions."""
        if self.box is not None:
            return self.box.box()
        if self.sphere is not None:
            return Sphere(self.sphere.centre, self.sphere.radius)
        return Box.point(np.array(self.point, dtype=float))


@ROUTES.member
class WaypointRoute(MovingRoute):
    """Minimum snap through waypoints, within limits and corridors."""

    kind: Literal["waypoints"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(strict=False, min_length=2, max_length=MOST_WAYPOINTS)] = Field(
        description="places to pass, in order; segment i leads from waypoint i to waypoint i + 1"
    )
    times: Times = Field(default=ShortestTimes(kind="shortest"), description="when to pass them, or how to choose that")
    corridors: Annotated[tuple[CorridorRegion | None, ...], Field(strict=False)] | None = Field(
        default=None, description="for each segment a box or half-spaces that the path must not leave, or null"
    )
    space: BoxRegion | None = Field(default=None, description="a box that the whole path must not leave")
    laps: Laps = Field(
        default=1,
        description="number of laps, if the route ends where it begins; the first begins, the last ends at rest, those"
        " in between are alike; there is rest between them only if the last waypoint is a stop",
    )
    # Mypy does not allow to widen what a base class has fixed.
    heading: Literal["constant", "along_path", "waypoints"] = Field(  # type: ignore[assignment]
        default="constant", description="what the yaw follows; waypoints turns through the yaws given at them"
    )
    top_speed: Positive | None = Field(
        default=2.0, description="limit on the speed (m/s), or null for none; the paper's 2 m/s"
    )
    top_acceleration: Positive | None = Field(
        default=0.7, description="limit on the acceleration (m/s²), or null for none; the paper's 0.7 m/s²"
    )

    @field_validator("times", mode="before")
    @classmethod
    def _short_form(cls, times: Any) -> Any:
        if isinstance(times, str):
            return {"kind": times}
        return {"kind": "given", "times": times} if isinstance(times, list | tuple) else times

    @model_validator(mode="after")
    def _consistent(self) -> "WaypointRoute":
        count = len(self.waypoints)
        if isinstance(self.times, Given) and len(self.times.times) != count:
            raise self.wrong(f"must hold one time for each of the {count} waypoints", "times")
        if self.corridors is not None and len(self.corridors) != count - 1:
            demand = f"must hold one box, half-spaces or null for each of the {count - 1} segments"
            raise self.wrong(demand, "corridors")
        has_yaws = any(waypoint.yaw is not None for waypoint in self.waypoints)
        if self.heading == "waypoints" and not has_yaws:
            raise self.wrong("needs a yaw at one of the waypoints", "heading")
        if self.heading != "waypoints" and has_yaws:
            raise self.wrong("must be waypoints if yaws are given there", "heading")
        self._check_yaws()
        limited = self.top_speed is not None or self.top_acceleration is not None
        if not limited and self.times.chooses_total:
            raise self.wrong("must be a number, or else top_acceleration, to choose the total time", "top_speed")
        return self

    def _check_yaws(self) -> None:
        """Raise an error if the yaws must have been given in degrees; continuous turns are allowed."""
        before = 0.0
        for i, waypoint in enumerate(self.waypoints):
            if waypoint.yaw is None:
                continue
            if abs(waypoint.yaw) > TWO_TURNS and abs(waypoint.yaw - before) > _HALF_TURN:
                raise self.wrong(radians_demand(waypoint.yaw, TWO_TURNS), "waypoints", i, "yaw")
            before = waypoint.yaw

    @model_validator(mode="after")
    def _closed(self) -> "WaypointRoute":
        """Raise an error if the route has laps but cannot be repeated."""
        if self.laps == 1:
            return self
        first, last = self.waypoints[0].point, self.waypoints[-1].point
        if first is None or first != last:
            raise self.wrong("must be 1, since the route does not end at the point where it begins", "laps")
        if self.laps * len(self.waypoints) > MOST_WAYPOINTS:
            raise self.wrong(f"must be fewer: in all laps there may be {MOST_WAYPOINTS} waypoints", "laps")
        for i, waypoint in enumerate(self.waypoints):
            for name in ("velocity", "acceleration", "jerk"):
                if getattr(waypoint, name) is not None:
                    demand = "must be left out: with laps only stops can be given at a waypoint"
                    raise self.wrong(demand, "waypoints", i, name)
        for name in ("corridors", "space"):
            if getattr(self, name) is not None:
                raise self.wrong("must be left out: laps keep to none", name)
        if isinstance(self.times, LeastSnapTimes):
            raise self.wrong("must be given, heuristic or shortest, since there are laps", "times", "kind")
        return self

    @model_validator(mode="after")
    def _flyable(self) -> "WaypointRoute":
        if not distributions_in(self):
            try:
                self.problem()
            except InputError as error:
                raise PydanticCustomError("path", "{reason}", {"reason": str(error)}) from None
        return self

    def known_end(self) -> KnownEnd:
        """Return the field that determines the end of the route, and this time, s; None if a plan does."""
        return self.times.known_end(self.laps) or super().known_end()

    def problem(self, laps: int = 1) -> PathProblem:
        """Return the problem of planning some laps, for a route without distributions.

        Raises:
            InputError: no path can, whatever its times.
        """
        waypoints = [*self.waypoints, *self.waypoints[1:] * (laps - 1)]
        derivatives = rest_at_ends(len(waypoints), 3)
        for i, waypoint in enumerate(waypoints):
            if waypoint.stop:
                derivatives[i] = 0.0
            for row, value in enumerate((waypoint.velocity, waypoint.acceleration, waypoint.jerk)):
                if value is not None:
                    derivatives[i, row] = value
        return PathProblem(
            [waypoint.place() for waypoint in waypoints],
            derivatives=derivatives,
            corridors=self._corridors() * laps,
            limits=self.limits(),
        )

    def _corridors(self) -> list[Corridor | None]:
        """Each segment's corridor, as much of it as lies in the space."""
        given = self.corridors or (None,) * (len(self.waypoints) - 1)
        corridors = [None if corridor is None else corridor.region() for corridor in given]
        if self.space is None:
            return corridors
        space = self.space.box()
        inside = [space if corridor is None else common(corridor, space) for corridor in corridors]
        for i, corridor in enumerate(inside):
            if corridor is None:
                raise InputError(f"the corridor of segment {i} lies outside the space")
        return inside

    def plan(self, space: Space | None) -> Planned:
        """Return the plan through the waypoints, around the obstacles of a space."""
        path, laps, way = self._path(space)
        if self.heading == "waypoints":
            yaws = [math.nan if waypoint.yaw is None else waypoint.yaw for waypoint in self.waypoints]
            yaw = yaw_through(self._passing_times(path, way), [*yaws, *yaws[1:] * (self.laps - 1)])
        else:
            yaw = self.yaw_of(path)
        plan = Plan(path, yaw, _laps_as_legs(path, laps), laps)
        return Planned(plan, self.problem(self.laps)) if way is None else Planned(plan, way.problem, way.waypoints)

    def _passing_times(self, path: PolynomialPath, way: "WayAround | None") -> np.ndarray:
        """Return the times (waypoints,) at which the waypoints are passed, s."""
        own = path if way is None else path._replace(times=path.times[way.waypoints])
        return passing_times(self.problem(self.laps), own)

    def _path(self, space: Space | None) -> tuple[PolynomialPath, tuple[float, ...], "WayAround | None"]:
        """Return the path, the times of its laps, s, if there are several, and its way around obstacles, if any.

        Where times are chosen, they are chosen for three laps, and the middle one is repeated.

        Raises:
            InputError: there is no such path, or none is found.
        """
        if self.laps == 1:
            if space is None:
                return plan_path(self.problem(), self.times.timing()), (), None
            path, way = self._around(space)
            return path, (), way
        given = isinstance(self.times, Given)
        problem = self.problem() if given else merged(self.problem(3))
        path = plan_path(problem.without_limits() if given else problem, self.times.timing())
        if given:
            durations, points = LapDurations(*[path.durations] * 3), path.waypoints
        else:
            segments = (len(path.times) - 1) // 3
            durations, points = of_three_laps(path.durations, segments), path.waypoints[segments : 2 * segments + 1]
        stops = (problem.derivatives[: len(points)] == 0.0).all(axis=(1, 2))
        stops[[0, -1]] = self.waypoints[-1].stop
        # If times are given, the vehicle stays at a waypoint that is repeated.
        staying = (np.diff(points, axis=0) == 0.0).all(axis=1)
        stops[:-1] |= staying
        stops[1:] |= staying
        stops[[0, -1]] = stops[0] or stops[-1]
        flown, laps = flown_in_laps(points, durations, self.laps, stops=stops)
        factor = stretch_factor(flown, problem.limits) if problem.limits.by_order else 0.0
        if given:
            if factor > 1.0 + 1e-9:
                raise InputError(f"in laps the times must be {factor:.3g} times as long to keep to the limits")
            start = float(path.times[0])
            return flown._replace(times=flown.times + start), tuple([start + time for time in laps]), None
        return flown.stretched(factor), tuple([factor * time for time in laps]), None

    def _around(self, space: Space) -> tuple[PolynomialPath, "WayAround"]:
        """Return the path that keeps the clearance and the bounds of a space, and its way around obstacles.

        Raises:
            InputError: there is no such path, or none is found.
        """
        # These import pydrake.planning, which most flights do not need.
        from drake_quad.space.around import check_places, plan_around, straight_on, within

        problem, timing = self.problem(), self.times.timing()
        if not isinstance(self.times, Given):
            problem = merged(problem)
        bounded = within(problem, space.bounds)
        check_places(space, problem)
        path = plan_path(bounded, timing)
        approach = nearest_approach(path, space)
        if approach is None or approach.distance >= space.clearance:
            return path, straight_on(bounded)
        if space.bounds is None:
            raise InputError(
                f"without a way around, the path comes to {approach}, nearer than {space.clearance:.3g} m; space.bounds"
                " is needed, the room in which to look for one"
            )
        path, way = cached_on_disk(plan_around, space, space.bounds, problem, timing)
        approach = nearest_approach(path, space)
        if approach is not None and approach.distance < space.clearance:
            raise RuntimeError(f"a path planned at {space.clearance:g} m from obstacles comes to {approach}")
        return path, way


def _laps_as_legs(path: PolynomialPath, laps: tuple[float, ...]) -> tuple[Leg, ...]:
    """Return a leg for each lap."""
    firsts = np.searchsorted(path.times, laps[:-1])
    return tuple([Leg(f"lap {i + 1}", int(first)) for i, first in enumerate(firsts)])
