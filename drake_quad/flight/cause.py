"""Identification of the signal that was the first to become NaN or infinite in a flight."""

import math
from collections.abc import Mapping

import numpy as np

from drake_quad.assembly.user_systems import PORTS
from drake_quad.signals import row_names

# Signals that are computed before those of the control within a tick, each before the signals that depend on it. The
# signals of the control follow in the order in which they are recorded.
_UPSTREAM_SIGNALS = ("wind", "state", "rotor_speed", "swing", "charge", "measurement", "reference")
# If one of these signals is the first to contain NaN or infinity, the motion of the vehicle has diverged although its
# commands were finite.
_VEHICLE_SIGNALS = ("state", "rotor_speed", "swing", "charge", "measurement")
# Signals that are computed from the commands of the control. They are never the first cause.
_DOWNSTREAM_SIGNALS = ("rotor_speed_command", "throttle_command", "shortfall", "crashed")


def non_finite_value(
    time: np.ndarray, signals: Mapping[str, np.ndarray], user_systems: Mapping[str, object]
) -> str | None:
    """Return a sentence that names the first value of a flight that is NaN or infinite.

    Args:
        time: (ticks,) times of the samples up to the crash, s.
        signals: (ticks, rows) recorded values of each signal, keyed by signal name, in the order of the recording.
        user_systems: user's systems, keyed by the part of the loop that each replaces; see `UserSystems`.

    Returns:
        The sentence; None if all values are finite, or if the motion of the vehicle diverged although its commands were
        finite.
    """
    finite = {name: np.isfinite(values).all(axis=1) for name, values in signals.items()}
    first_ticks = {name: int(np.argmin(ticks)) for name, ticks in finite.items() if not ticks.all()}
    if not first_ticks:
        return None
    first = min(first_ticks.values())
    order = [*_UPSTREAM_SIGNALS, *(name for name in signals if name not in _DOWNSTREAM_SIGNALS), *_DOWNSTREAM_SIGNALS]
    name = next(each for each in order if first_ticks.get(each) == first)
    if name in _VEHICLE_SIGNALS:
        return None
    values = signals[name][first]
    row = int(np.argmin(np.isfinite(values)))
    value = "nan" if math.isnan(values[row]) else "infinite"
    user_system = next((role for role in user_systems if name in _output_signals(role)), None)
    row_name = row_names(name, len(values))[row]
    location = f"{f'row {row_name}' if row_name.isdecimal() else row_name} of `{name}`"
    fault = f"{user_system} returned {value} in {location}" if user_system else f"{location} was {value}"
    return f"{fault} at {time[first]:.2f} s"


def _output_signals(role: str) -> tuple[str, ...]:
    """Return the names of the signals that a user's system may output.

    Args:
        role: part of the loop that the system replaces, a field of `UserSystems`.
    """
    whole_cascade = ("acceleration_command", "attitude_command", "wrench", "attitude_target")
    return whole_cascade if role == "control" else (PORTS[role].output,)
