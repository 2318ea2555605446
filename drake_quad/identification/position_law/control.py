"""Conversion of an identified position law to the `control` section of a scenario.

A law whose velocity feed-forward gain is zero or equal to the velocity gain is a PD or PID of the position (`control`
of kind `cascade`). Any other law is a cascade of PIDs on position and velocity (`pid_cascade`), whose gains follow from
the equations of `drake_quad.identification.position_law.law`.
"""

import math
from collections.abc import Callable
from typing import Any

from drake_quad.errors import InputError
from drake_quad.identification.position_law.law import AxisLaw, PositionLaw

_FEED_FORWARD_TOLERANCE = 0.05  # a feed-forward ratio that differs from 0 or 1 by at most this is set to 0 or 1
_NEGLIGIBLE_GAIN_RATIO = 0.005  # gains, in SI units, below this fraction of the position gain are negligible
_UNREACHABLE_SPEED = 1000.0  # m/s, speed limit that has no effect
_NUM_DIGITS = 5  # significant digits of written gains, more than the data determine


def control_layer(law: PositionLaw) -> dict[str, Any]:
    """Return the scenario layer with a controller that has the given position law.

    The layer contains no attitude controller, no limits on tilt and thrust, and no delays. The scenario must contain
    them: with a `control` of kind `cascade` for a PD or PID, and with an attitude controller on board for a
    `pid_cascade`.

    Raises:
        InputError: if an axis is not identified, or no control of the scenario language can represent the law.
    """
    if law.not_identified:
        axes = ", ".join(law.not_identified)
        raise InputError(f"no controller can be written, because the law is not identified on {axes}")
    x, y, z = (next(axis_law for axis_law in law.axes if axis in axis_law.axes) for axis in ("x", "y", "z"))
    is_pid = law.form != "tilt" and all(map(_is_pid, (x, y, z)))
    feed_forwards = [
        _velocity_feed_forward(axis_law) for axis_law in (x, y, z) if "reference_velocity" in axis_law.gains
    ]
    feed_forward = sum(feed_forwards) / len(feed_forwards) if feed_forwards else 1.0
    if is_pid and feed_forward in (0.0, 1.0):
        # The layer does not set `control.kind`, so that the attitude control of the scenario is kept.
        return {"control": {"position": _pid((x, y, z), feed_forward)}}
    return {"control": _pid_cascade((x, y, z), feed_forward, law.form)}


def _is_near(value: float, half_width: float, target: float) -> bool:
    return abs(value - target) <= max(half_width, _FEED_FORWARD_TOLERANCE)


def _velocity_feed_forward(law: AxisLaw) -> float:
    """Return the fraction of the reference velocity that is fed forward; exactly 0 or 1 if it is close to it."""
    velocity, reference = law.gain("velocity"), law.gains["reference_velocity"]
    value, half_width = reference.value / velocity, reference.half_width / abs(velocity)
    return next((exact for exact in (0.0, 1.0) if _is_near(value, half_width, exact)), value)


def _differs_from_zero(law: AxisLaw, name: str) -> bool:
    """Return whether a gain is significant, and not negligible relative to the position gain."""
    if name not in law.gains:
        return False
    value = abs(law.gains[name].value)
    return value > law.gains[name].half_width and value > _NEGLIGIBLE_GAIN_RATIO * law.gain("position")


def _is_pid(law: AxisLaw) -> bool:
    """Return whether a law is a PD or PID on the position, with full or no feed-forward of the acceleration."""
    feed_forward = law.gains.get("reference_acceleration")
    is_all_or_none = feed_forward is None or any(
        _is_near(feed_forward.value, feed_forward.half_width, exact) for exact in (0.0, 1.0)
    )
    return is_all_or_none and not any(
        _differs_from_zero(law, name) for name in ("displacement", "double_integral", "error_limit")
    )


def _per_axis(laws: tuple[AxisLaw, AxisLaw, AxisLaw], value: Callable[[AxisLaw], float]) -> list[float]:
    return [float(f"{value(law):.{_NUM_DIGITS}g}") for law in laws]


def _pid(laws: tuple[AxisLaw, AxisLaw, AxisLaw], feed_forward: float) -> dict[str, Any]:
    """Return the scenario fields of a PD or PID controller with the identified gains."""
    has_integral = any(_differs_from_zero(law, "integral") for law in laws)
    accelerations = [law.gain("reference_acceleration") for law in laws if "reference_acceleration" in law.gains]
    fields: dict[str, Any] = {
        "kind": "pid" if has_integral else "pd",
        "k_p": _per_axis(laws, lambda law: law.gain("position")),
        "k_d": _per_axis(laws, lambda law: law.gain("velocity")),
        "derivative": "tracking_error" if feed_forward else "measurement",
        "feed_forward": "acceleration" if accelerations and max(accelerations) > 0.5 else "none",
    }
    if has_integral:
        fields["k_i"] = _per_axis(laws, lambda law: max(0.0, law.gain("integral")))
    return fields


def _pid_cascade(laws: tuple[AxisLaw, AxisLaw, AxisLaw], feed_forward: float, form: str) -> dict[str, Any]:
    """Return the scenario fields of a PID cascade with the identified gains."""
    gains = {id(law): _cascade_gains(law, feed_forward) for law in laws}
    position: dict[str, Any] = {"k_p": _per_axis(laws, lambda law: gains[id(law)][0])}
    velocity: dict[str, Any] = {"k_p": _per_axis(laws, lambda law: law.gain("velocity"))}
    for loop, index in ((position, 1), (velocity, 2)):
        terms = _per_axis(laws, lambda law: gains[id(law)][index])  # noqa: B023
        if any(terms):
            loop["k_i"] = terms
    if any("error_limit" in law.gains for law in laws):
        position["limit"] = _per_axis(
            laws,
            lambda law: (
                gains[id(law)][0] * law.gain("error_limit") if "error_limit" in law.gains else _UNREACHABLE_SPEED
            ),
        )
    command: dict[str, Any] = {"kind": "tilt"}
    if form != "tilt":
        accelerations = [law.gain("reference_acceleration") for law in laws if "reference_acceleration" in law.gains]
        mean = sum(accelerations) / len(accelerations) if accelerations else 0.0
        command = {"kind": "acceleration", "feed_forward": float(f"{max(0.0, mean):.{_NUM_DIGITS}g}")}
    return {
        "kind": "pid_cascade",
        "position": position,
        "velocity": velocity,
        "velocity_feed_forward": float(f"{max(0.0, feed_forward):.{_NUM_DIGITS}g}"),
        "command": command,
    }


def _cascade_gains(law: AxisLaw, feed_forward: float) -> tuple[float, float, float]:
    """Return the position gain, and the integral gains of the position loop and of the velocity loop.

    Raises:
        InputError: if no cascade can represent the law.
    """
    velocity_gain, proportional = law.gain("velocity"), law.gain("position")
    integral = law.gain("integral") if _differs_from_zero(law, "integral") else 0.0
    if feed_forward == 1.0:
        # The larger root of k K² - k_p K + k_i = 0 is the position gain K. The smaller root is the integral gain
        # divided by k.
        discriminant = proportional**2 - 4.0 * velocity_gain * integral
        if discriminant < 0.0:
            raise InputError(
                f"no cascade of position and velocity represents the law on {' and '.join(law.axes)}: its integral"
                f" gain is {integral:.3g}; a cascade has at most {proportional**2 / (4.0 * velocity_gain):.3g}"
            )
        position_gain = (proportional + math.sqrt(discriminant)) / (2.0 * velocity_gain)
        return position_gain, 0.0, max(0.0, integral / position_gain)
    velocity_integral = (
        law.gain("displacement") / (1.0 - feed_forward) if _differs_from_zero(law, "displacement") else 0.0
    )
    velocity_integral = max(0.0, velocity_integral)
    position_gain = (proportional - feed_forward * velocity_integral) / velocity_gain
    position_integral = 0.0
    if _differs_from_zero(law, "double_integral"):
        position_integral = max(0.0, (integral - velocity_integral * position_gain) / velocity_gain)
    return position_gain, position_integral, velocity_integral
