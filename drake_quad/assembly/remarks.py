"""What a person should know of a flight before its numbers are used, in sentences."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from drake_quad.assembly.planning import goes_on_in_motion, plan_route
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario import Scenario
from drake_quad.scenario.description import unit_at
from drake_quad.scenario.distributions import Distribution
from drake_quad.scenario.layouts import arm_length_of
from drake_quad.scenario.paths import distributions_in

# Believed and flown vehicle differ if they are further apart than both of these: a relative difference, which no scale
# and no data sheet is off by, and a multiple of the standard deviation of the flown vehicle.
_MIN_DIFFERENCE = 0.2
_MIN_DEVIATIONS = 5.0
# Fields in which two vehicles differ; the limits of the rotors differ with how they are driven.
_COMPARED = ("mass", "inertia.0", "inertia.1", "inertia.2", "thrust_factor")
# Probability of a standard normal variable to be less than one standard deviation below its mean.
_BELOW = 0.5 * math.erfc(math.sqrt(0.5))


def flight_remarks(scenario: Scenario, plan: Plan | None = None) -> tuple[str, ...]:
    """Return remarks on a scenario's flight: on its vehicle, and on what it does after the end of its route.

    Args:
        scenario: with or without distributions.
        plan: that is flown; that of the scenario's route if not given.

    Raises:
        InputError: the route cannot be planned.
    """
    return (*_mixed_vehicles(scenario), *_braking(scenario, plan))


def _mixed_vehicles(scenario: Scenario) -> list[str]:
    """A remark on a vehicle that is not the one that its controllers believe in."""
    found = [
        f"{name} {_middle(flown):.4g} (believed {believed:.4g}){unit}"
        for name, believed, flown, unit in _airframes(scenario)
        if abs(_middle(flown) - believed) > max(_MIN_DIFFERENCE * believed, _MIN_DEVIATIONS * _deviation(flown))
    ]
    if not found:
        return []
    return [
        f"the vehicle that flies is far from the one that its controllers believe in: {', '.join(found)}; check that"
        " `vehicle` and `nominal` describe the same one"
    ]


def _airframes(scenario: Scenario) -> Iterator[tuple[str, float, Any, str]]:
    """Name, believed value, flown value and unit of what makes two airframes different."""
    for path in _COMPARED:
        name, _, item = path.partition(".")
        values = [getattr(part, name) for part in (scenario.nominal, scenario.vehicle)]
        believed, flown = (value[int(item)] if item else value for value in values)
        yield path, believed, flown, f" {unit_at(scenario, f'vehicle.{path}')}"
    if not (distributions_in(scenario.vehicle.layout) or isinstance(scenario.vehicle.arm_length, Distribution)):
        yield "arm length", arm_length_of(scenario.nominal), arm_length_of(scenario.vehicle), " m"


def _middle(value: Any) -> float:
    return float(value.quantile(0.5)) if isinstance(value, Distribution) else value


def _deviation(value: Any) -> float:
    """Half the width of the central interval that has the probability of one standard deviation about a normal mean."""
    if not isinstance(value, Distribution):
        return 0.0
    return 0.5 * float(value.quantile(1.0 - _BELOW) - value.quantile(_BELOW))


def _braking(scenario: Scenario, plan: Plan | None) -> list[str]:
    """A remark on the braking of a flight that goes on after a route that ends in motion."""
    if scenario.duration is None:
        return []
    plan = plan or plan_route(scenario)
    if not goes_on_in_motion(scenario, plan):
        return []
    end = float(plan.path.times[-1])
    speed = float(np.linalg.norm(evaluate(plan.path, [end], 1)))
    way = float(np.linalg.norm(plan.flown_path.waypoints[-1] - plan.path.waypoints[-1]))
    return [
        f"the route ends in motion ({speed:.2f} m/s) at {end:.2f} s, before the end of the flight; from there the"
        f" reference brakes until {plan.rest_time:.2f} s, {way:.2f} m further on, and rests"
    ]
