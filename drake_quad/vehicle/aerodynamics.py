"""Aerodynamic forces on the body and on the rotors, in addition to thrust.

The forces along the axes of B are, with u the velocity of the air relative to the vehicle at its centre of mass:

    body drag            F_k = (c₁ₖ + c₂ₖ |u|) u_k                          at the centre of pressure
    translational lift   F_z = c_lift (u_x² + u_y²)                         at the mean position of the rotors
    climb                F_z = c_climb u_z: thrust is lost with the speed w = -u_z of climb
    rotor drag, inflow   F = Σ ωᵢ (k_d u_x, k_d u_y, k_z u_z)

Body drag is that of a blunt body, independently for each axis. The other three effects are first-order results of blade
element and momentum theory. The drag of a rotor is proportional to its speed (Martin and Salaün, "The true role of
accelerometer feedback in quadrotor control", ICRA 2010). Thrust decreases with the inflow through the disc and
increases with the airspeed across it (Svacha, Mohta and Kumar, "Improving quadrotor trajectory tracking by compensating
for aerodynamic effects", ICUAS 2017).

The model neglects body rates: the air velocity at the centre of mass applies to the body and to all rotors.
"""

from typing import Annotated, NamedTuple, Protocol

from drake_quad.framework.elementary import maximum
from drake_quad.geometry.axes import Vector, cross, length
from drake_quad.signals import PositionW, Quantity, RotorSpeed, Row, Wrench
from drake_quad.vehicle.dynamics import mean_rotor_position
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.rotors import Length

_LinearDrag = Annotated[Row, Quantity("N s/m", "B")]
_QuadraticDrag = Annotated[Row, Quantity("N s²/m²", "B")]


class Load(NamedTuple):
    """A force and its torque about the centre of mass, in the axes of B."""

    force: Vector
    torque: Vector


class Flow(NamedTuple):
    """State of the air and of the rotors, from which the load on a vehicle follows.

    Attributes:
        air: velocity u of the air relative to the vehicle, along the axes of B, m/s.
        air_in_world: the same velocity along the axes of W, m/s.
        rotors: speeds of the rotors.
        wrench: thrust and torques of the rotors without the load.
        height: height of the vehicle in W, m.
        parameters: parameters of the vehicle.
    """

    air: Vector
    air_in_world: Vector
    rotors: RotorSpeed
    wrench: Wrench
    height: PositionW
    parameters: QuadrotorParameters


class AirLoad(Protocol):
    """Parameters of a load on the vehicle that depends on the air and on the rotors."""

    def load(self, flow: Flow) -> Load:
        """Return the force and the torque on the vehicle, in addition to those of the paper's equations."""


class LinearDrag(NamedTuple):
    """Drag force over airspeed, c₁ along each axis."""

    x: _LinearDrag = 0.0
    y: _LinearDrag = 0.0
    z: _LinearDrag = 0.0


class QuadraticDrag(NamedTuple):
    """Drag force over squared airspeed, c₂ along each axis."""

    x: _QuadraticDrag = 0.0
    y: _QuadraticDrag = 0.0
    z: _QuadraticDrag = 0.0


class CentreOfPressure(NamedTuple):
    """Point at which the drag of the body acts, relative to the centre of mass."""

    x: Length = 0.0
    y: Length = 0.0
    z: Length = 0.0


class BodyDrag(NamedTuple):
    """Drag of the body, independently for each axis of B.

    Attributes:
        linear: coefficients c₁.
        quadratic: coefficients c₂.
        centre_of_pressure: point at which the drag acts.
    """

    linear: LinearDrag = LinearDrag()
    quadratic: QuadraticDrag = QuadraticDrag()
    centre_of_pressure: CentreOfPressure = CentreOfPressure()

    def load(self, flow: Flow) -> Load:
        """Return the drag of the body."""
        # The speed is computed from the velocity in W, as for isotropic drag (`drake_quad.vehicle.dynamics.drag`).
        speed, coefficients = length(flow.air_in_world), zip(self.linear, self.quadratic, flow.air, strict=True)
        force = Vector._make((c_1 + c_2 * speed) * u for c_1, c_2, u in coefficients)
        return Load(force, cross(Vector(*self.centre_of_pressure), force))


class RotorAerodynamics(NamedTuple):
    """Coefficients of the aerodynamic forces on the rotors.

    Attributes:
        lift: c_lift, thrust of all rotors over the squared speed across their discs.
        climb: c_climb, thrust that all rotors lose over the speed along z of B at which they climb through the air.
        drag: k_d, force across z of B over a rotor's speed and the airspeed.
        inflow: k_z, thrust over a rotor's speed and the airspeed along z of B.
    """

    lift: Annotated[Row, Quantity("N s²/m²")] = 0.0
    climb: Annotated[Row, Quantity("N s/m")] = 0.0
    drag: Annotated[Row, Quantity("N s²/m")] = 0.0
    inflow: Annotated[Row, Quantity("N s²/m")] = 0.0

    def load(self, flow: Flow) -> Load:
        """Return the sum of lift, climb, drag and inflow, which acts at the mean position of the rotors."""
        speed, air = flow.rotors, flow.air
        turning = speed.rotor_1 + speed.rotor_2 + speed.rotor_3 + speed.rotor_4
        drag = self.drag * turning
        across = air.x * air.x + air.y * air.y
        lift = self.lift * across + (self.climb + self.inflow * turning) * air.z
        force = Vector(drag * air.x, drag * air.y, lift)
        return Load(force, cross(mean_rotor_position(flow.parameters), force))


class GroundEffect(NamedTuple):
    """Thrust that rotors gain close above the ground.

    Attributes:
        rotor_radius: radius R of a rotor.
        ground_height: height z of the ground in W.
    """

    rotor_radius: Annotated[Row, Quantity("m")]
    ground_height: Annotated[Row, Quantity("m", "W")]


def ground_effect(height: Row, ground: GroundEffect) -> Row:
    """Return the ratio of the thrust to the thrust far from the ground at the same rotor speed: 1 / (1 - (R / 4z)²).

    The formula is that of Cheeseman and Bennett, "The effect of the ground on a helicopter rotor in forward flight",
    ARC R&M 3021, 1955, who model the ground by a source that mirrors the rotor. The gain decays as 1 / z²: it is 1.6 %
    at a height of 2 R and 0.4 % at 4 R. The formula has a pole at R / 4. We therefore limit the ratio: below R / 2, and
    below the ground, it is 4/3, its value at R / 2.

    Args:
        height: height of the vehicle in W, m. The rotors are at the height of the centre of mass.
        ground: height of the ground and radius of the rotors.
    """
    clearance = maximum(height - ground.ground_height, 0.5 * ground.rotor_radius)
    ratio = 0.25 * ground.rotor_radius / clearance
    return 1.0 / (1.0 - ratio * ratio)
