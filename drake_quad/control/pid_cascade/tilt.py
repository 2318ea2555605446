"""Velocity loop that commands roll and pitch, as in the Crazyflie's firmware.

The loop acts along the axes of the heading frame. Its output along x is the pitch, its output along y is minus the
roll, and its output along z is an acceleration, which changes the thrust relative to hover. Each output is limited
separately (Bitcraze, crazyflie-firmware 2025.12, `position_controller_pid.c`).
"""

from typing import Any

from drake_quad.control.pid_cascade.parameters import CascadeMemory, CascadeParameters, CascadeRules, step_loops
from drake_quad.framework.elementary import maximum, minimum, sin_cos
from drake_quad.geometry.axes import Vector
from drake_quad.geometry.flatness import in_heading
from drake_quad.signals import AttitudeTarget, Reference, Row, State, Time


def tilt_target(
    m: State, r: Reference, parameters: CascadeParameters, memory: CascadeMemory, period: Time, rules: CascadeRules
) -> tuple[AttitudeTarget, CascadeMemory]:
    """Return the target of a velocity loop that commands roll and pitch, and the next state of the loops.

    Args:
        m: measured state.
        r: reference.
        parameters: parameters of the cascade, with `TiltParameters`.
        memory: state of the loops.
        period: period of the loops, s.
        rules: options in which the control laws of firmwares differ.
    """
    command: Any = parameters.command
    sin_yaw, cos_yaw = sin_cos(m.yaw)

    def in_heading_frame(x: Row, y: Row, z: Row) -> Vector:
        return Vector(*in_heading(Vector(x, y, z), sin_yaw, cos_yaw))

    setpoint, position = step_loops(
        in_heading_frame(r.x, r.y, r.z),
        in_heading_frame(m.x, m.y, m.z),
        parameters.position,
        memory.position,
        period,
        rules.position_integrates_first,
    )
    fraction = parameters.velocity_feed_forward
    reference_velocity = in_heading_frame(r.v_x, r.v_y, r.v_z)
    setpoint = Vector(
        *[
            proportional + fraction * velocity
            for proportional, velocity in zip(setpoint, reference_velocity, strict=True)
        ]
    )
    measured_velocity = in_heading_frame(m.v_x, m.v_y, m.v_z)
    output, velocity = step_loops(
        setpoint, measured_velocity, parameters.velocity, memory.velocity, period, rules.velocity_integrates_first
    )
    thrust = minimum(maximum(command.hover_thrust + parameters.mass * output.z, command.min_thrust), command.max_thrust)
    target = AttitudeTarget(thrust, -output.y, output.x, r.yaw, 0.0, 0.0, 0.0)
    return target, CascadeMemory(position, velocity)
