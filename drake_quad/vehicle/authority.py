"""Which wrenches four rotors can give at all."""

import numpy as np

from drake_quad.vehicle.mixer import mixer_of
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.rotors import Rotors

# A layout is refused if some part of a wrench takes so many times the effort of another: then a thousandth of the arm,
# or of the drag factor, would have to give it.
_LEAST_SHARE = 1e-3
# Parts of a direction that are not worth a word.
_NOTHING = 0.02
# What a share of the thrust may be off, over the largest.
_ROUNDING = 1e-9
_PARTS = ("thrust", "roll torque", "pitch torque", "yaw torque")


def missing_direction(rotors: Rotors) -> str | None:
    """Says which part of a wrench four rotors cannot give; None if they can give all.

    Args:
        rotors: of one vehicle, or of several, of which the first to lack something counts.
    """
    rows = [
        row
        for rotor in rotors
        for row in (1.0, rotor.y, -rotor.x, -rotor.direction * rotor.drag_factor / rotor.thrust_factor)
    ]
    # From forces to the wrench of each vehicle.
    maps = np.array(np.broadcast_arrays(*rows), dtype=float).reshape(4, 4, -1).T
    _, *arms, levers = np.moveaxis(maps, 1, 0)
    arm, lever = np.hypot(*arms).max(axis=1), np.abs(levers).max(axis=1)
    if not arm.all():
        return "roll and pitch torque, since its rotors are all in the middle"
    scaled = maps / np.stack([np.ones_like(arm), arm, arm, lever], axis=1)[..., None]
    largest, *_, least = np.linalg.svd(scaled, compute_uv=False).T
    for flat in scaled[least < _LEAST_SHARE * largest]:
        *_, direction = np.linalg.svd(flat).U.T
        return _lacking(direction)
    return None


def _lacking(direction: np.ndarray) -> str:
    """What is missing, given the direction of a scaled wrench that no rotor has a part in."""
    thrust, roll, pitch, yaw = np.abs(direction) > _NOTHING
    if roll and pitch and not thrust and not yaw:
        _, x, y, _ = direction
        size = np.copysign(np.hypot(x, y), x)
        return f"torque about the axis ({x / size:.2f}, {y / size:.2f}, 0), since its rotors are in a line"
    # What is tied to the thrust, or to another torque: a torque that cannot be had without it.
    names = [name for name, part in zip(_PARTS, (thrust, roll, pitch, yaw), strict=True) if part]
    *others, lacking = names
    if not others:
        return f"{lacking}, since its rotors are in a line"
    reason = ", since its rotors all turn the same way" if names == ["thrust", "yaw torque"] else ""
    *more, last = others
    return f"{lacking} without {', '.join(more) + ' and ' if more else ''}{last}{reason}"


def hover_flaw(rotors: Rotors, *, min_speed: float, max_speed: float) -> str | None:
    """Says why four rotors cannot give thrust without torque; None if they can.

    Args:
        rotors: of one vehicle, which can give any direction of a wrench.
        min_speed: idle, rad/s.
        max_speed: the largest, rad/s.
    """
    shares = [float(row.thrust) for row in mixer_of(QuadrotorParameters(rotors=rotors))]
    for number, share in enumerate(shares, start=1):
        if not share > _ROUNDING * max(shares):
            return f"rotor {number} would have to {'stand still' if share > -_ROUNDING * max(shares) else 'push down'}"
    slowest, fastest = (np.sqrt(part / max(shares)) for part in (min(shares), max(shares)))
    if not min_speed < max_speed * slowest / fastest:
        number = shares.index(min(shares)) + 1
        return (
            f"rotor {number} would have to turn {slowest:.2g} times as fast as the fastest, less than min_rotor_speed"
            " over max_rotor_speed"
        )
    return None
