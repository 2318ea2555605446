"""Checks whether a layout of four rotors can produce every wrench, and whether it can hover."""

import numpy as np

from drake_quad.vehicle.mixer import mixer_from_parameters
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.rotors import Rotors

# Smallest accepted ratio of the smallest to the largest singular value of the scaled map from rotor forces to the
# wrench. With a smaller ratio, a part of the wrench would depend on differences between the rotors of only about a
# thousandth of the arm length or of the drag factor.
_MIN_SINGULAR_VALUE = 1e-3
# Components of a unit vector below this magnitude are not mentioned in a message.
_MIN_COMPONENT = 0.02
# Tolerance on the fraction of the thrust that a rotor carries, relative to the largest fraction.
_FRACTION_TOLERANCE = 1e-9
_WRENCH_PARTS = ("thrust", "roll torque", "pitch torque", "yaw torque")


def explain_missing_wrench(rotors: Rotors) -> str | None:
    """Return a description of the wrench that four rotors cannot produce; None if they can produce every wrench.

    Args:
        rotors: rotors of one vehicle or of several. The result describes the first vehicle that cannot produce every
            wrench.
    """
    rows = [
        row
        for rotor in rotors
        for row in (1.0, rotor.y, -rotor.x, -rotor.direction * rotor.drag_factor / rotor.thrust_factor)
    ]
    # The matrices `maps` (N, 4, 4) map the rotor forces to the wrench of each vehicle.
    maps = np.array(np.broadcast_arrays(*rows), dtype=float).reshape(4, 4, -1).T
    _, *arms, levers = np.moveaxis(maps, 1, 0)
    arm, lever = np.hypot(*arms).max(axis=1), np.abs(levers).max(axis=1)
    if not arm.all():
        return "roll and pitch torque, since all its rotors are at the centre"
    scaled = maps / np.stack([np.ones_like(arm), arm, arm, lever], axis=1)[..., None]
    largest, *_, smallest = np.linalg.svd(scaled, compute_uv=False).T
    for flat in scaled[smallest < _MIN_SINGULAR_VALUE * largest]:
        *_, direction = np.linalg.svd(flat).U.T
        return _describe_missing(direction)
    return None


def _describe_missing(direction: np.ndarray) -> str:
    """Return a description of a wrench that the rotors cannot produce, given its direction in scaled coordinates."""
    thrust, roll, pitch, yaw = np.abs(direction) > _MIN_COMPONENT
    if roll and pitch and not thrust and not yaw:
        _, x, y, _ = direction
        size = np.copysign(np.hypot(x, y), x)
        return f"torque about the axis ({x / size:.2f}, {y / size:.2f}, 0), since its rotors are in a line"
    # All producible wrenches are orthogonal to `direction`. If `direction` has several non-zero components, for example
    # thrust and yaw torque, a wrench with only the last of them is therefore not producible.
    names = [name for name, part in zip(_WRENCH_PARTS, (thrust, roll, pitch, yaw), strict=True) if part]
    *others, lacking = names
    if not others:
        return f"{lacking}, since its rotors are in a line"
    reason = ", since its rotors all turn the same way" if names == ["thrust", "yaw torque"] else ""
    *more, last = others
    return f"{lacking} without {', '.join(more) + ' and ' if more else ''}{last}{reason}"


def explain_infeasible_hover(rotors: Rotors, *, min_speed: float, max_speed: float) -> str | None:
    """Return the reason why four rotors cannot produce thrust without torque; None if they can.

    Args:
        rotors: rotors of one vehicle, for which `explain_missing_wrench` is None.
        min_speed: idle speed, rad/s.
        max_speed: maximum speed, rad/s.
    """
    fractions = [float(row.thrust) for row in mixer_from_parameters(QuadrotorParameters(rotors=rotors))]
    for number, fraction in enumerate(fractions, start=1):
        if not fraction > _FRACTION_TOLERANCE * max(fractions):
            action = "stand still" if fraction > -_FRACTION_TOLERANCE * max(fractions) else "push down"
            return f"rotor {number} would have to {action}"
    slowest, fastest = (np.sqrt(part / max(fractions)) for part in (min(fractions), max(fractions)))
    if not min_speed < max_speed * slowest / fastest:
        number = fractions.index(min(fractions)) + 1
        return (
            f"rotor {number} would have to turn at {slowest:.2g} times the speed of the fastest rotor, which is less"
            " than min_rotor_speed / max_rotor_speed"
        )
    return None
