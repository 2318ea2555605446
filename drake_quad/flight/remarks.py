"""Remarks on a scenario that a user should read before using the results of its flights."""

import functools
import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.flight.mission import plan_route
from drake_quad.planning.duration import continues_in_motion
from drake_quad.reference.feasibility import sample_times
from drake_quad.reference.plan import YAW_ORDERS, Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.reference.rest import moves_at_end
from drake_quad.scenario.description import unit_at
from drake_quad.scenario.distributions import Distribution
from drake_quad.scenario.layouts import arm_length_of, rotors_of
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in, join_path, leaves, mappings_in
from drake_quad.scenario.plausible import Plausible, PlausibleDelay

# A field of the flown vehicle is reported if it differs from the nominal value by more than two limits: a fraction of
# the nominal value, which is larger than the error of any scale or data sheet, and a multiple of the standard deviation
# of the field.
_MIN_RELATIVE_DIFFERENCE = 0.2  # relative to the nominal value, or to the arm length for a position
_MIN_MASS_DIFFERENCE = 0.05  # the same for the mass, which scales measure precisely
_MIN_NUM_SIGMAS = 5.0  # standard deviations of the field
# Smallest reported offset of the centre of mass, relative to the arm length. At this offset, the rotors on one side
# produce 10 % more thrust in hover, and the rotors on the other side 10 % less.
_MIN_RELATIVE_OFFSET = 0.1
_MAX_CHANGE_LENGTH = 120  # largest number of characters that describe the change of one field
# The speed limits of the rotors are not compared, since they depend on the type of motor.
_COMPARED_FIELDS = ("mass", "inertia.0", "inertia.1", "inertia.2", "thrust_factor", "drag_factor", "gravity")
# Probability that a normal random variable is more than one standard deviation below its mean.
_LOWER_SIGMA_PROBABILITY = 0.5 * math.erfc(math.sqrt(0.5))


def flight_remarks(scenario: Scenario, plan: Plan | None = None) -> tuple[str, ...]:
    """Return remarks on settings that the user may not have intended.

    The remarks concern implausible values, a vehicle that differs from the nominal one, settings without effect, crash
    limits that the flight must exceed, and a route that ends in motion. Remarks that depend on the plan are left out if
    the route cannot be planned, for example because it is random.

    Args:
        scenario: scenario to fly, which may contain distributions.
        plan: plan to fly; by default the plan for the scenario's route.
    """
    flight = _PlannedFlight(scenario, plan)
    return (
        *_implausible_values(scenario),
        *_mixed_vehicles(scenario),
        *_inactive_settings(flight),
        *_certain_crashes(flight),
        *braking_remarks(scenario, flight.plan),
    )


class _PlannedFlight:
    """Scenario and its plan, which is computed only when it is needed.

    Args:
        scenario: scenario to fly.
        plan: plan to fly; None to plan the scenario's route.
    """

    def __init__(self, scenario: Scenario, plan: Plan | None) -> None:
        self.scenario, self._plan = scenario, plan

    @functools.cached_property
    def plan(self) -> Plan | None:
        """Plan of the route; None if the route cannot be planned."""
        if self._plan is None:
            with suppress(InputError):
                return plan_route(self.scenario)
        return self._plan

    @property
    def end(self) -> float:
        """Time at which the flight ends, s; infinite if it is not known."""
        if self.scenario.duration is not None:
            return self.scenario.duration
        return math.inf if self.plan is None else float(self.plan.path.times[-1])

    @property
    def lowest_height(self) -> float:
        """Smallest height of the reference, m; minus infinity if it is not known."""
        if self.plan is None:
            return -math.inf
        path, rest_height = self.plan.path, self.plan.extended_path.waypoints[-1][2]
        return min(float(rest_height), float(evaluate(path, sample_times(path))[2].min()))


def unequal_conditions(scenarios: Mapping[str, Scenario]) -> list[str]:
    """Return a remark on each controller whose flight conditions differ from the conditions of the first controller.

    The conditions are all fields of a scenario except for `control` and `nominal`. The nominal vehicle is not a
    condition of the flight, since it is the model that the controller assumes.

    Args:
        scenarios: scenarios, keyed by the names of their controllers.
    """
    (first, expected), *others = ((name, _conditions(scenario)) for name, scenario in scenarios.items())
    remarks = []
    for name, conditions in others:
        paths = [path for path in {**expected, **conditions} if conditions.get(path) != expected.get(path)]
        changes = [f"{path} {_format(conditions.get(path))} (not {_format(expected.get(path))})" for path in paths]
        if changes:
            shown_changes = join_names(changes, 4, max_length=_MAX_CHANGE_LENGTH)
            remarks.append(f"{name} and {first} do not fly under the same conditions: {shown_changes}")
    return remarks


def replaced_distributions(before: Scenario, after: Scenario, *, ignored: tuple[str, ...] = ()) -> str:
    """Return a text that lists the random fields of a scenario that are no longer random after a change.

    The text is empty if all random fields are still random.

    Args:
        before: scenario with the distributions.
        after: changed scenario, for example with another controller.
        ignored: paths of mappings whose fields are left out.
    """
    drawn, values = distributions_in(after), dict(leaves(after))
    replaced = [
        f"{path} {_format(values.get(path))} (not {distribution})"
        for path, distribution in distributions_in(before).items()
        if path not in drawn and not f"{path}.".startswith(tuple([f"{each}." for each in ignored]))
    ]
    return join_names(replaced, 4, max_length=_MAX_CHANGE_LENGTH)


def _conditions(scenario: Scenario) -> dict[str, Any]:
    return {path: value for path, value in leaves(scenario) if path.partition(".")[0] not in ("control", "nominal")}


def _format(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value)


def _mixed_vehicles(scenario: Scenario) -> list[str]:
    """Return a remark if the flown vehicle differs strongly from the nominal one, which the controllers assume."""
    differences = [
        f"{name} {_median(actual):.4g}{unit} (nominal {nominal_value:.4g})"
        for name, nominal_value, actual, unit in _compared_quantities(scenario)
        if abs(_median(actual) - nominal_value)
        > max(
            (_MIN_MASS_DIFFERENCE if name == "mass" else _MIN_RELATIVE_DIFFERENCE) * nominal_value,
            _MIN_NUM_SIGMAS * _deviation(actual),
        )
    ]
    differences += _rotor_differences(scenario)
    if not differences:
        return []
    return [
        f"`vehicle` differs strongly from `nominal`, the model that controllers use: {', '.join(differences)}; check"
        " that both describe the same vehicle"
    ]


def _rotor_differences(scenario: Scenario) -> list[str]:
    """Return the differences in the positions and directions of the rotors, and in the centre of mass."""
    vehicle, nominal = scenario.vehicle, scenario.nominal
    arm = arm_length_of(nominal)
    differences = [
        f"centre_of_mass.{i} {_median(each):.4g} m (nominal 0)"
        for i, each in enumerate(vehicle.centre_of_mass)
        if abs(_median(each)) > max(_MIN_RELATIVE_OFFSET * arm, _MIN_NUM_SIGMAS * _deviation(each))
    ]
    if distributions_in(vehicle.layout):
        return differences
    if isinstance(vehicle.arm_length, Distribution):
        vehicle = vehicle.model_copy(update={"arm_length": _median(vehicle.arm_length)})
    # The arm length is compared separately, so positions are compared relative to it.
    scale = arm / arm_length_of(vehicle)
    pairs = [*enumerate(zip(rotors_of(vehicle), rotors_of(nominal), strict=True), start=1)]
    reversed_rotors = [
        str(i)
        for i, (rotor_of_vehicle, nominal_rotor) in pairs
        if rotor_of_vehicle.direction != nominal_rotor.direction
    ]
    if reversed_rotors:
        differences.append(f"direction of rotor {', '.join(reversed_rotors)}")
    for i, (rotor_of_vehicle, nominal_rotor) in pairs:
        if (
            math.hypot(scale * rotor_of_vehicle.x - nominal_rotor.x, scale * rotor_of_vehicle.y - nominal_rotor.y)
            > _MIN_RELATIVE_DIFFERENCE * arm
        ):
            positions = (f"({rotor.x:.3g}, {rotor.y:.3g}) m" for rotor in (rotor_of_vehicle, nominal_rotor))
            differences.append(f"rotor {i} at {next(positions)} (nominal {next(positions)})")
            break
    return differences


def _compared_quantities(scenario: Scenario) -> Iterator[tuple[str, float, Any, str]]:
    """Yield the name, nominal value, flown value and unit of each quantity that `_mixed_vehicles` compares."""
    for path in _COMPARED_FIELDS:
        name, _, item = path.partition(".")
        values = [getattr(part, name) for part in (scenario.nominal, scenario.vehicle)]
        nominal_value, actual = (value[int(item)] if item else value for value in values)
        yield path, nominal_value, actual, f" {unit_at(scenario, f'vehicle.{path}')}"
    if not (distributions_in(scenario.vehicle.layout) or isinstance(scenario.vehicle.arm_length, Distribution)):
        yield "arm length", arm_length_of(scenario.nominal), arm_length_of(scenario.vehicle), " m"


def _median(value: Any) -> float:
    return float(value.quantile(0.5)) if isinstance(value, Distribution) else value


def _deviation(value: Any) -> float:
    """Return half the width of the central 68.3 % interval, which is the standard deviation if the value is normal."""
    if not isinstance(value, Distribution):
        return 0.0
    return 0.5 * float(value.quantile(1.0 - _LOWER_SIGMA_PROBABILITY) - value.quantile(_LOWER_SIGMA_PROBABILITY))


def _implausible_values(scenario: Scenario) -> list[str]:
    """Return a remark on each value that was probably given in another unit."""
    tick = scenario.laboratory.command_link.period
    clauses: dict[str, str] = {}
    for path, mapping in mappings_in(scenario):
        period = getattr(mapping, "period", None) or tick
        found = {
            join_path(path, leaf_path): clause
            for name, field in type(mapping).model_fields.items()
            for condition in field.metadata
            if isinstance(condition, Plausible | PlausibleDelay)
            for leaf_path, leaf in leaves(getattr(mapping, name), name)
            if (clause := condition.explain_implausibility(leaf, period))
        }
        # The combination of fields is checked only if each field by itself is plausible.
        clauses |= found or {join_path(path, inner): clause for inner, clause in mapping.implausible_fields()}
    # If `vehicle` has an implausible value of `nominal`, only the remark on `nominal` is returned.
    return [
        f"{path} {clause}"
        for path, clause in clauses.items()
        if not (path.startswith("vehicle.") and clauses.get(f"nominal.{path.removeprefix('vehicle.')}") == clause)
    ]


def _inactive_settings(flight: _PlannedFlight) -> list[str]:
    """Return a list of remarks, each of which lists the settings that have no effect for one reason."""
    paths: dict[str, list[str]] = {}
    inactive: list[str] = []
    for path, mapping in mappings_in(flight.scenario):
        for setting in mapping.inactive_settings(flight, path):
            # If a whole mapping has no effect, its fields are not reported one by one.
            if not f"{setting.path}.".startswith(tuple([f"{each}." for each in inactive])):
                inactive.append(setting.path)
                paths.setdefault(setting.reason, []).append(setting.path)
    return [
        f"{join_names(each)} {'has' if len(each) == 1 else 'have'} no effect, since {reason}"
        for reason, each in paths.items()
    ]


def _certain_crashes(flight: _PlannedFlight) -> Iterator[str]:
    """Yield a remark on each limit of `crash` that the initial state or the reference exceeds."""
    crash, initial = flight.scenario.crash, flight.scenario.initial
    if -math.inf < flight.lowest_height <= crash.height:
        yield (
            f"crash.height is {crash.height:g} m, but the reference flies as low as {flight.lowest_height:.3g} m, so a"
            " vehicle that follows it counts as crashed"
        )
    roll, pitch = (abs(_median(angle)) for angle in initial.attitude[:2])
    if crash.tilt is not None and max(roll, pitch) > crash.tilt:
        yield (
            f"initial.attitude is a tilt of {max(roll, pitch):.3g} rad, but crash.tilt is {crash.tilt:.3g} rad, so the"
            " vehicle counts as crashed from the beginning; null allows every tilt"
        )


def braking_remarks(scenario: Scenario, plan: Plan | None) -> list[str]:
    """Return a remark if the route ends in motion before the end of the flight, so that the reference must brake.

    Args:
        scenario: scenario to fly.
        plan: plan to fly; None if the route cannot be planned.
    """
    if scenario.duration is None or plan is None or not continues_in_motion(scenario, plan):
        return []
    end = float(plan.path.times[-1])
    motion = f"{np.linalg.norm(evaluate(plan.path, [end], 1)):.2f} m/s"
    if moves_at_end(plan.yaw, YAW_ORDERS):
        motion += f", {evaluate(plan.yaw, [end], 1).item():.2f} rad/s of yaw"
    distance = float(np.linalg.norm(plan.extended_path.waypoints[-1] - plan.path.waypoints[-1]))
    return [
        f"the route ends in motion ({motion}) at {end:.2f} s, before the end of the flight; the reference then"
        f" brakes and comes to rest at {plan.rest_time:.2f} s, {distance:.2f} m beyond the end of the route"
    ]
