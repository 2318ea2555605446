"""Rotor faults: a voltage drop of the battery and failures of single rotors, as factors on the rotor speeds."""

import math
from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import maximum, where
from drake_quad.signals import Number, Quantity, Row, Time


class SpeedFactors(NamedTuple):
    """Factors by which the speeds of the rotors are multiplied; 1 for a rotor without a fault."""

    rotor_1: Number = 1.0
    rotor_2: Number = 1.0
    rotor_3: Number = 1.0
    rotor_4: Number = 1.0


class RotorFaults(NamedTuple):
    """Parameters of rotor faults.

    Attributes:
        battery_sag: fraction of the commanded speed that all rotors lose per second of flight.
        failure_time: time at which rotors fail; infinite if no rotor fails.
        failure_factor: factors on the rotor speeds after the failure.
    """

    battery_sag: Annotated[Row, Quantity("1/s")] = 0.0
    failure_time: Time = math.inf
    failure_factor: SpeedFactors = SpeedFactors()


def speed_factors(faults: RotorFaults, time: Row) -> SpeedFactors:
    """Return the factors by which faults reduce the rotor speeds at a time (s)."""
    battery_factor = maximum(1.0 - faults.battery_sag * time, 0.0)
    failed = time >= faults.failure_time
    return SpeedFactors._make(battery_factor * where(failed, remaining, 1.0) for remaining in faults.failure_factor)
