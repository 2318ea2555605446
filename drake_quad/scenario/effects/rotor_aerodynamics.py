"""Rotor aerodynamics in the scenario language."""

from typing import Any, ClassVar

import numpy as np

from drake_quad.scenario.effects.effect import EFFECTS, AirLoadEffect
from drake_quad.scenario.quantities import NonNegative, Number, field_from_record
from drake_quad.signals import RotorSpeed, Row
from drake_quad.vehicle.aerodynamics import RotorAerodynamics


@EFFECTS.register
class RotorAerodynamicsEffect(AirLoadEffect):
    """Aerodynamic forces on the rotors that depend on the airspeed. The paper neglects them."""

    lift: NonNegative = field_from_record(
        RotorAerodynamics,
        "lift",
        "thrust gained by all rotors together, divided by the squared airspeed perpendicular to z of B",
    )
    climb: Number = field_from_record(
        RotorAerodynamics, "climb", "thrust lost by all rotors together, divided by the speed of climb along z of B"
    )
    drag: NonNegative = field_from_record(
        RotorAerodynamics, "drag", "force on a rotor perpendicular to z of B, divided by airspeed and rotor speed"
    )
    inflow: NonNegative = field_from_record(
        RotorAerodynamics, "inflow", "thrust lost by a rotor, divided by speed of climb along z of B and rotor speed"
    )
    strength_fields: ClassVar = ("lift", "climb", "drag", "inflow")
    field: ClassVar = "rotor_aerodynamics"
    description: ClassVar = "lift, climb, drag and inflow of the rotors; none if not given"
    record: ClassVar = RotorAerodynamics
    is_nominal: ClassVar = True
    depends_on_time: ClassVar = False
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = True

    def max_damping(self, vehicle: Any, airspeed: Row) -> Row:
        """Return the largest derivative of the force along an axis with respect to the speed along it, N s/m."""
        total_rotor_speed = len(RotorSpeed._fields) * vehicle.max_rotor_speed
        along_z = abs(self.climb) + self.inflow * total_rotor_speed + 2.0 * self.lift * airspeed
        return np.maximum(self.drag * total_rotor_speed, along_z)
