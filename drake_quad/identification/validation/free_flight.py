"""Part of a log in which a vehicle is in free flight, between take-off and landing."""

from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.identification.windows import commanded_effort
from drake_quad.logs.record import FlightRecord

# Rotors idle if their command is smaller than this fraction of the median of the positive commands.
_IDLE_RATIO = 0.5
# Smallest height of vehicle and reference above the ground in free flight, m. It is a few rotor diameters of a small
# vehicle.
_MIN_HEIGHT = 0.25
# Height above the ground from which on a vehicle has lifted off, m. It exceeds the noise of motion capture.
_LIFT_OFF_HEIGHT = 0.003


class FreeFlight(NamedTuple):
    """Samples of a log in free flight.

    Attributes:
        first: index of the first sample.
        end: index after the last sample.
        lift_off: index of the last sample on the ground before the free flight; None if the log begins in the air.
    """

    first: int
    end: int
    lift_off: int | None


def free_flight(record: FlightRecord) -> FreeFlight:
    """Return the part of a log in which both the vehicle and its reference are in free flight.

    A log begins or ends on the ground if the rotors idle there, that is, if their command is less than half of the
    median of the positive commands. The height of the vehicle at this end is then the height of the ground. Vehicle and
    reference are more than 0.25 m above the ground in free flight. If the rotors idle at neither end, or if no command
    is logged, the whole log counts as free flight.

    An estimated height can drift on the ground. The lift-off is therefore detected relative to the height at the last
    time before the flight at which the rotors idle.

    Args:
        record: record with position and reference position.

    Raises:
        InputError: if a signal is not logged, or the vehicle never flies.
    """
    count, command = len(record.time), commanded_effort(record)
    if command is None or not (command > 0.0).any():
        return FreeFlight(0, count, None)
    idle = command < _IDLE_RATIO * np.median(command[command > 0.0])
    if not (idle[0] or idle[-1]):
        return FreeFlight(0, count, None)
    height = record.of("position")[:, 2]
    ground = float(height[0] if idle[0] else height[-1])
    lowest = np.minimum(height, record.of("reference_position")[:, 2])
    flying = np.flatnonzero(lowest > ground + _MIN_HEIGHT)
    if len(flying) < 2:
        raise InputError(
            f"the vehicle of the log {short_repr(record.name)} does not fly: it and its reference are never more than"
            f" {_MIN_HEIGHT:g} m above the ground at the same time"
        )
    first, end = int(flying[0]), int(flying[-1]) + 1
    if not idle[0]:
        return FreeFlight(0, end, None)
    last_idle = int(np.flatnonzero(idle[:first])[-1])
    on_ground = np.flatnonzero(height[:first] < height[last_idle] + _LIFT_OFF_HEIGHT)
    return FreeFlight(first, end if idle[-1] else count, int(on_ground[-1]))
