"""Equations of motion, numbered as in the paper.

In the world frame W, Z points up. The body frame B has its origin at the centre of mass; x points forward, y to the
left, and z up. Rotor i is at (xᵢ, yᵢ) relative to the origin of the layout. Its direction of rotation sᵢ, seen from
above, is 1 for anticlockwise and -1 for clockwise.

    (1) R_WB = Rz(ψ) Ry(θ) Rx(φ)
    (2) (p, q, r)ᵀ = [1 0 -sθ; 0 cφ sφcθ; 0 -sφ cφcθ] (φ̇, θ̇, ψ̇)ᵀ, in `drake_quad.vehicle.attitude_kinematics`
    (3) translation: m v̇ = R_WB (0, 0, F_z)ᵀ - (0, 0, m g)ᵀ + D
    (4) ω_r = Σ sᵢ ωᵢ
    (5) F_z = Σ bᵢ ωᵢ², τ_x = Σ (yᵢ - c_y) bᵢ ωᵢ², τ_y = -Σ (xᵢ - c_x) bᵢ ωᵢ², τ_z = -Σ sᵢ dᵢ ωᵢ²

The centre of mass is at (c_x, c_y) relative to the origin of the layout. The rotors of the paper's vehicle form a plus:
rotor 1 is in front, 2 to the right, 3 at the back, 4 to the left, all at a distance l from the centre of mass. Rotors 1
and 3 turn clockwise. For this vehicle

    (4) ω_r = -ω₁ + ω₂ - ω₃ + ω₄
    (5) F_z = Σ b ωᵢ², τ_x = l b (ω₄² - ω₂²), τ_y = l b (ω₃² - ω₁²), τ_z = d (ω₁² - ω₂² + ω₃² - ω₄²)

Drag acts at the centre of mass.

The gyroscopic torque of the rotors follows from their total angular momentum J_r ω_r along z. As in the paper, the
reaction torque due to the rate of change of this momentum is neglected, unless the effect is switched on
(`drake_quad.vehicle.effects`).
"""

from typing import NamedTuple

from drake_quad.framework.elementary import maximum, minimum, sqrt, total
from drake_quad.geometry.axes import TINY, BodyAxes, Vector
from drake_quad.signals import AngleRate, BodyRateB, RotorSpeed, Row, State, VelocityW, Wind, Wrench
from drake_quad.vehicle.faults import SpeedFactors
from drake_quad.vehicle.mixer import mixer_from_parameters
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.rotors import Rotors


class Motion(NamedTuple):
    """Velocity and body rates of the vehicle, or their time derivatives."""

    v_x: VelocityW
    v_y: VelocityW
    v_z: VelocityW
    p: BodyRateB
    q: BodyRateB
    r: BodyRateB

    @classmethod
    def of(cls, state: State) -> "Motion":
        """Return the velocity and body rates of a state."""
        _, _, _, _, _, _, *motion = state
        return cls(*motion)


class RotorAction(NamedTuple):
    """Action of the rotors on the body: eqs (4) and (5) of the paper.

    Attributes:
        wrench: total thrust of the rotors, and their torques about the centre of mass.
        residual: residual speed ω_r, the sum of the rotor speeds, signed by the directions of rotation.
    """

    wrench: Wrench
    residual: AngleRate


def rotor_action(speed: RotorSpeed, parameters: QuadrotorParameters) -> RotorAction:
    """Return the wrench and the residual speed for rotor speeds, by eqs (4) and (5) of the paper."""
    rotors, centre = parameters.rotors, parameters.centre_of_mass
    squares = [w * w for w in speed]
    forces = [rotor.thrust_factor * square for rotor, square in zip(rotors, squares, strict=True)]
    drag_torques = [
        -rotor.direction * rotor.drag_factor * square for rotor, square in zip(rotors, squares, strict=True)
    ]
    wrench = Wrench(
        total(forces),
        total([(rotor.y - centre.y) * force for rotor, force in zip(rotors, forces, strict=True)]),
        total([(centre.x - rotor.x) * force for rotor, force in zip(rotors, forces, strict=True)]),
        total(drag_torques),
    )
    return RotorAction(wrench, residual_speed(speed, rotors))


def residual_speed(speed: RotorSpeed, rotors: Rotors) -> Row:
    """Return ω_r of eq (4) of the paper for rotor speeds, or its rate of change for the rates of the rotor speeds."""
    return total([rotor.direction * w for rotor, w in zip(rotors, speed, strict=True)])


def mean_rotor_position(parameters: QuadrotorParameters) -> Vector:
    """Return the mean position of the four rotors relative to the centre of mass, m."""
    rotors, centre = parameters.rotors, parameters.centre_of_mass
    x, y, z = (0.25 * total([getattr(rotor, axis) for rotor in rotors]) for axis in ("x", "y", "z"))
    return Vector(x - centre.x, y - centre.y, z)


def drag(airspeed: Wind, linear: Row, quadratic: Row) -> tuple[Row, Row, Row]:
    """Return the drag force D of eq (3) of the paper in W, N: (c₁ + c₂ |v|) v.

    Args:
        airspeed: velocity v of the air relative to the vehicle in W, m/s.
        linear: coefficient c₁, N s/m.
        quadratic: coefficient c₂, N s²/m².
    """
    x, y, z = airspeed
    factor = linear + quadratic * sqrt(x * x + y * y + z * z + TINY)
    return factor * x, factor * y, factor * z


def equations_of_motion(
    axes: BodyAxes,
    motion: Motion,
    rotors: RotorAction,
    wind: Wind,
    parameters: QuadrotorParameters,
    force: Vector | None = None,
) -> Motion:
    """Return the linear and angular accelerations of the vehicle: eq (3) of the paper without the kinematics.

    Args:
        axes: axes of B in W.
        motion: velocity and body rates of the vehicle.
        rotors: action of the rotors on the body.
        wind: velocity of the air in W.
        parameters: parameters of the vehicle.
        force: additional force on the centre of mass in W, besides thrust, drag and weight, N; None if there is none.
    """
    v_x, v_y, v_z, p, q, r = motion
    thrust, tau_x, tau_y, tau_z = rotors.wrench
    (i_xx, i_yy, i_zz), per_mass = parameters.inertia, 1.0 / parameters.mass
    airspeed = Wind(wind.x - v_x, wind.y - v_y, wind.z - v_z)
    drag_x, drag_y, drag_z = drag(airspeed, parameters.linear_drag, parameters.quadratic_drag)
    if force is not None:
        drag_x, drag_y, drag_z = drag_x + force.x, drag_y + force.y, drag_z + force.z
    spin = parameters.rotor_inertia * rotors.residual
    return Motion(
        (axes.z.x * thrust + drag_x) * per_mass,
        (axes.z.y * thrust + drag_y) * per_mass,
        (axes.z.z * thrust + drag_z) * per_mass - parameters.gravity,
        (q * ((i_yy - i_zz) * r - spin) + tau_x) * (1.0 / i_xx),
        (p * ((i_zz - i_xx) * r + spin) + tau_y) * (1.0 / i_yy),
        ((i_xx - i_yy) * p * q + tau_z) * (1.0 / i_zz),
    )


def target_rotor_speed(command: RotorSpeed, parameters: QuadrotorParameters, factors: SpeedFactors) -> RotorSpeed:
    """Return the speeds that the rotors approach under a constant command.

    A command is clipped to the limits of the rotors; NaN becomes idle speed. The result is then multiplied by the
    factors for faulty rotors.

    Args:
        command: commanded rotor speeds.
        parameters: parameters of the vehicle.
        factors: factor for each rotor, 1 if the rotor is not faulty.
    """
    low, high = parameters.min_rotor_speed, parameters.max_rotor_speed
    return RotorSpeed._make(
        factor * minimum(maximum(speed, low), high) for speed, factor in zip(command, factors, strict=True)
    )


def hover_rotor_speeds(parameters: QuadrotorParameters) -> RotorSpeed:
    """Return the rotor speeds for hover in still air, whose wrench balances the weight without a torque.

    The four speeds differ if the rotors are not equal or the centre of mass is not in the middle. The speed is zero for
    a rotor that would have to push the vehicle down.
    """
    weight = parameters.mass * parameters.gravity
    return RotorSpeed._make(sqrt(maximum(row.thrust * weight, 0.0)) for row in mixer_from_parameters(parameters))
