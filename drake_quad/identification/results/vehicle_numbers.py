"""Scenarios with other numbers: estimates put in, effects switched on that estimates speak of."""

from collections.abc import Mapping

import numpy as np

from drake_quad.identification.results.estimates import scenario_path
from drake_quad.scenario.effects.effect import EFFECTS
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.motors import ThrottleMotors
from drake_quad.scenario.paths import leaves, replaced

# Of the top speed, beyond which throttles do not bring rotors.
_AMPLE = 2.0


def with_effects(scenario: Scenario, names: tuple[str, ...]) -> Scenario:
    """The scenario with all effects switched on that numbers of these names belong to, at zero.

    Args:
        scenario: with numbers.
        names: as in `Estimates`.
    """
    vehicle = scenario.vehicle
    wanted = {
        name: effect() for name, effect in EFFECTS.members.items() if any(each.startswith(f"{name}.") for each in names)
    }
    absent = {name: effect for name, effect in wanted.items() if getattr(vehicle, name) is None}
    return scenario.model_copy(update={"vehicle": vehicle.model_copy(update=absent)}) if absent else scenario


def with_throttles(scenario: Scenario) -> Scenario:
    """The scenario with a vehicle that takes throttles; one that takes speeds gets a curve up to its full thrust.

    Its rotors may turn twice as fast as before, so that no limit bends a curve that turns out to be higher.

    Args:
        scenario: with numbers.
    """
    vehicle = scenario.vehicle
    if vehicle.motors.take_throttles:
        return scenario
    full = vehicle.thrust_factor * vehicle.max_rotor_speed**2
    motors = ThrottleMotors(kind="throttle", curve=(0.0, 0.0, full))
    changes = {"motors": motors, "min_rotor_speed": 0.0, "max_rotor_speed": _AMPLE * vehicle.max_rotor_speed}
    return scenario.model_copy(update={"vehicle": vehicle.model_copy(update=changes)})


def with_numbers(scenario: Scenario, numbers: Mapping[str, float]) -> Scenario:
    """The scenario with these numbers, by name as in `Estimates`; effects that they belong to are switched on."""
    own = with_effects(scenario, tuple(numbers))
    values = {scenario_path(name): value for name, value in numbers.items()}
    found: Scenario = replaced(own, lambda path, old: values.get(path, old))
    return found


def number_of(scenario: Scenario, name: str) -> float:
    """A number of a scenario, by its name as in `Estimates`; 0 of an effect that is switched off."""
    found = dict(leaves(with_effects(scenario, (name,)))).get(scenario_path(name), np.nan)
    return float(found)
