"""Rotors that do not turn as they are told."""

import math
from typing import NamedTuple

from drake_quad.elementary import Row, Rows, every, maximum, where


class RotorFaults(NamedTuple):
    """What the rotors lose of the speed that they are told.

    Attributes:
        battery_sag: share that all rotors lose with the battery, per second of flight, 1/s.
        failure_time: when rotors fail, s; infinite if they do not.
        failure_factor: of the four rotors, share of the speed that is left from then on, 1.
    """

    battery_sag: Row = 0.0
    failure_time: Row = math.inf
    failure_factor: Rows = (1.0, 1.0, 1.0, 1.0)

    def to_rows(self) -> list[Row]:
        """The faults as 6 rows, in the order above."""
        battery_sag, failure_time, failure_factor = self
        return [battery_sag, failure_time, *failure_factor]

    def speed_factor(self, time: Row) -> list[Row]:
        """What is left of the speed of the four rotors at a time (s)."""
        charge = maximum(1.0 - self.battery_sag * time, 0.0)
        sound = time < self.failure_time
        if every(sound):
            return [charge] * 4
        return [charge * where(sound, 1.0, factor) for factor in self.failure_factor]
