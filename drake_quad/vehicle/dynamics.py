"""The equations of motion, numbered as in the paper.

World frame W: Z up. Body frame B: origin at the centre of mass, x towards rotor 1, y towards rotor 4, z up. Rotors
1 and 3 turn clockwise, 2 and 4 anticlockwise, seen from above.

    (1) R_WB = Rz(ψ) Ry(θ) Rx(φ)
    (2) (p, q, r)ᵀ = [1 0 -sθ; 0 cφ sφcθ; 0 -sφ cφcθ] (φ̇, θ̇, ψ̇)ᵀ
    (3) translation: m v̇ = R_WB (0, 0, F_z)ᵀ - (0, 0, m g)ᵀ + D
    (4) ω_r = -ω₁ + ω₂ - ω₃ + ω₄
    (5) F_z = Σ b ωᵢ², τ_x = l b (ω₄² - ω₂²), τ_y = l b (ω₃² - ω₁²), τ_z = d (ω₁² - ω₂² + ω₃² - ω₄²)

The rotors' spin enters as the gyroscopic torque of the total angular momentum J_r ω_r along z; the reaction to its
rate of change is left out, as in the paper.

Every function takes and returns rows: numbers for one vehicle, arrays for a fleet.
"""

from collections.abc import Callable

from drake_quad.elementary import Row, Rows, cos, is_zero, maximum, minimum, sin, sqrt
from drake_quad.vehicle.parameters import QuadrotorParameters

# An airspeed of zero must not make the derivative of the square root infinite; 1e-200 changes no float above 1e-92.
_TINY = 1e-200

AttitudeKinematics = Callable[[Rows, Row, Row, Row, Row], tuple[Row, Row, Row]]


def rotor_wrench(rotor_speed: Rows, parameters: QuadrotorParameters) -> tuple[Row, Row, Row, Row]:
    """Eq (5): thrust (N) and torques (N m) of the rotors, in B.

    Args:
        rotor_speed: ω₁ to ω₄, rad/s.
        parameters: of the vehicle.
    """
    w_1, w_2, w_3, w_4 = [speed * speed for speed in rotor_speed]
    b_1, b_2, b_3, b_4 = parameters.thrust_factor
    f_1, f_2, f_3, f_4 = b_1 * w_1, b_2 * w_2, b_3 * w_3, b_4 * w_4
    length = parameters.arm_length
    return (
        f_1 + f_2 + f_3 + f_4,
        length * (f_4 - f_2),
        length * (f_3 - f_1),
        parameters.drag_factor * (w_1 - w_2 + w_3 - w_4),
    )


def drag(velocity: Rows, wind: Rows, parameters: QuadrotorParameters) -> tuple[Row, Row, Row]:
    """The force D of eq (3) in W (N): along the velocity of the air relative to the vehicle, (c₁ + c₂ |v|) v.

    Args:
        velocity: of the vehicle in W, m/s.
        wind: velocity of the air in W, m/s.
        parameters: c₁ is `linear_drag`, c₂ `quadratic_drag`.
    """
    if is_zero(parameters.linear_drag) and is_zero(parameters.quadratic_drag):
        return 0.0, 0.0, 0.0
    x, y, z = wind[0] - velocity[0], wind[1] - velocity[1], wind[2] - velocity[2]
    factor = parameters.linear_drag + parameters.quadratic_drag * sqrt(x * x + y * y + z * z + _TINY)
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


def angular_acceleration(
    body_rates: Rows, torque: Rows, rotor_residual: Row, parameters: QuadrotorParameters
) -> tuple[Row, Row, Row]:
    """Rates of p, q, r (rad/s²): Euler's equations with spinning rotors, the last three lines of eq (3).

    Args:
        body_rates: p, q, r, rad/s.
        torque: of the rotors in B, N m.
        rotor_residual: ω_r of eq (4), rad/s.
        parameters: of the vehicle.
    """
    p, q, r = body_rates
    tau_x, tau_y, tau_z = torque
    i_xx, i_yy, i_zz = parameters.inertia
    spin = parameters.rotor_inertia * rotor_residual
    return (
        (q * ((i_yy - i_zz) * r - spin) + tau_x) / i_xx,
        (p * ((i_zz - i_xx) * r + spin) + tau_y) / i_yy,
        ((i_xx - i_yy) * p * q + tau_z) / i_zz,
    )


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
        state: position in W (m); roll, pitch, yaw (rad); velocity in W (m/s); p, q, r (rad/s).
        wrench: F_z (N), τ_x, τ_y, τ_z (N m) of the rotors, in B.
        rotor_residual: ω_r of eq (4), rad/s.
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
    """
    roll, pitch, yaw, v_x, v_y, v_z, p, q, r = state[3:]
    thrust, tau_x, tau_y, tau_z = wrench
    sin_roll, cos_roll, sin_pitch, cos_pitch = sin(roll), cos(roll), sin(pitch), cos(pitch)
    sin_yaw, cos_yaw = sin(yaw), cos(yaw)
    forward = sin_pitch * cos_roll
    drag_x, drag_y, drag_z = drag((v_x, v_y, v_z), wind, parameters)
    mass = parameters.mass
    return [
        v_x,
        v_y,
        v_z,
        *kinematics((p, q, r), sin_roll, cos_roll, sin_pitch, cos_pitch),
        ((sin_yaw * sin_roll + cos_yaw * forward) * thrust + drag_x) / mass,
        ((sin_yaw * forward - cos_yaw * sin_roll) * thrust + drag_y) / mass,
        (cos_pitch * cos_roll * thrust + drag_z) / mass - parameters.gravity,
        *angular_acceleration((p, q, r), (tau_x, tau_y, tau_z), rotor_residual, parameters),
    ]


def rotor_residual(rotor_speed: Rows) -> Row:
    """Eq (4): ω_r, rad/s."""
    w_1, w_2, w_3, w_4 = rotor_speed
    return w_2 + w_4 - w_1 - w_3


def limited_rotor_speed(speed: Row, low: Row, high: Row) -> Row:
    """A rotor speed (rad/s) clipped to what the rotor can do; idle for a command that is not a number."""
    return minimum(maximum(speed, low), high)


def quadrotor_derivative(
    state: Rows,
    rotor_speed_command: Rows,
    wind: Rows,
    parameters: QuadrotorParameters,
    kinematics: AttitudeKinematics,
) -> list[Row]:
    """Time derivative of the 16 rows of rigid body and rotors together.

    Args:
        state: the 12 rows of `rigid_body_derivative`; ω₁ to ω₄ (rad/s).
        rotor_speed_command: rad/s; what lies outside the rotors' limits is clipped.
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
    """
    rotor_speed = state[12:]
    wrench, residual = rotor_wrench(rotor_speed, parameters), rotor_residual(rotor_speed)
    low, high, lag = parameters.min_rotor_speed, parameters.max_rotor_speed, parameters.rotor_time_constant
    return [
        *rigid_body_derivative(state[:12], wrench, residual, wind, parameters, kinematics),
        *[
            (limited_rotor_speed(command, low, high) - speed) / lag
            for command, speed in zip(rotor_speed_command, rotor_speed, strict=True)
        ],
    ]
