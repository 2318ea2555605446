"""Constant force on a vehicle along the axes of B, independent of the air and of the rotors.

Such a force is observed in flights of real vehicles. It is caused by rotors that are not mounted parallel, or by a bias
of the attitude that the autopilot considers level. In the flights of Neural-Fly the force is 1.06 N along x, on a
vehicle of 2.6 kg.
"""

from typing import NamedTuple

from drake_quad.geometry.axes import Vector
from drake_quad.signals import ForceB
from drake_quad.vehicle.aerodynamics import Flow, Load


class TrimForce(NamedTuple):
    """Force along the axes of B, which acts at the centre of mass."""

    x: ForceB = 0.0
    y: ForceB = 0.0
    z: ForceB = 0.0

    def load(self, flow: Flow) -> Load:
        """Return the load of the trim force, which has no torque."""
        return Load(Vector(self.x, self.y, self.z), Vector(0.0, 0.0, 0.0))
