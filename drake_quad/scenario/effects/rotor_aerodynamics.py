"""Aerodynamic forces on the rotors."""

from typing import Any, ClassVar

import numpy as np

from drake_quad.scenario.effects.effect import EFFECTS, AirLoadEffect
from drake_quad.scenario.quantities import NonNegative, Number, field_of
from drake_quad.signals import RotorSpeed, Row
from drake_quad.vehicle.aerodynamics import RotorAerodynamics


@EFFECTS.member
class RotorAerodynamicsEffect(AirLoadEffect):
    """Aerodynamic forces on the rotors, which the paper neglects."""

    lift: NonNegative = field_of(
        RotorAerodynamics, "lift", "thrust of all rotors over the squared speed across their discs"
    )
    climb: Number = field_of(
        RotorAerodynamics, "climb", "thrust that all rotors lose over the speed of climb through the air, along z of B"
    )
    drag: NonNegative = field_of(
        RotorAerodynamics, "drag", "force across z of B over airspeed and a rotor's speed in rad/s"
    )
    inflow: NonNegative = field_of(
        RotorAerodynamics, "inflow", "the same along z of B: thrust that a rotor loses in climb"
    )
    field: ClassVar = "rotor_aerodynamics"
    meaning: ClassVar = "lift, climb, drag and inflow of the rotors, if any"
    record: ClassVar = RotorAerodynamics
    is_believed: ClassVar = True
    depends_on_time: ClassVar = False
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = True

    def max_slope(self, vehicle: Any, airspeed: Row) -> Row:
        """Return the slope along the axis on which it is largest, N s/m."""
        turning = len(RotorSpeed._fields) * vehicle.max_rotor_speed
        along = abs(self.climb) + self.inflow * turning + 2.0 * self.lift * airspeed
        return np.maximum(self.drag * turning, along)
