"""Duration of a flight, and the time window in which its metrics are computed."""

import math

import numpy as np

from drake_quad.errors import InputError
from drake_quad.planning.feasibility import check_obstacles, check_rotors
from drake_quad.reference.plan import PATH_ORDERS, Plan
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate
from drake_quad.reference.rest import moves_at_end
from drake_quad.scenario.limits import MAX_TICKS
from drake_quad.scenario.models import Scenario

# Number of times at which the final braking, a polynomial of degree 6, is checked.
_NUM_BRAKING_SAMPLES = 200
# Largest distance by which a position may lie outside a box, m. A path that ends on a face of a box leaves it by up to
# about 1e-6 m.
_BOX_TOLERANCE = 1e-4


def flight_duration(scenario: Scenario, plan: Plan) -> float:
    """Return the duration of a scenario's flight, s, rounded up to whole control ticks.

    Raises:
        InputError: if the metric window begins after the end of the flight, the flight has too many ticks, or the plan
            ends in motion and the vehicle cannot brake afterwards.
    """
    shortest_period, tick = min(scenario.periods.values()), scenario.laboratory.command_link.period
    requested = scenario.duration if scenario.duration is not None else float(plan.path.times[-1])
    duration = _whole_ticks(requested, scenario)
    if duration > MAX_TICKS * shortest_period + tick:
        raise InputError(
            f"the flight would take {duration:g} s, but must take at most {MAX_TICKS * shortest_period:g} s, which is"
            f" {MAX_TICKS:,} times the shortest period"
        )
    start = window_start(scenario, plan)
    if start >= duration:
        lap = scenario.metrics.first_lap
        if lap is not None:
            raise InputError(
                f"metrics.first_lap is {lap}, but this lap starts at {start:g} s and must start before the end of the"
                f" flight at {duration:g} s"
            )
        raise InputError(f"metrics.start is {start:g} s, but must be before the end of the flight at {duration:g} s")
    if continues_in_motion(scenario, plan):
        _check_braking(scenario, plan)
    return duration


def _whole_ticks(time: float, scenario: Scenario) -> float:
    """Round a time (s) up to whole control ticks, at least one tick."""
    period = scenario.laboratory.command_link.period
    return max(1, math.ceil(time / period - 1e-9)) * period


def continues_in_motion(scenario: Scenario, plan: Plan) -> bool:
    """Return whether the plan ends in motion and the flight continues after the plan."""
    return (
        scenario.duration is not None
        and plan.brakes
        and _whole_ticks(scenario.duration, scenario) > _whole_ticks(float(plan.path.times[-1]), scenario)
    )


def _check_braking(scenario: Scenario, plan: Plan) -> None:
    """Raise InputError if braking after a plan exceeds rotor limits, leaves the permitted space or hits an obstacle."""
    end, remedy = float(plan.path.times[-1]), "end the route at rest, or leave duration out"
    times = np.linspace(end, plan.rest_time, _NUM_BRAKING_SAMPLES)
    try:
        check_rotors(plan, scenario, times)
        if moves_at_end(plan.path, PATH_ORDERS):
            _check_boxes(evaluate(plan.extended_path, times), scenario)
            if scenario.space is not None:
                braking = PolynomialPath(plan.extended_path.times[-3:-1], plan.extended_path.coefficients[-2:-1])
                check_obstacles(braking, scenario.flight_space())
    except InputError as error:
        raise InputError(
            f"duration is {scenario.duration:g} s, but the route ends in motion at {end:.2f} s, and the vehicle"
            f" cannot brake after it ({error}); {remedy}"
        ) from None


def _check_boxes(positions: np.ndarray, scenario: Scenario) -> None:
    """Raise InputError if positions leave the scenario's boxes or are below `crash.height`.

    Args:
        positions: (3, n) positions in W, m.
        scenario: scenario with the boxes `space.bounds` and `route.space`, if any.
    """
    boxes = {
        "space.bounds": None if scenario.space is None else scenario.space.bounds,
        "route.space": getattr(scenario.route, "space", None),
    }
    for name, region in boxes.items():
        box = None if region is None else region.box()
        excess = (
            0.0 if box is None else float(np.max([box.low - positions.min(axis=1), positions.max(axis=1) - box.high]))
        )
        if excess > _BOX_TOLERANCE:
            raise InputError(f"the braking path leaves {name} by {excess:.2f} m")
    lowest = float(positions[2].min())
    if lowest < scenario.crash.height:
        raise InputError(
            f"the braking path descends to {lowest:.2f} m, below crash.height, {scenario.crash.height:g} m"
        )


def window_end(scenario: Scenario, plan: Plan) -> float:
    """Return the end of the metric window, s; infinity if metrics are computed until the end of the flight.

    If the window begins with a lap, it ends with the last lap, even if the flight continues.
    """
    window = scenario.metrics
    if window.end is not None:
        return window.end
    return math.inf if window.first_lap is None else _whole_ticks(plan.lap_times[-1], scenario)


def window_start(scenario: Scenario, plan: Plan) -> float:
    """Return the start of the metric window, s.

    Raises:
        InputError: if the window begins with a lap whose number exceeds the laps of the plan.
    """
    window = scenario.metrics
    if window.first_lap is None:
        return window.start
    starts = plan.lap_times[:-1]
    if window.first_lap > len(starts):
        raise InputError(f"metrics.first_lap is {window.first_lap}, but the route has {len(starts)} laps")
    return starts[window.first_lap - 1]
