"""Minimum-snap path through waypoints, in the scenario language."""

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.errors import InputError
from drake_quad.framework.result_cache import cached_on_disk
from drake_quad.reference.laps import LapDurations, path_of_laps
from drake_quad.reference.minimum_snap import rest_at_ends
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.plan import Plan
from drake_quad.reference.planner import passing_times, plan_path, without_repeats
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.regions import Box, Corridor, Sphere, intersection_of
from drake_quad.reference.routes import Leg
from drake_quad.reference.time_allocation import stretch_factor
from drake_quad.reference.yaw import yaw_through
from drake_quad.scenario.distributions import Model, Real, validation_error
from drake_quad.scenario.limits import MAX_WAYPOINTS
from drake_quad.scenario.paths import distributions_in
from drake_quad.scenario.quantities import TWO_TURNS, Point, Position, Positive, radians_demand
from drake_quad.scenario.regions import BoxRegion, CorridorRegion, SphereRegion
from drake_quad.scenario.routes.route import ROUTES, KnownEnd, Laps, MovingRoute, PlannedRoute, split_three_laps
from drake_quad.scenario.routes.waypoint_times import FixedWaypointTimes, MinimumSnapTimes, MinimumTimes, Times
from drake_quad.space.distance import nearest_approach
from drake_quad.space.space import Space

if TYPE_CHECKING:
    from drake_quad.space.collision_free import CollisionFreeRoute

# Half a turn plus a rounding tolerance, rad. Successive yaws that differ by at most this angle describe a continuous
# turn.
_HALF_TURN = math.pi + 1e-6


class Waypoint(Model):
    """Point or region to pass, optionally with given derivatives. [x, y, z] is an abbreviation for a point."""

    point: Position | None = Field(default=None, description="point to pass, in W (m)")
    box: BoxRegion | None = Field(default=None, description="box through which the path must pass")
    sphere: SphereRegion | None = Field(default=None, description="sphere through which the path must pass")
    velocity: Point | None = Field(default=None, description="velocity at the waypoint, in W (m/s); free by default")
    acceleration: Point | None = Field(
        default=None, description="acceleration at the waypoint, in W (m/s²); free by default"
    )
    jerk: Point | None = Field(default=None, description="jerk at the waypoint, in W (m/s³); free by default")
    stop: bool = Field(default=False, description="whether velocity, acceleration and jerk are zero at the waypoint")
    yaw: Real | None = Field(
        default=None, description="yaw at the waypoint (rad), for heading: waypoints; free by default"
    )

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: Any) -> Any:
        return {"point": data} if isinstance(data, list | tuple) else data

    @model_validator(mode="after")
    def _has_one_region(self) -> "Waypoint":
        specified = [name for name in ("point", "box", "sphere") if getattr(self, name) is not None]
        if len(specified) != 1:
            specified_text = " and ".join(specified) or "none"
            raise validation_error(f"must have one of point, box and sphere, not {specified_text}")
        if self.stop and any(value is not None for value in (self.velocity, self.acceleration, self.jerk)):
            raise validation_error("must not have `stop` together with a velocity, acceleration or jerk")
        return self

    def region(self) -> Box | Sphere:
        """Return the point or region in the form that the planner uses."""
        if self.box is not None:
            return self.box.box()
        if self.sphere is not None:
            return Sphere(self.sphere.centre, self.sphere.radius)
        return Box.point(np.array(self.point, dtype=float))


@ROUTES.register
class WaypointRoute(MovingRoute):
    """Minimum-snap path through waypoints, within limits and corridors."""

    kind: Literal["waypoints"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(strict=False, min_length=2, max_length=MAX_WAYPOINTS)] = Field(
        description="points or regions to pass, in order; segment i leads from waypoint i to waypoint i + 1, from 0 on"
    )
    times: Times = Field(
        default=MinimumTimes(kind="minimum_time"),
        description="times at which the waypoints are passed, or the method to choose them",
    )
    corridors: Annotated[tuple[CorridorRegion | None, ...], Field(strict=False)] | None = Field(
        default=None,
        description="for each segment, the box or half-spaces that the path must not leave, or null for no corridor",
    )
    space: BoxRegion | None = Field(default=None, description="box that the whole path must not leave")
    laps: Laps = Field(
        default=1,
        description="number of laps of a route that ends where it begins; the first lap begins and the last lap ends at"
        " rest, and all laps between are equal; the vehicle rests between laps only if the last waypoint is a stop",
    )
    # Mypy does not allow a subclass to accept more values than its base class.
    heading: Literal["constant", "along_path", "waypoints"] = Field(  # type: ignore[assignment]
        default="constant",
        description="rule for the yaw; waypoints lets it turn through the yaws that are given at the waypoints",
    )
    top_speed: Positive | None = Field(
        default=2.0, description="limit on the speed (m/s), or null for none; the default is the paper's"
    )
    top_acceleration: Positive | None = Field(
        default=0.7, description="limit on the acceleration (m/s²), or null for none; the default is the paper's"
    )

    @field_validator("times", mode="before")
    @classmethod
    def _short_form(cls, times: Any) -> Any:
        if isinstance(times, str):
            return {"kind": times}
        return {"kind": "fixed", "times": times} if isinstance(times, list | tuple) else times

    @model_validator(mode="after")
    def _is_consistent(self) -> "WaypointRoute":
        count = len(self.waypoints)
        if isinstance(self.times, FixedWaypointTimes) and len(self.times.times) != count:
            raise self.field_error(f"must have one time for each of the {count} waypoints", "times")
        if self.corridors is not None and len(self.corridors) != count - 1:
            demand = f"must have one corridor or null for each of the {count - 1} segments"
            raise self.field_error(demand, "corridors")
        has_yaws = any(waypoint.yaw is not None for waypoint in self.waypoints)
        if self.heading == "waypoints" and not has_yaws:
            raise self.field_error("must not be `waypoints`, since no waypoint has a yaw", "heading")
        if self.heading != "waypoints" and has_yaws:
            raise self.field_error("must be `waypoints`, since yaws are given at waypoints", "heading")
        self._check_yaws()
        limited = self.top_speed is not None or self.top_acceleration is not None
        if not limited and self.times.chooses_total:
            demand = (
                "must be a number unless top_acceleration is a number, since the total time follows from these limits"
            )
            raise self.field_error(demand, "top_speed")
        return self

    def _check_yaws(self) -> None:
        """Raise an error if the yaws were apparently given in degrees. Successive full turns are allowed."""
        before = 0.0
        for i, waypoint in enumerate(self.waypoints):
            if waypoint.yaw is None:
                continue
            if abs(waypoint.yaw) > TWO_TURNS and abs(waypoint.yaw - before) > _HALF_TURN:
                raise self.field_error(radians_demand(waypoint.yaw, TWO_TURNS), "waypoints", i, "yaw")
            before = waypoint.yaw

    @model_validator(mode="after")
    def _can_be_repeated(self) -> "WaypointRoute":
        """Raise an error if the route has laps but cannot be repeated."""
        if self.laps == 1:
            return self
        first, last = self.waypoints[0].point, self.waypoints[-1].point
        if first is None or first != last:
            raise self.field_error("must be 1, since the route does not end at the point where it begins", "laps")
        if self.laps * len(self.waypoints) > MAX_WAYPOINTS:
            raise self.field_error(
                f"must be smaller, since all laps together may have at most {MAX_WAYPOINTS} waypoints", "laps"
            )
        for i, waypoint in enumerate(self.waypoints):
            for name in ("velocity", "acceleration", "jerk"):
                if getattr(waypoint, name) is not None:
                    demand = "must be left out, since a route with laps may have stops, but no other given derivatives"
                    raise self.field_error(demand, "waypoints", i, name)
        for name in ("corridors", "space"):
            if getattr(self, name) is not None:
                raise self.field_error("must be left out, since it cannot be combined with laps", name)
        if isinstance(self.times, MinimumSnapTimes):
            raise self.field_error("must be fixed, heuristic or minimum_time if there are laps", "times", "kind")
        return self

    @model_validator(mode="after")
    def _is_feasible(self) -> "WaypointRoute":
        if not distributions_in(self):
            try:
                self.problem()
            except InputError as error:
                raise PydanticCustomError("path", "{reason}", {"reason": str(error)}) from None
        return self

    def known_end_time(self) -> KnownEnd:
        """Return the field that sets the end time of the route, and this time (s), or None if it must be planned."""
        return self.times.known_end_time(self.laps) or super().known_end_time()

    def problem(self, laps: int = 1) -> PathProblem:
        """Return the planning problem for a number of laps. The route must not contain distributions.

        Raises:
            InputError: if no path can satisfy the constraints, whatever its times.
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
            [waypoint.region() for waypoint in waypoints],
            derivatives=derivatives,
            corridors=self._corridors() * laps,
            limits=self.limits(),
        )

    def _corridors(self) -> list[Corridor | None]:
        """Return the intersection of corridor and space for each segment, or None for a segment with neither."""
        corridor_settings = self.corridors or (None,) * (len(self.waypoints) - 1)
        corridors = [None if corridor is None else corridor.region() for corridor in corridor_settings]
        if self.space is None:
            return corridors
        space = self.space.box()
        inside = [space if corridor is None else intersection_of(corridor, space) for corridor in corridors]
        for i, corridor in enumerate(inside):
            if corridor is None:
                raise InputError(f"the corridor of segment {i} lies outside route.space; enlarge one of the two")
        return inside

    def plan(self, space: Space | None) -> PlannedRoute:
        """Return the plan through the waypoints, around the obstacles of a space."""
        path, laps, detour = self._path(space)
        if self.heading == "waypoints":
            yaws = [math.nan if waypoint.yaw is None else waypoint.yaw for waypoint in self.waypoints]
            yaw = yaw_through(self._passing_times(path, detour), [*yaws, *yaws[1:] * (self.laps - 1)])
        else:
            yaw = self.yaw_profile(path)
        plan = Plan(path, yaw, _laps_as_legs(path, laps), laps)
        return (
            PlannedRoute(plan, self.problem(self.laps))
            if detour is None
            else PlannedRoute(plan, detour.problem, detour.waypoints)
        )

    def _passing_times(self, path: PolynomialPath, detour: "CollisionFreeRoute | None") -> np.ndarray:
        """Return the times at which the path passes the waypoints, (waypoints,) in s."""
        flown_path = path if detour is None else path._replace(times=path.times[detour.waypoints])
        return passing_times(self.problem(self.laps), flown_path)

    def _path(self, space: Space | None) -> tuple[PolynomialPath, tuple[float, ...], "CollisionFreeRoute | None"]:
        """Return the path, the start and end times of its laps (s), and the collision-free route that the path follows.

        The times are empty for a single lap. The collision-free route is None if there are no obstacles. If the planner
        chooses the times of several laps, it plans three laps, of which the middle one is repeated.

        Raises:
            InputError: if no path exists or none is found.
        """
        if self.laps == 1:
            if space is None:
                return plan_path(self.problem(), self.times.timing()), (), None
            path, detour = self._path_around_obstacles(space)
            return path, (), detour
        is_fixed = isinstance(self.times, FixedWaypointTimes)
        problem = self.problem() if is_fixed else without_repeats(self.problem(3))
        path = plan_path(problem.without_limits() if is_fixed else problem, self.times.timing())
        if is_fixed:
            durations, points = LapDurations(*[path.durations] * 3), path.waypoints
        else:
            segments = (len(path.times) - 1) // 3
            durations, points = split_three_laps(path.durations, segments), path.waypoints[segments : 2 * segments + 1]
        stops = (problem.derivatives[: len(points)] == 0.0).all(axis=(1, 2))
        stops[[0, -1]] = self.waypoints[-1].stop
        # With given times, the vehicle hovers between two successive waypoints at the same point.
        staying = (np.diff(points, axis=0) == 0.0).all(axis=1)
        stops[:-1] |= staying
        stops[1:] |= staying
        stops[[0, -1]] = stops[0] or stops[-1]
        all_laps, laps = path_of_laps(points, durations, self.laps, stops=stops)
        factor = stretch_factor(all_laps, problem.limits) if problem.limits.by_order else 0.0
        if is_fixed:
            if factor > 1.0 + 1e-9:
                raise InputError(f"the path through all laps exceeds its limits; multiply route.times by {factor:.3g}")
            start = float(path.times[0])
            return all_laps._replace(times=all_laps.times + start), tuple([start + time for time in laps]), None
        return all_laps.scaled_in_time(factor), tuple([factor * time for time in laps]), None

    def _path_around_obstacles(self, space: Space) -> tuple[PolynomialPath, "CollisionFreeRoute"]:
        """Return a path that keeps the clearance and the bounds of a space, and its route around obstacles.

        Raises:
            InputError: if no path exists or none is found.
        """
        # Imported here, because space.collision_free imports pydrake.planning, which most flights do not need.
        from drake_quad.space.collision_free import (
            check_waypoint_clearance,
            direct_route,
            plan_collision_free_path,
            with_bounds,
        )

        problem, timing = self.problem(), self.times.timing()
        if not isinstance(self.times, FixedWaypointTimes):
            problem = without_repeats(problem)
        bounded = with_bounds(problem, space.bounds)
        check_waypoint_clearance(space, problem)
        path = plan_path(bounded, timing)
        approach = nearest_approach(path, space)
        if approach is None or approach.distance >= space.clearance:
            return path, direct_route(bounded)
        if space.bounds is None:
            raise InputError(
                f"the path comes to {approach}, nearer than the clearance of {space.clearance:.3g} m; give"
                " space.bounds, the box in which to plan a route around the obstacles"
            )
        path, detour = cached_on_disk(plan_collision_free_path, space, space.bounds, problem, timing)
        approach = nearest_approach(path, space)
        if approach is not None and approach.distance < space.clearance:
            raise RuntimeError(f"a path planned with a clearance of {space.clearance:g} m comes to {approach}")
        return path, detour


def _laps_as_legs(path: PolynomialPath, laps: tuple[float, ...]) -> tuple[Leg, ...]:
    """Return a leg for each lap."""
    firsts = np.searchsorted(path.times, laps[:-1])
    return tuple([Leg(f"lap {i + 1}", int(first)) for i, first in enumerate(firsts)])
