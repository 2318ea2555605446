"""Names what was not a number first in a flight that ended by that."""

import math
from collections.abc import Mapping

import numpy as np

from drake_quad.assembly.user_systems import PLACES
from drake_quad.signals import row_names

# These signals are in the order of cause and effect within a tick; those of the control follow in their own order.
_BEFORE_CONTROL = ("wind", "state", "rotor_speed", "swing", "charge", "measurement", "reference")
# A vehicle whose own state leaves all numbers has diverged: nothing that was sent to it is to blame.
_OF_VEHICLE = ("state", "rotor_speed", "swing", "charge", "measurement")
# These signals only show what was sent before.
_AFTER_CONTROL = ("rotor_speed_command", "throttle_command", "shortfall", "crashed")


def not_a_number(time: np.ndarray, signals: Mapping[str, np.ndarray], own: Mapping[str, object]) -> str | None:
    """Return a sentence on the first number of a flight that is not finite; None if all are, or the vehicle diverged.

    Args:
        time: (ticks,) s, up to the crash.
        signals: (ticks, rows) by name, in the order in which they follow from each other.
        own: systems of the user's by their place in the loop, see `UserSystems`.
    """
    finite = {name: np.isfinite(values).all(axis=1) for name, values in signals.items()}
    ends = {name: int(np.argmin(ticks)) for name, ticks in finite.items() if not ticks.all()}
    if not ends:
        return None
    first = min(ends.values())
    order = [*_BEFORE_CONTROL, *(name for name in signals if name not in _AFTER_CONTROL), *_AFTER_CONTROL]
    name = next(each for each in order if ends.get(each) == first)
    if name in _OF_VEHICLE:
        return None
    values = signals[name][first]
    row = int(np.argmin(np.isfinite(values)))
    value = "nan" if math.isnan(values[row]) else "infinite"
    whose = next((place for place in own if name in _signals_of(place)), None)
    place = f"{row_names(name, len(values))[row]} of `{name}`"
    said = f"{whose} returned {value} in {place}" if whose else f"{place} was {value}"
    return f"{said} at {time[first]:.2f} s"


def _signals_of(place: str) -> tuple[str, ...]:
    """Return the signals that a system in a place of the loop may make."""
    whole_cascade = ("acceleration_command", "attitude_command", "wrench", "attitude_target")
    return whole_cascade if place == "control" else (PLACES[place].output,)
