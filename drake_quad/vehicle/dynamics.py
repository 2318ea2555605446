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

All functions are of rows: numbers for one vehicle, arrays for a fleet.
"""

from collections.abc import Callable

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, maximum, minimum, sin_cos, sqrt
from drake_quad.vehicle.parameters import QuadrotorParameters

# An airspeed of zero must not make the derivative of the square root infinite; 1e-200 changes no float above 1e-92.
_TINY = 1e-200

AttitudeKinematics = Callable[[Rows, Row, Row, Row, Row], tuple[Row, Row, Row]]


@formula
def rotor_wrench(rotor_speed: Rows, parameters: QuadrotorParameters) -> tuple[Row, Row, Row, Row]:
    """Eq (5): thrust (N) of the rotors and their torques about the centre of mass (N m), in B.

    Args:
        rotor_speed: ω₁ to ω₄, rad/s.
        parameters: of the vehicle.
    """
    w_1, w_2, w_3, w_4 = rotor_speed
    w_1, w_2, w_3, w_4 = w_1 * w_1, w_2 * w_2, w_3 * w_3, w_4 * w_4
    b_1, b_2, b_3, b_4 = parameters.thrust_factor
    f_1, f_2, f_3, f_4 = b_1 * w_1, b_2 * w_2, b_3 * w_3, b_4 * w_4
    x, y = parameters.centre_of_mass
    thrust = f_1 + f_2 + f_3 + f_4
    return (
        thrust,
        parameters.arm_length * (f_4 - f_2) - y * thrust,
        parameters.arm_length * (f_3 - f_1) + x * thrust,
        parameters.drag_factor * (w_1 - w_2 + w_3 - w_4),
    )


@formula
def rotor_residual(rotor_speed: Rows) -> Row:
    """Eq (4): ω_r, rad/s."""
    w_1, w_2, w_3, w_4 = rotor_speed
    return w_2 + w_4 - w_1 - w_3


@formula
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


@formula
def rigid_kinematics(
    body_rates: Rows, sin_roll: Row, cos_roll: Row, sin_pitch: Row, cos_pitch: Row
) -> tuple[Row, Row, Row]:
    """Eq (2) inverted: rates of roll, pitch and yaw (rad/s) from p, q, r. Singular at a pitch of 90°."""
    p, q, r = body_rates
    yaw_rate = (q * sin_roll + r * cos_roll) / cos_pitch
    return p + sin_pitch * yaw_rate, q * cos_roll - r * sin_roll, yaw_rate


@formula
def small_angle_kinematics(
    body_rates: Rows, sin_roll: Row, cos_roll: Row, sin_pitch: Row, cos_pitch: Row
) -> tuple[Row, Row, Row]:
    """What eq (3) takes for (2): p, q, r are the rates of roll, pitch and yaw (rad/s)."""
    p, q, r = body_rates
    return p, q, r


@formula
def equations_of_motion(
    motion: Rows, rotors: Rows, wind: Rows, parameters: QuadrotorParameters, kinematics: AttitudeKinematics
) -> tuple[Row, ...]:
    """Eq (3) without its first three lines: the derivatives of the 9 rows of the motion.

    Args:
        motion: roll, pitch, yaw (rad); velocity in W (m/s); p, q, r (rad/s).
        rotors: F_z (N), τ_x, τ_y, τ_z (N m) in B; ω_r of eq (4) (rad/s).
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
    """
    roll, pitch, yaw, v_x, v_y, v_z, p, q, r = motion
    thrust, tau_x, tau_y, tau_z, residual = rotors
    wind_x, wind_y, wind_z = wind
    mass, (i_xx, i_yy, i_zz) = parameters.mass, parameters.inertia
    sin_roll, cos_roll = sin_cos(roll)
    sin_pitch, cos_pitch = sin_cos(pitch)
    sin_yaw, cos_yaw = sin_cos(yaw)
    forward = sin_pitch * cos_roll
    airspeed = wind_x - v_x, wind_y - v_y, wind_z - v_z
    drag_x, drag_y, drag_z = drag(airspeed, parameters.linear_drag, parameters.quadratic_drag)
    spin = parameters.rotor_inertia * residual
    roll_rate, pitch_rate, yaw_rate = kinematics((p, q, r), sin_roll, cos_roll, sin_pitch, cos_pitch)
    return (
        roll_rate,
        pitch_rate,
        yaw_rate,
        ((sin_yaw * sin_roll + cos_yaw * forward) * thrust + drag_x) / mass,
        ((sin_yaw * forward - cos_yaw * sin_roll) * thrust + drag_y) / mass,
        (cos_pitch * cos_roll * thrust + drag_z) / mass - parameters.gravity,
        (q * ((i_yy - i_zz) * r - spin) + tau_x) / i_xx,
        (p * ((i_zz - i_xx) * r + spin) + tau_y) / i_yy,
        ((i_xx - i_yy) * p * q + tau_z) / i_zz,
    )


@formula
def held_rotor_speed(command: Rows, parameters: QuadrotorParameters, speed_factor: Rows) -> tuple[Row, Row, Row, Row]:
    """Where the rotors go under a held command, rad/s.

    A command is clipped to what the rotors can do, idle if it is not a number; a faulty rotor gets a share of that.

    Args:
        command: ω₁ to ω₄, rad/s.
        parameters: of the vehicle.
        speed_factor: the share of each rotor, 1 if it is not faulty.
    """
    w_1, w_2, w_3, w_4 = command
    s_1, s_2, s_3, s_4 = speed_factor
    low, high = parameters.min_rotor_speed, parameters.max_rotor_speed
    return (
        s_1 * minimum(maximum(w_1, low), high),
        s_2 * minimum(maximum(w_2, low), high),
        s_3 * minimum(maximum(w_3, low), high),
        s_4 * minimum(maximum(w_4, low), high),
    )


@formula
def rigid_body_derivative(
    state: Rows,
    wrench: Rows,
    rotor_residual: Row,
    wind: Rows,
    parameters: QuadrotorParameters,
    kinematics: AttitudeKinematics,
) -> tuple[Row, ...]:
    """Time derivative of the 12 rows of the rigid body's state: eq (3).

    Args:
        state: position in W (m), then the 9 rows of the motion in `equations_of_motion`.
        wrench: F_z (N), τ_x, τ_y, τ_z (N m) of the rotors, in B.
        rotor_residual: ω_r of eq (4), rad/s.
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
    """
    motion = equations_of_motion(state[3:12], (*wrench, rotor_residual), wind, parameters, kinematics)
    return (state[6], state[7], state[8], *motion)


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


@formula
def quadrotor_derivative(
    state: Rows,
    rotor_speed_command: Rows,
    wind: Rows,
    parameters: QuadrotorParameters,
    kinematics: AttitudeKinematics,
    speed_factor: Rows = (1.0, 1.0, 1.0, 1.0),
) -> tuple[Row, ...]:
    """Time derivative of the 16 rows of rigid body and rotors together.

    Args:
        state: the 12 rows of `rigid_body_derivative`; ω₁ to ω₄ (rad/s).
        rotor_speed_command: rad/s; what lies outside the rotors' limits is clipped.
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
        speed_factor: of `held_rotor_speed`.
    """
    rotor_speed = state[12:16]
    wrench, residual = rotor_wrench(rotor_speed, parameters), rotor_residual(rotor_speed)
    body = rigid_body_derivative(state[0:12], wrench, residual, wind, parameters, kinematics)
    t_1, t_2, t_3, t_4 = held_rotor_speed(rotor_speed_command, parameters, speed_factor)
    w_1, w_2, w_3, w_4 = rotor_speed
    lag = parameters.rotor_time_constant
    return (*body, (t_1 - w_1) / lag, (t_2 - w_2) / lag, (t_3 - w_3) / lag, (t_4 - w_4) / lag)
