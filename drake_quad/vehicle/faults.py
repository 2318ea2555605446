"""Rotors that do not turn as they are told."""

import math
from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import maximum, where
from drake_quad.signals import Number, Quantity, Row, Time


class SpeedFactors(NamedTuple):
    """What is left of the speed of each rotor, as a share."""

    rotor_1: Number = 1.0
    rotor_2: Number = 1.0
    rotor_3: Number = 1.0
    rotor_4: Number = 1.0


class RotorFaults(NamedTuple):
    """What the rotors lose of the speed that they are told.

    Attributes:
        battery_sag: share that all rotors lose with the battery, per second of flight.
        failure_time: when rotors fail; infinite if they do not.
        failure_factor: share of its speed that each rotor keeps from then on.
    """

    battery_sag: Annotated[Row, Quantity("1/s")] = 0.0
    failure_time: Time = math.inf
    failure_factor: SpeedFactors = SpeedFactors()


def speed_factors(faults: RotorFaults, time: Row) -> SpeedFactors:
    """What is left of the speed of the rotors at a time (s)."""
    charge = maximum(1.0 - faults.battery_sag * time, 0.0)
    failed = time >= faults.failure_time
    return SpeedFactors._make(charge * where(failed, left, 1.0) for left in faults.failure_factor)
