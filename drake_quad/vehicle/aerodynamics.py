"""Aerodynamic forces on the body and on the rotors, in addition to thrust.

Let u be the velocity of the air relative to the centre of mass, along the axes of B. The forces in B are:

    body drag            F_k = (c₁ₖ + c₂ₖ |u|) u_k                     at the centre of pressure
    translational lift   F_z = c_lift (u_x² + u_y²)                    at the mean position of the rotors
    climb                F_z = c_climb u_z, a loss of thrust           at the mean position of the rotors
    rotor drag, inflow   F = Σ ωᵢ (k_d u_x, k_d u_y, k_z u_z)          at the mean position of the rotors

Body drag follows the drag law of a blunt body, independently for each axis. The other effects are first-order results
of blade element and momentum theory. The drag of a rotor is proportional to its speed (Martin and Salaün, "The true
role of accelerometer feedback in quadrotor control", ICRA 2010). Thrust decreases with the inflow through the disc and
increases with the airspeed parallel to the disc (Svacha, Mohta and Kumar, "Improving quadrotor trajectory tracking by
compensating for aerodynamic effects", ICUAS 2017).

The model neglects body rates: the body and all rotors have the same velocity relative to the air as the centre of mass.
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
    """Force and torque about the centre of mass, along the axes of B."""

    force: Vector
    torque: Vector


class Flow(NamedTuple):
    """State of the air and of the rotors, on which the load on a vehicle depends.

    Attributes:
        air: velocity u of the air relative to the vehicle, along the axes of B, m/s.
        air_in_world: the same velocity along the axes of W, m/s.
        rotors: speeds of the rotors.
        wrench: thrust and torques of the rotors by eq (5) of the paper, without additional loads.
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
        """Return the force and the torque on the vehicle, in addition to the forces in the paper's equations."""


class LinearDrag(NamedTuple):
    """Ratio c₁ of drag force to airspeed along each axis."""

    x: _LinearDrag = 0.0
    y: _LinearDrag = 0.0
    z: _LinearDrag = 0.0


class QuadraticDrag(NamedTuple):
    """Ratio c₂ of drag force to squared airspeed along each axis."""

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
        # The airspeed is computed from the velocity in W, so that isotropic coefficients give exactly the same result
        # as `drake_quad.vehicle.dynamics.drag`.
        speed, coefficients = length(flow.air_in_world), zip(self.linear, self.quadratic, flow.air, strict=True)
        force = Vector._make((c_1 + c_2 * speed) * u for c_1, c_2, u in coefficients)
        return Load(force, cross(Vector(*self.centre_of_pressure), force))


class RotorAerodynamics(NamedTuple):
    """Coefficients of the aerodynamic forces on the rotors.

    Attributes:
        lift: c_lift, ratio of the additional thrust of all rotors to the squared airspeed parallel to their discs.
        climb: c_climb, ratio of the thrust that all rotors lose to their climb speed relative to the air, along z of B.
        drag: k_d, ratio of the force parallel to the disc to the product of rotor speed and airspeed parallel to the
            disc.
        inflow: k_z, ratio of the force along z of B to the product of rotor speed and airspeed along z of B.
    """

    lift: Annotated[Row, Quantity("N s²/m²")] = 0.0
    climb: Annotated[Row, Quantity("N s/m")] = 0.0
    drag: Annotated[Row, Quantity("N s²/m")] = 0.0
    inflow: Annotated[Row, Quantity("N s²/m")] = 0.0

    def load(self, flow: Flow) -> Load:
        """Return the sum of lift, climb, drag and inflow, which acts at the mean position of the rotors."""
        speed, air = flow.rotors, flow.air
        total_speed = speed.rotor_1 + speed.rotor_2 + speed.rotor_3 + speed.rotor_4
        drag = self.drag * total_speed
        squared_airspeed = air.x * air.x + air.y * air.y
        lift = self.lift * squared_airspeed + (self.climb + self.inflow * total_speed) * air.z
        force = Vector(drag * air.x, drag * air.y, lift)
        return Load(force, cross(mean_rotor_position(flow.parameters), force))


class GroundEffect(NamedTuple):
    """Increase of thrust close to the ground.

    Attributes:
        rotor_radius: radius R of a rotor.
        ground_height: height z of the ground in W.
    """

    rotor_radius: Annotated[Row, Quantity("m")]
    ground_height: Annotated[Row, Quantity("m", "W")]


def ground_effect(height: Row, ground: GroundEffect) -> Row:
    """Return the ratio of the thrust to the thrust far from the ground at the same rotor speed: 1 / (1 - (R / 4z)²).

    The formula is from Cheeseman and Bennett, "The effect of the ground on a helicopter rotor in forward flight",
    ARC R&M 3021, 1955, who model the ground by a mirror image of the rotor. The increase of thrust decays as 1 / z²: it
    is 1.6 % at a height of 2 R and 0.4 % at 4 R. Since the formula has a pole at R / 4, the height is limited: for all
    heights below R / 2, the ratio is 4/3, its value at R / 2.

    Args:
        height: height of the vehicle in W, m. The rotors are at the height of the centre of mass.
        ground: height of the ground and radius of the rotors.
    """
    clearance = maximum(height - ground.ground_height, 0.5 * ground.rotor_radius)
    ratio = 0.25 * ground.rotor_radius / clearance
    return 1.0 / (1.0 - ratio * ratio)
