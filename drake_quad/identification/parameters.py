"""Parameters that an identification may estimate, with their priors.

The prior of a parameter is a normal distribution around its value in the scenario. Its standard deviation is the scale
of the parameter, the typical error of a data sheet. The prior therefore matters only if the logs contain little
information. To add a parameter, add it to `_candidates`.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.identification.model import DELAY, MISALIGNMENT
from drake_quad.identification.prediction_errors import FORCE
from drake_quad.identification.results.vehicle_values import vehicle_value, with_effects
from drake_quad.scenario.layouts import arm_length_of
from drake_quad.scenario.models import Scenario

# Limits of a positive parameter in the fit, relative to its value in the scenario.
_MIN_POSITIVE_RATIO = 0.02  # smallest estimate
_MAX_POSITIVE_RATIO = 50.0  # largest estimate
# The prior standard deviations of time constants and of the delay do not depend on the initial values, which may be
# zero.
_TIME_CONSTANT_SCALE = 0.04  # s, standard deviation of the prior
_MIN_TIME_CONSTANT = 2e-3  # s, lower bound of an estimated time constant of the rotors
_DELAY_SCALE = 0.02  # s, standard deviation of the prior


class Parameter(NamedTuple):
    """Parameter with its prior.

    Attributes:
        name: name as in `Estimates`, or `DELAY`.
        start: mean of the prior, and initial value.
        scale: standard deviation of the prior, which is the typical error of a data sheet.
        lower: lower bound.
        upper: upper bound.
    """

    name: str
    start: float
    scale: float
    lower: float = -np.inf
    upper: float = np.inf


def parameters_of(
    scenario: Scenario, signals: set[str], *, has_motor_throttles: bool, delay: float, max_delay: float
) -> list[Parameter]:
    """Return the parameters that the predicted signals may identify.

    Args:
        scenario: scenario with the initial values.
        signals: signals that are predicted.
        has_motor_throttles: True if the logs contain a throttle for each motor, False if they contain only the total
            thrust.
        delay: initial delay, s.
        max_delay: largest delay in either direction, s.
    """
    candidates = [*_candidates(scenario, signals, has_motor_throttles)]
    scenario = with_effects(scenario, tuple(name for name, *_ in candidates))
    parameters = []
    for name, scale, allowed in candidates:
        start = vehicle_value(scenario, name)
        lower, upper = -np.inf, np.inf
        if allowed == "positive":
            lower, upper = _MIN_POSITIVE_RATIO * start, _MAX_POSITIVE_RATIO * start
            if name.startswith("rotor_time_constant"):
                lower = min(max(lower, _MIN_TIME_CONSTANT), start)
        elif allowed == "not negative":
            lower = 0.0
        parameters.append(Parameter(name, start, scale, lower, upper))
    parameters.append(Parameter(DELAY, delay, _DELAY_SCALE, -max_delay, max_delay))
    return parameters


def _candidates(scenario: Scenario, signals: set[str], has_motor_throttles: bool) -> Iterator[tuple[str, float, str]]:
    """Yield the name, the scale and the allowed values ("positive", "not negative" or "any") of each parameter."""
    vehicle: Any = scenario.vehicle
    autopilot: Any = scenario.laboratory.autopilot
    responds = scenario.laboratory.autopilot.models_vehicle
    measures_rotation = bool({"attitude", "body_rates"} & signals)
    measures_translation = bool({"position", "velocity"} & signals)
    mass, hover_thrust, arm_length = vehicle.mass, 0.25 * vehicle.mass * vehicle.gravity, arm_length_of(vehicle)
    if vehicle.motors.take_throttles:
        # If only heights are logged, or one common command for all motors, all thrusts are near the hover thrust. Such
        # logs identify only two coefficients of the thrust curve.
        powers = (0, 1, 2) if has_motor_throttles and measures_rotation else (0, 1) if measures_rotation else (0, 2)
        for i in powers:
            yield f"motors.curve[{i}]", hover_thrust, "any"
    else:
        yield "thrust_factor", vehicle.thrust_factor, "positive"
    yield "rotor_time_constant", _TIME_CONSTANT_SCALE, "positive"
    if vehicle.rotor_time_constant_down is not None and not responds:
        yield "rotor_time_constant_down", _TIME_CONSTANT_SCALE, "positive"
    if measures_rotation and responds:
        for i, frequency in enumerate(autopilot.natural_frequency):
            yield f"autopilot.natural_frequency[{i}]", 0.5 * frequency, "positive"
        for i in range(3):
            yield f"autopilot.damping[{i}]", 0.5, "positive"
    elif measures_rotation:
        for i in range(3):
            yield f"inertia[{i}]", vehicle.inertia[i], "positive"
        for i in range(2):
            yield f"centre_of_mass[{i}]", 0.2 * arm_length, "any"
        if vehicle.reaction_torque:
            yield "rotor_inertia", vehicle.rotor_inertia, "positive"
    if not responds and measures_rotation and FORCE in signals and vehicle.body_drag is not None:
        yield "body_drag.centre_of_pressure[2]", 0.2 * arm_length, "any"
    # Without a measured velocity, an accelerometer identifies only the product of drag and velocity.
    if not measures_translation:
        return
    if "attitude" in signals and "position" in signals:
        for name in MISALIGNMENT[:2]:
            yield name, 0.05, "any"
    if vehicle.linear_drag > 0.0:
        yield "linear_drag", vehicle.linear_drag, "not negative"
    if measures_rotation and (responds or vehicle.body_drag is not None):
        initial_drag = (0.0,) * 3 if vehicle.body_drag is None else vehicle.body_drag.linear
        for i in range(2):
            yield f"body_drag.linear[{i}]", max(0.3 * mass, initial_drag[i]), "not negative"
        if responds or FORCE in signals:
            for i in range(3):
                yield f"body_drag.quadratic[{i}]", 0.05 * mass, "not negative"
        if not responds and FORCE not in signals:
            yield "body_drag.centre_of_pressure[2]", 0.2 * arm_length, "any"
    if responds or vehicle.rotor_aerodynamics is not None:
        if responds:
            yield "rotor_aerodynamics.lift", 0.05 * mass, "not negative"
        yield "rotor_aerodynamics.climb", 0.3 * mass, "any"


def parameter_names(parameters: Sequence[Parameter]) -> list[str]:
    """Return the names of the given parameters, in order."""
    return [parameter.name for parameter in parameters]
