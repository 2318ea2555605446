"""Remarks on a nominal vehicle with implausible ratios of fields, as if one field had another unit."""

import math
from collections.abc import Iterator
from typing import Any

from drake_quad.scenario.layouts import arm_length_range, rotors_of

# Largest plausible ratio of total thrust to weight. Racing quadrotors have a ratio of about 15.
_MAX_THRUST_RATIO = 30.0
# Range of plausible ratios between a radius of gyration and the arm length. The ratio about the vertical axis is 1 if
# the whole mass is at the ends of the arms. It is 0.3 to 0.8 for the shipped vehicles.
_GYRATION_RATIOS = (0.1, 3.0)
_TYPICAL_GYRATION_RATIO = 0.5  # radius of gyration, relative to the arm length
# Range of plausible ratios between drag factor and thrust factor, m. The ratio is 8 to 17 % of the propeller diameter
# for the shipped vehicles, and propellers have diameters of 30 mm to 0.8 m.
_DRAG_RATIOS = (3e-4, 0.3)
# Largest plausible ratio between a rotor's moment of inertia and that of the vehicle about the vertical axis.
_MAX_ROTOR_INERTIA_RATIO = 0.5
_RAD_PER_SECOND_PER_RPM = math.tau / 60.0  # rad/s in one revolution per minute
# Other units in which a moment of inertia may have been given by mistake, with their conversion factors to kg m².
_INERTIA_UNITS = {"g m²": 1e-3, "kg cm²": 1e-4, "kg mm²": 1e-6, "g cm²": 1e-7, "g mm²": 1e-9}


def implausible_proportions(nominal: Any) -> Iterator[tuple[str, str]]:
    """Yield a field and a remark on it for each implausible ratio of a nominal vehicle."""
    arm = arm_length_range(nominal)[1]
    clauses = {axis: _inertia_clause(moment, nominal.mass, arm) for axis, moment in enumerate(nominal.inertia)}
    for axis, clause in clauses.items():
        if clause:
            yield f"inertia.{axis}", clause
            break
    if nominal.rotor_inertia > _MAX_ROTOR_INERTIA_RATIO * nominal.inertia[2]:
        yield "rotor_inertia", f"is {nominal.rotor_inertia:g} kg m², which is implausible compared with inertia.2"
    thrust, field, unit = _max_thrust(nominal)
    ratio = thrust / (nominal.mass * nominal.gravity)
    if ratio > _MAX_THRUST_RATIO:
        clause = f"results in a thrust of {ratio:.3g} times the weight, which is implausible; check its unit ({unit})"
        if field == "max_rotor_speed" and 1.0 < ratio * _RAD_PER_SECOND_PER_RPM**2 < _MAX_THRUST_RATIO:
            clause += (
                f": {nominal.max_rotor_speed:g} rpm are {nominal.max_rotor_speed * _RAD_PER_SECOND_PER_RPM:.4g} rad/s"
            )
        yield field, clause
    low, high = _DRAG_RATIOS
    for rotor in dict.fromkeys(rotors_of(nominal)):
        distance = rotor.drag_factor / rotor.thrust_factor
        if not low <= distance <= high:
            yield (
                "drag_factor",
                f"is {distance:.3g} m times the thrust factor, which is implausible; check the units of drag_factor"
                " (N m s²) and thrust_factor (N s²)",
            )
            return


def _max_thrust(nominal: Any) -> tuple[float, str, str]:
    """Return the total thrust at full speed, N, and the field that determines it, with its unit."""
    curve = nominal.motors.thrust_curve()
    if curve is not None:
        return 4.0 * sum(curve), "motors.curve", "N, at a throttle from 0 to 1"
    thrust = sum(rotor.thrust_factor for rotor in rotors_of(nominal)) * nominal.max_rotor_speed**2
    return thrust, "max_rotor_speed", "rad/s"


def _inertia_clause(moment: float, mass: float, arm: float) -> str:
    """Return a remark if a moment of inertia (kg m²) is implausible for mass (kg) and arm length (m), else ""."""
    low, high = _GYRATION_RATIOS
    gyration = math.sqrt(moment / mass)
    if low * arm <= gyration <= high * arm:
        return ""
    clause = f"is {moment:g} kg m², which is implausible for a mass of {mass:g} kg and arms of {arm:.3g} m"
    typical = mass * (_TYPICAL_GYRATION_RATIO * arm) ** 2
    unit, factor = min(_INERTIA_UNITS.items(), key=lambda each: abs(math.log(moment * each[1] / typical)))
    is_plausible = low * arm <= math.sqrt(moment * factor / mass) <= high * arm
    return f"{clause}; {moment:g} {unit} are {moment * factor:.4g} kg m²" if is_plausible else clause
