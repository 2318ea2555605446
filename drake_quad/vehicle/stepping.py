"""What the vehicle does under its inputs: a step over an interval in which they are held, or the slope at an instant.

The rotors do not feel the rigid body, and their lag behind a held command has a closed form. So the step takes the
rotors exactly, at the beginning, the middle and the end of the interval, and integrates the rigid body under their
wrench by the classical fourth-order Runge–Kutta method.
"""

from typing import Any

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, exp, where
from drake_quad.vehicle.dynamics import (
    AttitudeKinematics,
    equations_of_motion,
    held_rotor_speed,
    quadrotor_derivative,
    rigid_kinematics,
    rotor_residual,
    rotor_wrench,
    small_angle_kinematics,
)
from drake_quad.vehicle.faults import rotor_speed_factor
from drake_quad.vehicle.parameters import QuadrotorParameters, parameters_from_rows

_AT_REST = (0.0,) * 16


@formula
def quadrotor_step(
    kinematics: AttitudeKinematics,
    rigid_body: Rows,
    rotor_speed: Rows,
    rotor_speed_command: Rows,
    wind: Rows,
    crashed: Rows,
    parameters: Rows,
    faults: Rows,
    time: Row,
    time_step: float,
) -> tuple[Rows, Rows]:
    """Returns the rigid body's state and the rotor speeds at the end of a step.

    Args:
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
        rigid_body: the 12 rows of `rigid_body_derivative`.
        rotor_speed: ω₁ to ω₄, rad/s.
        rotor_speed_command: likewise; what lies outside the rotors' limits is clipped.
        wind: velocity of the air in W, m/s.
        crashed: a row; a vehicle for which it is not zero stays as it is.
        parameters: the 19 rows of `QuadrotorParameters`.
        faults: the 6 rows of `RotorFaults`, taken at the middle of the step.
        time: at the end of the step, s.
        time_step: h, s.
    """
    vehicle = parameters_from_rows(parameters)
    body, rotors = step_of_flight(
        kinematics,
        rigid_body,
        rotor_speed,
        held_rotor_speed(rotor_speed_command, vehicle, rotor_speed_factor(faults, time - 0.5 * time_step)),
        wind,
        vehicle,
        time_step,
    )
    stays = crashed[0] != 0.0
    return where(stays, rigid_body, body), where(stays, rotor_speed, rotors)


@formula
def step_of_flight(
    kinematics: AttitudeKinematics,
    rigid_body: Rows,
    rotor_speed: Rows,
    target: Rows,
    wind: Rows,
    vehicle: QuadrotorParameters,
    time_step: float,
) -> tuple[Rows, Rows]:
    """The same for a vehicle that has not crashed and whose rotors are on their way to a target (rad/s)."""
    decay = exp(-0.5 * time_step / vehicle.rotor_time_constant)
    middle = lagging(rotor_speed, target, decay)
    end = lagging(middle, target, decay)
    rotors_1 = (*rotor_wrench(rotor_speed, vehicle), rotor_residual(rotor_speed))
    rotors_2 = (*rotor_wrench(middle, vehicle), rotor_residual(middle))
    rotors_3 = (*rotor_wrench(end, vehicle), rotor_residual(end))

    motion_1 = rigid_body[3:12]
    slope_1 = equations_of_motion(motion_1, rotors_1, wind, vehicle, kinematics)
    motion_2 = moved(motion_1, slope_1, 0.5 * time_step)
    slope_2 = equations_of_motion(motion_2, rotors_2, wind, vehicle, kinematics)
    motion_3 = moved(motion_1, slope_2, 0.5 * time_step)
    slope_3 = equations_of_motion(motion_3, rotors_2, wind, vehicle, kinematics)
    motion_4 = moved(motion_1, slope_3, time_step)
    slope_4 = equations_of_motion(motion_4, rotors_3, wind, vehicle, kinematics)

    sixth, third = time_step / 6.0, time_step / 3.0
    motion = moved(moved(moved(moved(motion_1, slope_1, sixth), slope_2, third), slope_3, third), slope_4, sixth)
    # Nothing depends on the position: its part of the method is a weighted mean of the stages' velocities.
    position = (
        rigid_body[0] + sixth * (motion_1[3] + 2.0 * (motion_2[3] + motion_3[3]) + motion_4[3]),
        rigid_body[1] + sixth * (motion_1[4] + 2.0 * (motion_2[4] + motion_3[4]) + motion_4[4]),
        rigid_body[2] + sixth * (motion_1[5] + 2.0 * (motion_2[5] + motion_3[5]) + motion_4[5]),
    )
    return (*position, *motion), end


@formula
def lagging(speed: Rows, target: Rows, decay: Row) -> tuple[Row, Row, Row, Row]:
    """Rotor speeds some time later, on their way to a target: the decay is exp(-time / time constant)."""
    w_1, w_2, w_3, w_4 = speed
    t_1, t_2, t_3, t_4 = target
    return (
        t_1 + (w_1 - t_1) * decay,
        t_2 + (w_2 - t_2) * decay,
        t_3 + (w_3 - t_3) * decay,
        t_4 + (w_4 - t_4) * decay,
    )


@formula
def moved(motion: Rows, slope: Rows, time: Row) -> tuple[Row, ...]:
    """The 9 rows of a motion after a time with a slope."""
    roll, pitch, yaw, v_x, v_y, v_z, p, q, r = motion
    d_roll, d_pitch, d_yaw, a_x, a_y, a_z, d_p, d_q, d_r = slope
    return (
        roll + time * d_roll,
        pitch + time * d_pitch,
        yaw + time * d_yaw,
        v_x + time * a_x,
        v_y + time * a_y,
        v_z + time * a_z,
        p + time * d_p,
        q + time * d_q,
        r + time * d_r,
    )


@formula
def rigid_step(*rows_and_numbers: Any) -> tuple[Rows, Rows]:
    """The step with `rigid_kinematics`."""
    return quadrotor_step(rigid_kinematics, *rows_and_numbers)


@formula
def small_angle_step(*rows_and_numbers: Any) -> tuple[Rows, Rows]:
    """The step with `small_angle_kinematics`."""
    return quadrotor_step(small_angle_kinematics, *rows_and_numbers)


@formula
def quadrotor_slope(
    kinematics: AttitudeKinematics,
    state: Rows,
    rotor_speed_command: Rows,
    wind: Rows,
    crashed: Rows,
    parameters: Rows,
    faults: Rows,
    time: Row,
) -> tuple[Rows]:
    """Returns the time derivatives of the 16 rows of rigid body and rotors; arguments as for `quadrotor_step`."""
    factor = rotor_speed_factor(faults, time)
    vehicle = parameters_from_rows(parameters)
    slope = quadrotor_derivative(state, rotor_speed_command, wind, vehicle, kinematics, factor)
    return (where(crashed[0] != 0.0, _AT_REST, slope),)


@formula
def rigid_slope(*rows_and_numbers: Any) -> tuple[Rows]:
    """The slope with `rigid_kinematics`."""
    return quadrotor_slope(rigid_kinematics, *rows_and_numbers)


@formula
def small_angle_slope(*rows_and_numbers: Any) -> tuple[Rows]:
    """The slope with `small_angle_kinematics`."""
    return quadrotor_slope(small_angle_kinematics, *rows_and_numbers)
