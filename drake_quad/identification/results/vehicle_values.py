"""Access to parameters of a scenario, and to the effects to which the parameters belong."""

from collections.abc import Mapping

import numpy as np

from drake_quad.identification.results.estimates import scenario_path
from drake_quad.scenario.effects.effect import EFFECTS
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.motors import ThrottleMotors
from drake_quad.scenario.paths import leaves, map_leaves

# `max_rotor_speed` is multiplied by this factor, so that the limit has no effect on the thrust curve.
_SPEED_LIMIT_RATIO = 2.0


def with_effects(scenario: Scenario, names: tuple[str, ...]) -> Scenario:
    """Return the scenario with the effects to which the parameters belong. Added effects have zero coefficients.

    Args:
        scenario: scenario without distributions.
        names: names of the parameters as in `Estimates`.
    """
    vehicle = scenario.vehicle
    needed = {
        name: effect()
        for name, effect in EFFECTS.members.items()
        if any(parameter.startswith(f"{name}.") for parameter in names)
    }
    absent = {name: effect for name, effect in needed.items() if getattr(vehicle, name) is None}
    return scenario.model_copy(update={"vehicle": vehicle.model_copy(update=absent)}) if absent else scenario


def with_throttles(scenario: Scenario) -> Scenario:
    """Return the scenario with a vehicle that takes throttles.

    A vehicle that takes rotor speeds gets a thrust curve with the same full thrust, and a higher rotor speed limit.
    """
    vehicle = scenario.vehicle
    if vehicle.motors.take_throttles:
        return scenario
    full = vehicle.thrust_factor * vehicle.max_rotor_speed**2
    motors = ThrottleMotors(kind="throttle", curve=(0.0, 0.0, full))
    changes = {
        "motors": motors,
        "min_rotor_speed": 0.0,
        "max_rotor_speed": _SPEED_LIMIT_RATIO * vehicle.max_rotor_speed,
    }
    return scenario.model_copy(update={"vehicle": vehicle.model_copy(update=changes)})


def with_vehicle_values(scenario: Scenario, numbers: Mapping[str, float]) -> Scenario:
    """Set parameters of a scenario, by their names in `Estimates`, and add the effects to which they belong."""
    extended = with_effects(scenario, tuple(numbers))
    values = {scenario_path(name): value for name, value in numbers.items()}
    result: Scenario = map_leaves(extended, lambda path, old: values.get(path, old))
    return result


def vehicle_value(scenario: Scenario, name: str) -> float:
    """Return a parameter of a scenario, by its name in `Estimates`; 0 if its effect is absent."""
    value = dict(leaves(with_effects(scenario, (name,)))).get(scenario_path(name), np.nan)
    return float(value)
