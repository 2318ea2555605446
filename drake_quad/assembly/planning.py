"""From a scenario's route to a plan that its vehicle can fly."""

import dataclasses
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from drake_quad.assembly.effects import thrust_curve
from drake_quad.assembly.space import space_to_plan_in
from drake_quad.caching import ThreadSafeCache
from drake_quad.errors import InputError
from drake_quad.reference.feasibility import first_violation, sample_times
from drake_quad.reference.laps import LapDurations, flown_in_laps
from drake_quad.reference.lissajous import lissajous
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.pieces import plan_of_pieces
from drake_quad.reference.plan import PATH_ORDERS, Plan
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
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path
from drake_quad.reference.rest import moves_at_end
from drake_quad.reference.routes import Leg, Route, circle, figure_eight
from drake_quad.reference.time_allocation import stretch_factor, trapezoid_times
from drake_quad.reference.yaw import constant_yaw, yaw_along, yaw_through
from drake_quad.scenario import Mission, Scenario, distributions_in, routes
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.limits import LONGEST, MOST_TICKS
from drake_quad.scenario.routes import (
    CircleRoute,
    FigureEightRoute,
    HoverRoute,
    LissajousRoute,
    TrajectoryRoute,
    WaypointRoute,
)
from drake_quad.signals import Jerk, Reference, Snap
from drake_quad.space.around import WayAround, check_places, plan_around, straight_on, within
from drake_quad.space.distance import nearest_approach
from drake_quad.space.space import Space
from drake_quad.vehicle.inverse_dynamics import RotorDemand, rotor_demand
from drake_quad.vehicle.motors import mean_thrust_factor, speeds_of_throttles
from drake_quad.vehicle.parameters import Inertia, QuadrotorParameters

# Number of times at which a braking piece, a polynomial of degree 6, is checked.
_NUM_BRAKING_SAMPLES = 200
# Distance by which a position may lie outside a box, m. Planners end paths on the faces of boxes, to about 1e-6 m.
_BOX_TOLERANCE = 1e-4
# Cache of the plans around obstacles, by the text of the scenario.
_MAX_OBSTACLE_PLANS = 16
_obstacle_plans: "ThreadSafeCache[Planned]" = ThreadSafeCache(_MAX_OBSTACLE_PLANS)


def nominal_parameters(mission: Mission) -> QuadrotorParameters:
    """What is believed of the vehicle: no drag, the centre of mass in the middle of its layout."""
    return QuadrotorParameters()._replace(**airframe_parameters(mission.nominal))


def planned_parameters(mission: Mission) -> QuadrotorParameters:
    """`nominal_parameters`, where motors take throttles with the narrower limits of the believed thrust curve."""
    parameters, curve = nominal_parameters(mission), thrust_curve(mission.nominal.motors)
    if curve is None:
        return parameters
    slowest, fastest = speeds_of_throttles(curve, mean_thrust_factor(parameters))
    return parameters._replace(
        min_rotor_speed=max(parameters.min_rotor_speed, slowest),
        max_rotor_speed=min(parameters.max_rotor_speed, fastest),
    )


def airframe_parameters(airframe: Any) -> dict[str, Any]:
    """The parameters that an airframe of a scenario, or of a `Batch.fleet_scenario`, gives, by name."""
    return {
        "mass": airframe.mass,
        "inertia": Inertia(*airframe.inertia),
        "rotor_inertia": airframe.rotor_inertia,
        "rotors": rotors_of(airframe),
        "gravity": airframe.gravity,
        "min_rotor_speed": airframe.min_rotor_speed,
        "max_rotor_speed": airframe.max_rotor_speed,
    }


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


def plan_route(mission: Mission) -> Plan:
    """The plan for the route of a scenario, for the nominal vehicle.

    Raises:
        InputError: the route holds a distribution, or no path or no rotors can keep to what it asks, or obstacles leave
            it no way.
    """
    return planned(mission).plan


def planned(mission: Mission) -> Planned:
    """Return the plan for the route of a scenario, with the problem that it solves; errors are those of `plan_route`.

    Planning around obstacles takes seconds, so these plans are cached.
    """
    if mission.space is None:
        return _planned(mission, None)
    # Of what is no part of a mission only the tracking error depends.
    depends = None if mission.space.tracking else set(Mission.model_fields)

    def make() -> Planned:
        space = space_to_plan_in(mission)
        return _planned(mission, space)._replace(space=space)

    return _obstacle_plans.get(mission.model_dump_json(include=depends), make)


def _planned(mission: Mission, space: Space | None) -> Planned:
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
    _check_rotors(plan, mission, sample_times(plan.path))
    if space is not None and way is None:
        _check_obstacles(plan.path, space)
    if not isinstance(route, WaypointRoute):
        return Planned(plan)
    return Planned(plan, route.problem(route.laps)) if way is None else Planned(plan, way.problem, way.waypoints)


def _check_obstacles(path: PolynomialPath, space: Space | None) -> None:
    """Raise InputError if the path touches an obstacle."""
    approach = None if space is None else nearest_approach(path, space)
    if space is not None and approach is not None and approach.distance < space.radius:
        raise InputError(
            f"the route comes to {approach}, nearer than the radius of the vehicle, {space.radius:.3g} m; only a route"
            " through waypoints, without laps, is led around obstacles"
        )


def refuse_distributions(paths: Iterable[str]) -> None:
    """Raises InputError if there is any field that holds a distribution, given by their paths."""
    for path in paths:
        raise InputError(
            f"{path} is a distribution; one flight needs a number there, or a sample to draw it for: sample=0 in"
            " Python, --sample 0 in a shell"
        )


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
    path, way = plan_around(space, space.bounds, problem, timing)
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


def flight_duration(scenario: Scenario, plan: Plan) -> float:
    """Return the duration of a scenario's flight, s, a whole number of ticks of the control.

    Raises:
        InputError: if the metric window begins after the end of the flight, the flight has too many ticks, or the
            vehicle cannot fly the braking at the end of a plan that ends in motion.
    """
    shortest, period = min(scenario.periods.values()), scenario.laboratory.command_link.period
    wanted = scenario.duration if scenario.duration is not None else float(plan.path.times[-1])
    duration = _whole_ticks(wanted, scenario)
    if duration > MOST_TICKS * shortest + period:
        raise InputError(
            f"the flight would take {duration:g} s, but must take at most {MOST_TICKS * shortest:g} s, {MOST_TICKS:,}"
            " times the shortest period"
        )
    start = window_start(scenario, plan)
    if start >= duration:
        raise InputError(f"metrics.start is {start:g}, but must be before the end of the flight at {duration:g} s")
    if goes_on_in_motion(scenario, plan):
        _check_braking(scenario, plan)
    return duration


def _whole_ticks(time: float, scenario: Scenario) -> float:
    """Return the time of the first tick at or after a given time, s, and at least one tick."""
    period = scenario.laboratory.command_link.period
    return max(1, math.ceil(time / period - 1e-9)) * period


def goes_on_in_motion(scenario: Scenario, plan: Plan) -> bool:
    """Return whether the plan ends in motion and the flight of the scenario continues after its end."""
    return (
        scenario.duration is not None
        and plan.brakes
        and _whole_ticks(scenario.duration, scenario) > _whole_ticks(float(plan.path.times[-1]), scenario)
    )


def _check_braking(scenario: Scenario, plan: Plan) -> None:
    """Raise InputError if the vehicle cannot fly the braking at the end of a plan, or must not fly where it leads."""
    end, demand = float(plan.path.times[-1]), "end the route at rest, or leave duration out"
    times = np.linspace(end, plan.rest_time, _NUM_BRAKING_SAMPLES)
    try:
        _check_rotors(plan, scenario, times)
        if moves_at_end(plan.path, PATH_ORDERS):
            _check_room(evaluate(plan.flown_path, times), scenario)
            if scenario.space is not None:
                braking = PolynomialPath(plan.flown_path.times[-3:-1], plan.flown_path.coefficients[-2:-1])
                _check_obstacles(braking, space_to_plan_in(scenario))
    except InputError as error:
        raise InputError(
            f"duration is {scenario.duration:g} s, but the route ends in motion at {end:.2f} s, and the braking after"
            f" it cannot be flown ({error}); {demand}"
        ) from None


def _check_room(positions: np.ndarray, scenario: Scenario) -> None:
    """Raise InputError if positions (3, n), m, leave the boxes that contain the plan, or are below `crash.height`."""
    boxes = {
        "space.bounds": None if scenario.space is None else scenario.space.bounds,
        "route.space": getattr(scenario.route, "space", None),
    }
    for name, region in boxes.items():
        box = None if region is None else region.box()
        beyond = (
            0.0 if box is None else float(np.max([box.low - positions.min(axis=1), positions.max(axis=1) - box.high]))
        )
        if beyond > _BOX_TOLERANCE:
            raise InputError(f"it leaves {name} by {beyond:.2f} m")
    lowest = float(positions[2].min())
    if lowest < scenario.crash.height:
        raise InputError(f"it descends to {lowest:.2f} m, and crash.height is {scenario.crash.height:g} m")


def window_end(scenario: Scenario, plan: Plan) -> float:
    """Return the end of the metric window, s; infinite if the window ends with the flight.

    The metrics of laps end with the last lap, even if the flight continues after it.
    """
    window = scenario.metrics
    if window.end is not None:
        return window.end
    return math.inf if window.first_lap is None else _whole_ticks(plan.lap_times[-1], scenario)


def window_start(scenario: Scenario, plan: Plan) -> float:
    """Return the start of the metric window, s.

    Raises:
        InputError: if the window begins with a lap that the plan does not have.
    """
    window = scenario.metrics
    if window.first_lap is None:
        return window.start
    starts = plan.lap_times[:-1]
    if window.first_lap > len(starts):
        raise InputError(f"metrics.first_lap is {window.first_lap}, but the number of laps is {len(starts)}")
    return starts[window.first_lap - 1]


def plan_demand(plan: Plan, parameters: QuadrotorParameters, times: np.ndarray) -> RotorDemand:
    """Return the rotor speeds, attitude and body rates that a plan demands at times (samples,), s."""
    position, velocity, acceleration, jerk, snap = (evaluate(plan.flown_path, times, order) for order in range(5))
    ((yaw,), (yaw_rate,), (yaw_acceleration,)) = (evaluate(plan.flown_yaw, times, order) for order in range(3))
    reference = Reference._make([*position, *velocity, *acceleration, yaw, yaw_rate])
    return rotor_demand(reference, Jerk._make(jerk), Snap._make([*snap, yaw_acceleration]), parameters)


def _check_rotors(plan: Plan, mission: Mission, times: np.ndarray) -> None:
    """Raise InputError if a plan exceeds the rotors' limits at one of the times (samples,), s."""
    parameters = planned_parameters(mission)
    violation = first_violation(
        times,
        np.array(plan_demand(plan, parameters, times).rotor_speed),
        min_rotor_speed=parameters.min_rotor_speed,
        max_rotor_speed=parameters.max_rotor_speed,
    )
    if violation is not None:
        own = mission.nominal.min_rotor_speed, mission.nominal.max_rotor_speed
        of_throttle = "" if violation.limit in own else ", that of the throttle"
        raise InputError(f"the rotors cannot fly this route: {violation}{of_throttle}")
