"""What a person should know of a flight before it is flown, in sentences."""

import numpy as np

from drake_quad.assembly.planning import goes_on_in_motion, plan_route
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario import Scenario


def flight_remarks(scenario: Scenario, plan: Plan | None = None) -> tuple[str, ...]:
    """Return remarks on a scenario's flight: on its vehicle, and on what it does after the end of its route.

    Args:
        scenario: with or without distributions.
        plan: that is flown; that of the scenario's route if not given.

    Raises:
        InputError: the route cannot be planned.
    """
    return (*_braking(scenario, plan),)


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
