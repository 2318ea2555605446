"""Velocity loop that commands an acceleration, as in PX4.

The loop commands an acceleration along the axes of W, to which the acceleration of the reference is added. Thrust and
attitude are computed from the required thrust vector, whose tilt and magnitude are limited. Integrals do not wind up at
these limits (`PositionControl.cpp` of PX4 1.15; PX4 User Guide, "Controller diagrams: multicopter position controller",
docs.px4.io; anti-windup by L. Rundqwist, "Anti-reset windup for PID controllers", IFAC World Congress 1990).
"""

from typing import Any

from drake_quad.control.pid_cascade.parameters import (
    CascadeMemory,
    CascadeParameters,
    CascadeRules,
    Memories,
    step_loops,
)
from drake_quad.framework.elementary import maximum, minimum, sin_cos, sqrt, where
from drake_quad.geometry.axes import TINY, Vector
from drake_quad.geometry.flatness import attitude_from_tilt, in_heading, tilt_from_thrust
from drake_quad.pid.loop import Memory, Terms, differentiate, integrate
from drake_quad.signals import AttitudeTarget, Reference, Row, State, Time, VelocityW


def saturate_velocity_sum(first: tuple[Row, Row], second: tuple[Row, Row], largest: VelocityW) -> tuple[Row, Row]:
    """Return the sum of two horizontal velocities, saturated such that the first velocity has priority.

    If the first velocity exceeds the limit, it is scaled down to the limit and the second is ignored. Otherwise the
    second velocity is scaled down until the magnitude of the sum is at most the limit: |v₁ + s v₂ / |v₂|| = v_max.
    """
    (x_1, y_1), (x_2, y_2) = first, second
    size_1 = sqrt(x_1 * x_1 + y_1 * y_1 + TINY)
    size_2 = sqrt(x_2 * x_2 + y_2 * y_2 + TINY)
    along = (x_1 * x_2 + y_1 * y_2) / size_2
    remaining_squared = maximum(largest * largest - size_1 * size_1, 0.0)
    scale_2 = minimum((sqrt(along * along + remaining_squared + TINY) - along) / size_2, 1.0)
    # If the velocity `first` alone reaches the limit, the velocity `second` is ignored.
    exhausted = size_1 >= largest
    scale_1 = where(exhausted, largest / size_1, 1.0)
    scale_2 = where(exhausted, 0.0, scale_2)
    total_x, total_y = x_1 + x_2, y_1 + y_2
    fits = total_x * total_x + total_y * total_y <= largest * largest
    return (
        where(fits, total_x, scale_1 * x_1 + scale_2 * x_2),
        where(fits, total_y, scale_1 * y_1 + scale_2 * y_2),
    )


def acceleration_target(
    m: State, r: Reference, parameters: CascadeParameters, memory: CascadeMemory, period: Time, rules: CascadeRules
) -> tuple[AttitudeTarget, CascadeMemory]:
    """Return the target of a velocity loop that commands an acceleration, and the next state of the loops.

    The arguments are as in `tilt_target`, except that the field `command` of `parameters` is an
    `AccelerationParameters`.
    """
    command: Any = parameters.command
    feedback, position = step_loops(
        Vector(r.x, r.y, r.z),
        Vector(m.x, m.y, m.z),
        parameters.position,
        memory.position,
        period,
        rules.position_integrates_first,
    )
    fraction = parameters.velocity_feed_forward
    v_x, v_y = saturate_velocity_sum((feedback.x, feedback.y), (fraction * r.v_x, fraction * r.v_y), command.max_speed)
    v_z = maximum(minimum(feedback.z + fraction * r.v_z, command.max_ascent), -command.max_descent)
    error = Vector(v_x - m.v_x, v_y - m.v_y, v_z - m.v_z)
    commanded, memories = _velocity_loop(m, r, Vector(v_x, v_y, v_z), error, parameters, memory.velocity, period)
    force, unsaturated = _limited_force(commanded, error, parameters, rules)
    terms = parameters.velocity.terms or (None, None, None)
    velocity = [_integrated(*axis, period) for axis in zip(memories, unsaturated, terms, strict=True)]
    tilt = tilt_from_thrust(in_heading(force, *sin_cos(r.yaw)))
    roll, pitch = attitude_from_tilt(tilt)
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(m.roll), sin_cos(m.pitch)
    # The commanded angular velocity is the yaw rate about Z, expressed along the measured axes of the body.
    level = r.yaw_rate * cos_pitch
    rates = -r.yaw_rate * sin_pitch, level * sin_roll, level * cos_roll
    first, second, third = velocity
    return AttitudeTarget(tilt.thrust, roll, pitch, r.yaw, *rates), CascadeMemory(position, (first, second, third))


def _velocity_loop(
    m: State,
    r: Reference,
    setpoint: Vector,
    error: Vector,
    parameters: CascadeParameters,
    memories: Memories,
    period: Time,
) -> tuple[Vector, list[Memory]]:
    """Return the commanded acceleration, m/s², and the next state of the velocity loop with unchanged integrals."""
    command: Any = parameters.command
    axes = zip(
        *((r.a_x, r.a_y, r.a_z), (m.v_x, m.v_y, m.v_z), setpoint, error),
        *(parameters.velocity.k_p, parameters.velocity.terms or (None, None, None), memories),
        strict=True,
    )
    accelerations, after = [], []
    for reference, measured, setpoint_on_axis, error_on_axis, k_p, terms, memory in axes:
        integral, derivative, k_ff, _ = terms or Terms()
        acceleration = command.feed_forward * reference + k_p * error_on_axis
        if integral is not None:
            acceleration = acceleration + memory.integral
        if derivative is not None:
            rate, memory = differentiate(measured, derivative, memory, period)
            acceleration = acceleration - derivative.k_d * rate
        if k_ff is not None:
            acceleration = acceleration + k_ff * setpoint_on_axis
        accelerations.append(acceleration)
        after.append(memory)
    return Vector(*accelerations), after


def _integrated(memory: Memory, error: Row, terms: Terms | None, period: Time) -> Memory:
    if terms is None or terms.integral is None or memory.integral is None:
        return memory
    return memory._replace(integral=integrate(memory.integral, error, terms.integral, period))


def _limited_force(
    acceleration: Vector, error: Vector, parameters: CascadeParameters, rules: CascadeRules
) -> tuple[Vector, Vector]:
    """Return the limited thrust vector in W, N, and the velocity error that the integrals integrate, m/s."""
    command: Any = parameters.command
    mass, gravity = parameters.mass, parameters.gravity
    a_x, a_y, a_z = acceleration
    up = gravity if rules.decouples_vertical else maximum(gravity + a_z, TINY)
    level_squared = a_x * a_x + a_y * a_y
    # The tangent of the tilt is the slope times the horizontal acceleration.
    slope = minimum(1.0 / up, command.tan_max_tilt / sqrt(level_squared + TINY))
    length = sqrt(1.0 + slope * slope * level_squared)
    f_z = maximum(mass * (gravity + a_z) * length, command.min_thrust) / length
    f_x, f_y = f_z * slope * a_x, f_z * slope * a_y
    integrated_z = where(
        f_z <= command.min_thrust,
        maximum(error.z, 0.0),
        where(f_z >= command.max_thrust, minimum(error.z, 0.0), error.z),
    )
    max_squared = command.max_thrust * command.max_thrust
    horizontal = sqrt(f_x * f_x + f_y * f_y + TINY)
    margin = minimum(horizontal, command.horizontal_margin)
    f_z = minimum(f_z, sqrt(maximum(max_squared - margin * margin, TINY)))
    horizontal_fraction = minimum(sqrt(maximum(max_squared - f_z * f_z, TINY)) / horizontal, 1.0)
    f_x, f_y = horizontal_fraction * f_x, horizontal_fraction * f_y
    produced_x, produced_y = f_x / mass, f_y / mass
    saturated = level_squared > produced_x * produced_x + produced_y * produced_y
    gain = 2.0 / parameters.velocity.k_p.x
    integrated_x = error.x - where(saturated, gain * (a_x - produced_x), 0.0)
    integrated_y = error.y - where(saturated, gain * (a_y - produced_y), 0.0)
    return Vector(f_x, f_y, f_z), Vector(integrated_x, integrated_y, integrated_z)
