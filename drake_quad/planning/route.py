"""From a scenario's route to a plan that its vehicle can fly."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.framework.result_cache import kept
from drake_quad.planning.feasibility import check_obstacles, check_rotors
from drake_quad.reference.feasibility import sample_times
from drake_quad.reference.laps import LapDurations, flown_in_laps
from drake_quad.reference.lissajous import lissajous
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.pieces import plan_of_pieces
from drake_quad.reference.plan import Plan
from drake_quad.reference.planner import (
    GivenTimes,
    Heuristic,
    LeastSnap,
    Shortest,
    Timing,
    merged,
    passing_times,
    plan_path,
)
from drake_quad.reference.polynomial_path import PolynomialPath, hermite_path
from drake_quad.reference.routes import Leg, Route, circle, figure_eight
from drake_quad.reference.time_allocation import stretch_factor, trapezoid_times
from drake_quad.reference.yaw import constant_yaw, yaw_along, yaw_through
from drake_quad.scenario import routes
from drake_quad.scenario.limits import LONGEST
from drake_quad.scenario.models import Mission
from drake_quad.scenario.paths import distributions_in
from drake_quad.scenario.routes import (
    CircleRoute,
    FigureEightRoute,
    HoverRoute,
    LissajousRoute,
    TrajectoryRoute,
    WaypointRoute,
)
from drake_quad.space.around import WayAround, check_places, plan_around, straight_on, within
from drake_quad.space.distance import nearest_approach
from drake_quad.space.space import Space


class Planned(NamedTuple):
    """A plan, and what it was made for.

    Attributes:
        plan: to fly.
        problem: that its path solves, of a route through waypoints: with the corridors around obstacles, if there are
            any in its way.
        waypoints: (waypoints,) the numbers of the route's waypoints among the problem's, repeats left out.
        space: in which it was planned, if there is one.
    """

    plan: Plan
    problem: PathProblem | None = None
    waypoints: np.ndarray | None = None
    space: Space | None = None


def plan_in(mission: Mission, space: Space | None) -> Planned:
    """Return the plan for the route of a scenario around the obstacles of a space, for the nominal vehicle.

    `drake_quad.flight.mission.plan_route` plans in the space of the scenario.

    Raises:
        InputError: if the route contains a distribution, no path or no rotors can satisfy the constraints of the
            route, or the obstacles leave no way.
    """
    for field in distributions_in(mission):
        if field.startswith("route."):
            raise InputError(
                f"{field} is a distribution, but all vehicles fly the same plan, which needs a number there"
            )
    route, way = mission.route, None
    match route:
        case HoverRoute():
            plan = Plan.hover(route.position, duration=route.duration, yaw=route.yaw)
        case LissajousRoute():
            names = ("centre", "amplitude", "turns", "phase", "period", "laps")
            laps = tuple(np.linspace(0.0, route.laps * route.period, route.laps + 1).tolist())
            plan = Plan.facing(lissajous(**{name: getattr(route, name) for name in names}), route.yaw, laps=laps)
        case TrajectoryRoute():
            plan = _trajectory(route)
        case WaypointRoute():
            path, laps, way = _through_waypoints(route, space)
            if route.heading == "waypoints":
                yaws = [math.nan if waypoint.yaw is None else waypoint.yaw for waypoint in route.waypoints]
                times = _waypoint_times(route, path, way)
                yaw = yaw_through(times, [*yaws, *yaws[1:] * (route.laps - 1)])
            else:
                yaw = _yaw(route, path)
            plan = Plan(path, yaw, _laps_as_legs(path, laps), laps)
        case FigureEightRoute():
            eight = figure_eight(
                lower_height=route.lower_height,
                upper_height=route.upper_height,
                radius=route.radius,
                offset=route.offset,
            )
            if route.laps == 1:
                plan = _within_limits(route, eight, cruise_speed=route.cruise_speed)
            else:
                plan = _eight_in_laps(route, eight)
        case CircleRoute():
            turns = circle(radius=route.radius, height=route.height, laps=route.laps)
            plan = _within_limits(route, turns, cruise_speed=math.sqrt(route.top_acceleration * route.radius))
            plan = dataclasses.replace(plan, laps=(*plan.leg_times, plan.duration))
    if not plan.duration <= LONGEST:
        raise InputError(f"within its limits the route would take {plan.duration:g} s, more than {LONGEST:g} s")
    check_rotors(plan, mission, sample_times(plan.path))
    if space is not None and way is None:
        check_obstacles(plan.path, space)
    if not isinstance(route, WaypointRoute):
        return Planned(plan)
    return Planned(plan, route.problem(route.laps)) if way is None else Planned(plan, way.problem, way.waypoints)


def _within_limits(route: FigureEightRoute | CircleRoute, geometry: Route, *, cruise_speed: float) -> Plan:
    times = trapezoid_times(geometry.waypoints, speed=cruise_speed, acceleration=route.top_acceleration)
    path = minimum_snap(geometry.waypoints, times)
    path = path.stretched(stretch_factor(path, route.limits()))
    return Plan(path, _yaw(route, path), geometry.legs)


def _eight_in_laps(route: FigureEightRoute, eight: Route) -> Plan:
    """Laps of the figure eight after the rise from the ground; the times are those of a ride through three."""
    lap = eight.waypoints[1:]
    ride = np.vstack([eight.waypoints, lap[1:], lap[1:]])
    times = trapezoid_times(ride, speed=route.cruise_speed, acceleration=route.top_acceleration)
    path, laps = flown_in_laps(eight.waypoints, _of_three(np.diff(times), len(lap) - 1), route.laps, lead=1)
    factor = stretch_factor(path, route.limits())
    path, laps = path.stretched(factor), tuple([factor * time for time in laps])
    rise, *others = eight.legs
    legs = [leg._replace(first=leg.first + i * (len(lap) - 1)) for i in range(route.laps) for leg in others]
    return Plan(path, _yaw(route, path), (rise, *legs), laps)


def _of_three(durations: np.ndarray, segments: int) -> LapDurations:
    """The durations of three laps of so many segments, the first one with what leads to it."""
    first, between, last = np.split(durations, [len(durations) - 2 * segments, len(durations) - segments])
    return LapDurations(first, between, last)


def _around(route: WaypointRoute, space: Space) -> tuple[PolynomialPath, WayAround]:
    """The path through waypoints that keeps the clearance and the bounds, and its way around obstacles.

    Raises:
        InputError: there is no such path, or none is found.
    """
    problem, timing = route.problem(), _timing(route)
    if not isinstance(timing, GivenTimes):
        problem = merged(problem)
    bounded = within(problem, space.bounds)
    check_places(space, problem)
    path = plan_path(bounded, timing)
    approach = nearest_approach(path, space)
    if approach is None or approach.distance >= space.clearance:
        return path, straight_on(bounded)
    if space.bounds is None:
        raise InputError(
            f"without a way around, the path comes to {approach}, nearer than {space.clearance:.3g} m; space.bounds is"
            " needed, the room in which to look for one"
        )
    path, way = kept(plan_around, space, space.bounds, problem, timing)
    approach = nearest_approach(path, space)
    if approach is not None and approach.distance < space.clearance:
        raise RuntimeError(f"a path planned at {space.clearance:g} m from obstacles comes to {approach}")
    return path, way


def _waypoint_times(route: WaypointRoute, path: PolynomialPath, way: WayAround | None) -> np.ndarray:
    """(waypoints,) when the route's waypoints are passed, s."""
    problem = route.problem(route.laps)
    if way is None:
        return passing_times(problem, path)
    return passing_times(problem, path._replace(times=path.times[way.waypoints]))


def _through_waypoints(
    route: WaypointRoute, space: Space | None
) -> tuple[PolynomialPath, tuple[float, ...], WayAround | None]:
    """The path through waypoints, the times of its laps, s, if there are several, and its way around obstacles, if any.

    Where times are chosen they are chosen for three laps, and the middle one is repeated.

    Raises:
        InputError: there is no such path, or none is found.
    """
    if route.laps == 1:
        if space is None:
            return plan_path(route.problem(), _timing(route)), (), None
        path, way = _around(route, space)
        return path, (), way
    given = isinstance(route.times, routes.Given)
    problem = route.problem() if given else merged(route.problem(3))
    path = plan_path(problem.without_limits() if given else problem, _timing(route))
    if given:
        durations, points = LapDurations(*[path.durations] * 3), path.waypoints
    else:
        segments = (len(path.times) - 1) // 3
        durations, points = _of_three(path.durations, segments), path.waypoints[segments : 2 * segments + 1]
    stops = (problem.derivatives[: len(points)] == 0.0).all(axis=(1, 2))
    stops[[0, -1]] = route.waypoints[-1].stop
    # Where times are given, a waypoint that repeats the one before is a place to stay at.
    staying = (np.diff(points, axis=0) == 0.0).all(axis=1)
    stops[:-1] |= staying
    stops[1:] |= staying
    stops[[0, -1]] = stops[0] or stops[-1]
    flown, laps = flown_in_laps(points, durations, route.laps, stops=stops)
    factor = stretch_factor(flown, problem.limits) if problem.limits.by_order else 0.0
    if given:
        if factor > 1.0 + 1e-9:
            raise InputError(f"in laps the times must be {factor:.3g} times as long to keep to the limits")
        start = float(path.times[0])
        return flown._replace(times=flown.times + start), tuple([start + time for time in laps]), None
    return flown.stretched(factor), tuple([factor * time for time in laps]), None


def _laps_as_legs(path: PolynomialPath, laps: tuple[float, ...]) -> tuple[Leg, ...]:
    firsts = np.searchsorted(path.times, laps[:-1])
    return tuple([Leg(f"lap {i + 1}", int(first)) for i, first in enumerate(firsts)])


def _timing(route: WaypointRoute) -> Timing:
    match route.times:
        case routes.Given(times=times):
            return GivenTimes(times)
        case routes.Heuristic():
            return Heuristic()
        case routes.LeastSnap(duration=duration):
            return LeastSnap(duration)
        case routes.Shortest():
            return Shortest()


def _yaw(route: FigureEightRoute | CircleRoute | WaypointRoute, path: PolynomialPath) -> PolynomialPath:
    if route.heading == "along_path":
        return yaw_along(path)
    return constant_yaw(path.times[0], path.times[-1], route.yaw)


def _trajectory(route: TrajectoryRoute) -> Plan:
    if route.pieces is not None:
        rows = np.array([piece.row() for piece in route.pieces])
        return plan_of_pieces(rows, origin=route.origin, time_scale=route.time_scale)
    assert route.knots is not None
    times = np.array([knot.time for knot in route.knots])
    derivatives = [[knot.position, knot.velocity, knot.acceleration, knot.jerk] for knot in route.knots]
    path = hermite_path(times, np.array(derivatives))
    path.coefficients[:, 0] += route.origin
    if route.yaw_knots is None:
        return Plan.facing(path._replace(times=route.time_scale * times))
    yaw_times = np.array([knot.time for knot in route.yaw_knots])
    yaws = np.array([[[knot.yaw], [knot.yaw_rate]] for knot in route.yaw_knots])
    scaled = [part._replace(times=route.time_scale * part.times) for part in (path, hermite_path(yaw_times, yaws))]
    return Plan(scaled[0], scaled[1])
