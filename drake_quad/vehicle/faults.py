"""Rotors that do not turn as they are told."""

import math
from typing import NamedTuple

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, maximum, where


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


@formula
def rotor_speed_factor(faults: Rows, time: Row) -> tuple[Row, Row, Row, Row]:
    """What is left of the speed of the four rotors.

    Args:
        faults: the 6 rows of `RotorFaults`.
        time: s.
    """
    battery_sag, failure_time, s_1, s_2, s_3, s_4 = faults
    charge, failed = maximum(1.0 - battery_sag * time, 0.0), time >= failure_time
    return (
        charge * where(failed, s_1, 1.0),
        charge * where(failed, s_2, 1.0),
        charge * where(failed, s_3, 1.0),
        charge * where(failed, s_4, 1.0),
    )
