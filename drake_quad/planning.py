"""From a scenario's route to a plan that its vehicle can fly."""

import math

import numpy as np

from drake_quad.errors import InputError
from drake_quad.reference.feasibility import first_violation, sample_times
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.path_problem import Limits
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.reference.routes import Route, circle, figure_eight
from drake_quad.reference.time_allocation import stretch_factor, trapezoid_times
from drake_quad.scenario import Scenario, distributions_in
from drake_quad.scenario.models import CircleRoute, FigureEightRoute, HoverRoute, WaypointRoute
from drake_quad.vehicle.inverse_dynamics import RotorDemand, rotor_demand
from drake_quad.vehicle.parameters import QuadrotorParameters


def vehicle_parameters(scenario: Scenario) -> QuadrotorParameters:
    """The vehicle of a scenario without distributions."""
    vehicle = scenario.vehicle
    fields = {name: getattr(vehicle, name) for name in QuadrotorParameters._fields}
    fields["thrust_factor"] = (vehicle.thrust_factor,) * 4
    return QuadrotorParameters(**fields)


def plan_route(scenario: Scenario) -> Plan:
    """The plan for a scenario's route.

    Raises:
        InputError: the scenario holds a distribution, or the rotors cannot fly the route.
    """
    random = distributions_in(scenario)
    if random:
        raise InputError(f"{random[0]} is a distribution; one flight needs a number there")
    route = scenario.route
    match route:
        case HoverRoute():
            plan = Plan.hover(route.position, duration=route.duration, yaw=route.yaw)
        case WaypointRoute():
            plan = Plan.facing(minimum_snap(route.waypoints, _waypoint_times(route)), route.yaw)
        case FigureEightRoute():
            eight = figure_eight(
                lower_height=route.lower_height,
                upper_height=route.upper_height,
                radius=route.radius,
                offset=route.offset,
            )
            plan = _within_limits(route, eight, cruise_speed=route.cruise_speed)
        case CircleRoute():
            laps = circle(radius=route.radius, height=route.height, laps=route.laps)
            plan = _within_limits(route, laps, cruise_speed=math.sqrt(route.top_acceleration * route.radius))
    check_rotors(plan, vehicle_parameters(scenario))
    return plan


def _waypoint_times(route: WaypointRoute) -> np.ndarray:
    if route.times is not None:
        return np.array(route.times)
    # The scenario's validation has seen to it.
    assert route.speed is not None
    assert route.acceleration is not None
    return trapezoid_times(np.array(route.waypoints), speed=route.speed, acceleration=route.acceleration)


def _within_limits(route: FigureEightRoute | CircleRoute, geometry: Route, *, cruise_speed: float) -> Plan:
    times = trapezoid_times(geometry.waypoints, speed=cruise_speed, acceleration=route.top_acceleration)
    path = minimum_snap(geometry.waypoints, times)
    limits = Limits(speed=route.top_speed, acceleration=route.top_acceleration)
    return Plan.facing(path.stretched(stretch_factor(path, limits)), route.yaw, geometry.legs)


def plan_demand(plan: Plan, parameters: QuadrotorParameters, times: np.ndarray) -> RotorDemand:
    """What a plan asks of a vehicle at given times (samples,), s."""
    acceleration, jerk, snap = (evaluate(plan.path, times, order) for order in (2, 3, 4))
    yaw = np.vstack([evaluate(plan.yaw, times, order) for order in range(3)])
    return rotor_demand(acceleration, jerk, snap, parameters, yaw=yaw)


def check_rotors(plan: Plan, parameters: QuadrotorParameters) -> None:
    """Raises InputError if the rotors cannot fly a plan."""
    times = sample_times(plan.path)
    violation = first_violation(
        times,
        plan_demand(plan, parameters, times).rotor_speed,
        min_rotor_speed=parameters.min_rotor_speed,
        max_rotor_speed=parameters.max_rotor_speed,
    )
    if violation is not None:
        raise InputError(f"the rotors cannot fly this route: {violation}")
