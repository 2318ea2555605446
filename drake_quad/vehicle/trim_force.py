"""Constant force that a vehicle feels along its own axes, whatever the air and the rotors do.

Flights of real vehicles show such a force: rotors that are not mounted parallel, or a bias of the attitude that the
autopilot calls level. In the flights of Neural-Fly it is 1.06 N along x on a vehicle of 2.6 kg.
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
        """Return the force, which has no torque."""
        return Load(Vector(self.x, self.y, self.z), Vector(0.0, 0.0, 0.0))
