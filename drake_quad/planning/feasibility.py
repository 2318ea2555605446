"""Checks of a plan against the limits of the rotors and against obstacles."""

import numpy as np

from drake_quad.errors import InputError
from drake_quad.planning.nominal import planned_parameters
from drake_quad.reference.feasibility import first_violation
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate
from drake_quad.scenario.models import Mission
from drake_quad.signals import Jerk, Reference, Snap
from drake_quad.space.distance import nearest_approach
from drake_quad.space.space import Space
from drake_quad.vehicle.inverse_dynamics import RotorDemand, rotor_demand
from drake_quad.vehicle.parameters import QuadrotorParameters


def plan_demand(plan: Plan, parameters: QuadrotorParameters, times: np.ndarray) -> RotorDemand:
    """Return the rotor speeds, attitude and body rates that a plan requires at the given times, (samples,) in s."""
    position, velocity, acceleration, jerk, snap = (evaluate(plan.extended_path, times, order) for order in range(5))
    ((yaw,), (yaw_rate,), (yaw_acceleration,)) = (evaluate(plan.extended_yaw, times, order) for order in range(3))
    reference = Reference._make([*position, *velocity, *acceleration, yaw, yaw_rate])
    return rotor_demand(reference, Jerk._make(jerk), Snap._make([*snap, yaw_acceleration]), parameters)


def check_rotors(plan: Plan, mission: Mission, times: np.ndarray) -> None:
    """Raise InputError if a plan violates the rotor speed limits at any of the given times, (samples,) in s."""
    parameters = planned_parameters(mission)
    violation = first_violation(
        times,
        np.array(plan_demand(plan, parameters, times).rotor_speed),
        min_rotor_speed=parameters.min_rotor_speed,
        max_rotor_speed=parameters.max_rotor_speed,
    )
    if violation is not None:
        rotor_limits = mission.nominal.min_rotor_speed, mission.nominal.max_rotor_speed
        throttle_note = "" if violation.limit in rotor_limits else ", which is the limit of the throttle"
        raise InputError(f"the rotors cannot fly this route: {violation}{throttle_note}")


def check_obstacles(path: PolynomialPath, space: Space | None) -> None:
    """Raise InputError if the path touches an obstacle."""
    approach = None if space is None else nearest_approach(path, space)
    if space is not None and approach is not None and approach.distance < space.radius:
        raise InputError(
            f"the route is {approach}, but the radius of the vehicle is {space.radius:.3g} m; use a route of kind"
            " `waypoints` without `laps`, which is planned around obstacles"
        )
