"""The equations of motion, numbered as in the paper.

World frame W: Z up. Body frame B: origin at the centre of mass, x towards rotor 1, y towards rotor 4, z up. Rotors
1 and 3 turn clockwise, 2 and 4 anticlockwise, seen from above.

    (1) R_WB = Rz(ψ) Ry(θ) Rx(φ)
    (2) (p, q, r)ᵀ = [1 0 -sθ; 0 cφ sφcθ; 0 -sφ cφcθ] (φ̇, θ̇, ψ̇)ᵀ
    (3) translation: m v̇ = R_WB (0, 0, F_z)ᵀ - (0, 0, m g)ᵀ + D
    (4) ω_r = -ω₁ + ω₂ - ω₃ + ω₄
    (5) F_z = Σ b ωᵢ², τ_x = l b (ω₄² - ω₂²), τ_y = l b (ω₃² - ω₁²), τ_z = d (ω₁² - ω₂² + ω₃² - ω₄²)

Where the centre of mass is not in the middle of the rotors but at (x, y) from there, the thrust turns the body besides,
by (-y F_z, x F_z, 0). Drag acts at the centre of mass.

The rotors' spin enters as the gyroscopic torque of the total angular momentum J_r ω_r along z; the reaction to its
rate of change is left out, as in the paper.

Every function takes and returns rows: numbers for one vehicle, arrays for a fleet.
"""

from collections.abc import Callable
from typing import Any

from drake_quad.elementary import Row, Rows, is_zero, maximum, minimum, sin_cos, sqrt
from drake_quad.vehicle.parameters import QuadrotorParameters

# An airspeed of zero must not make the derivative of the square root infinite; 1e-200 changes no float above 1e-92.
_TINY = 1e-200

AttitudeKinematics = Callable[[Rows, Row, Row, Row, Row], tuple[Row, Row, Row]]


def rotor_wrench(rotor_speed: Rows, parameters: QuadrotorParameters) -> tuple[Row, Row, Row, Row]:
    """Eq (5): thrust (N) of the rotors and their torques about the centre of mass (N m), in B.

    Args:
        rotor_speed: ω₁ to ω₄, rad/s.
        parameters: of the vehicle.
    """
    w_1, w_2, w_3, w_4 = [speed * speed for speed in rotor_speed]
    b_1, b_2, b_3, b_4 = parameters.thrust_factor
    f_1, f_2, f_3, f_4 = b_1 * w_1, b_2 * w_2, b_3 * w_3, b_4 * w_4
    length = parameters.arm_length
    thrust, tau_x, tau_y = f_1 + f_2 + f_3 + f_4, length * (f_4 - f_2), length * (f_3 - f_1)
    x, y = parameters.centre_of_mass
    if not (is_zero(x) and is_zero(y)):
        tau_x, tau_y = tau_x - y * thrust, tau_y + x * thrust
    return thrust, tau_x, tau_y, parameters.drag_factor * (w_1 - w_2 + w_3 - w_4)


def drag(airspeed: Rows, linear: Row, quadratic: Row) -> tuple[Row, Row, Row]:
    """The force D of eq (3) in W (N): (c₁ + c₂ |v|) v.

    Args:
        airspeed: v, velocity of the air relative to the vehicle in W, m/s.
        linear: c₁, N s/m.
        quadratic: c₂, N s²/m².
    """
    x, y, z = airspeed
    factor = linear + quadratic * sqrt(x * x + y * y + z * z + _TINY)
    return factor * x, factor * y, factor * z


def rigid_kinematics(
    body_rates: Rows, sin_roll: Row, cos_roll: Row, sin_pitch: Row, cos_pitch: Row
) -> tuple[Row, Row, Row]:
    """Eq (2) inverted: rates of roll, pitch and yaw (rad/s) from p, q, r. Singular at a pitch of 90°."""
    p, q, r = body_rates
    yaw_rate = (q * sin_roll + r * cos_roll) / cos_pitch
    return p + sin_pitch * yaw_rate, q * cos_roll - r * sin_roll, yaw_rate


def small_angle_kinematics(
    body_rates: Rows, sin_roll: Row, cos_roll: Row, sin_pitch: Row, cos_pitch: Row
) -> tuple[Row, Row, Row]:
    """What eq (3) takes for (2): p, q, r are the rates of roll, pitch and yaw (rad/s)."""
    p, q, r = body_rates
    return p, q, r


def equations_of_motion(
    wind: Rows, parameters: QuadrotorParameters, kinematics: AttitudeKinematics
) -> Callable[[Rows, Rows], list[Row]]:
    """Eq (3) without its first three lines, as a function of motion and rotors.

    It takes the 9 rows of the motion, roll, pitch, yaw (rad), velocity in W (m/s), p, q, r (rad/s); and the 5 rows of
    the rotors, F_z (N), τ_x, τ_y, τ_z (N m) in B, ω_r of eq (4) (rad/s). It returns the derivatives of the former.
    What stays the same over a step is taken out here, before the function is called four times.

    Args:
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
    """
    mass, gravity, (i_xx, i_yy, i_zz) = parameters.mass, parameters.gravity, parameters.inertia
    rotor_inertia = parameters.rotor_inertia
    wind_x, wind_y, wind_z = wind
    c_1, c_2 = parameters.linear_drag, parameters.quadratic_drag
    feels_air = not (is_zero(c_1) and is_zero(c_2))

    def derivative(motion: Rows, rotors: Rows) -> list[Row]:
        v_x, v_y, v_z, p, q, r = motion[3:]
        thrust, tau_x, tau_y, tau_z, residual = rotors
        (sin_roll, sin_pitch, sin_yaw), (cos_roll, cos_pitch, cos_yaw) = sin_cos(motion[:3])
        forward = sin_pitch * cos_roll
        drag_x = drag_y = drag_z = 0.0
        if feels_air:
            drag_x, drag_y, drag_z = drag((wind_x - v_x, wind_y - v_y, wind_z - v_z), c_1, c_2)
        spin = rotor_inertia * residual
        return [
            *kinematics((p, q, r), sin_roll, cos_roll, sin_pitch, cos_pitch),
            ((sin_yaw * sin_roll + cos_yaw * forward) * thrust + drag_x) / mass,
            ((sin_yaw * forward - cos_yaw * sin_roll) * thrust + drag_y) / mass,
            (cos_pitch * cos_roll * thrust + drag_z) / mass - gravity,
            (q * ((i_yy - i_zz) * r - spin) + tau_x) / i_xx,
            (p * ((i_zz - i_xx) * r + spin) + tau_y) / i_yy,
            ((i_xx - i_yy) * p * q + tau_z) / i_zz,
        ]

    return derivative


def rigid_body_derivative(
    state: Rows,
    wrench: Rows,
    rotor_residual: Row,
    wind: Rows,
    parameters: QuadrotorParameters,
    kinematics: AttitudeKinematics,
) -> list[Row]:
    """Time derivative of the 12 rows of the rigid body's state: eq (3).

    Args:
        state: position in W (m), then the 9 rows of the motion in `equations_of_motion`.
        wrench: F_z (N), τ_x, τ_y, τ_z (N m) of the rotors, in B.
        rotor_residual: ω_r of eq (4), rad/s.
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
    """
    motion_derivative = equations_of_motion(wind, parameters, kinematics)
    return [*state[6:9], *motion_derivative(state[3:12], (*wrench, rotor_residual))]


def rotor_residual(rotor_speed: Rows) -> Row:
    """Eq (4): ω_r, rad/s."""
    w_1, w_2, w_3, w_4 = rotor_speed
    return w_2 + w_4 - w_1 - w_3


def hover_rotor_speeds(parameters: QuadrotorParameters) -> list[Row]:
    """The four rotor speeds (rad/s) at which nothing moves in still air: eq (5) balances the weight.

    They differ where thrust factors do or where the centre of mass is not in the middle; zero for a rotor that would
    have to pull down.
    """
    b_1, b_2, b_3, b_4 = parameters.thrust_factor
    x, y = parameters.centre_of_mass
    weight = parameters.mass * parameters.gravity
    # How much more the fourth rotor carries than the second, and the third than the first.
    left, back = weight * y / parameters.arm_length, -weight * x / parameters.arm_length
    # The pairs turn against each other: what they carry, over b, must be the same for both.
    pair_13, pair_24 = 0.5 / b_1 + 0.5 / b_3, 0.5 / b_2 + 0.5 / b_4
    uneven = left * (0.5 / b_4 - 0.5 / b_2) - back * (0.5 / b_3 - 0.5 / b_1)
    carried_13 = (weight * pair_24 + uneven) / (pair_13 + pair_24)
    carried_24 = weight - carried_13
    forces = carried_13 - back, carried_24 - left, carried_13 + back, carried_24 + left
    return [sqrt(maximum(0.5 * force / b, 0.0)) for force, b in zip(forces, (b_1, b_2, b_3, b_4), strict=True)]


def held_rotor_speed(command: Any, parameters: QuadrotorParameters, speed_factor: Any) -> Any:
    """Where the rotors go under a held command, rad/s.

    A command is clipped to what the rotors can do, idle if it is not a number; a faulty rotor gets a share of that.

    Args:
        command: ω₁ to ω₄, rad/s; a list for one vehicle, a (4, N) array for a fleet.
        parameters: of the vehicle.
        speed_factor: four rows; None if no rotor is faulty.
    """
    low, high = parameters.min_rotor_speed, parameters.max_rotor_speed
    if isinstance(command, list):
        targets = [minimum(maximum(speed, low), high) for speed in command]
    else:
        targets = minimum(maximum(command, low), high)
    if speed_factor is not None:
        for i, factor in enumerate(speed_factor):
            targets[i] = targets[i] * factor
    return targets


def quadrotor_derivative(
    state: Rows,
    rotor_speed_command: Rows,
    wind: Rows,
    parameters: QuadrotorParameters,
    kinematics: AttitudeKinematics,
    speed_factor: Any = None,
) -> list[Row]:
    """Time derivative of the 16 rows of rigid body and rotors together.

    Args:
        state: the 12 rows of `rigid_body_derivative`; ω₁ to ω₄ (rad/s).
        rotor_speed_command: rad/s; what lies outside the rotors' limits is clipped.
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
        speed_factor: of `held_rotor_speed`.
    """
    rotor_speed = state[12:]
    wrench, residual = rotor_wrench(rotor_speed, parameters), rotor_residual(rotor_speed)
    target = held_rotor_speed(rotor_speed_command, parameters, speed_factor)
    return [
        *rigid_body_derivative(state[:12], wrench, residual, wind, parameters, kinematics),
        *[(end - speed) / parameters.rotor_time_constant for end, speed in zip(target, rotor_speed, strict=True)],
    ]
