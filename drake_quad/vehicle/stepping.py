"""One step of the vehicle over an interval in which its inputs are held.

The rotors do not feel the rigid body, and their lag behind a held command has a closed form. So the step takes the
rotors exactly, at the beginning, the middle and the end of the interval, and integrates the rigid body under their
wrench by the classical fourth-order Runge–Kutta method.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drake_quad.elementary import Row, exp
from drake_quad.vehicle.dynamics import (
    AttitudeKinematics,
    limited_rotor_speed,
    rigid_body_derivative,
    rotor_residual,
    rotor_wrench,
)
from drake_quad.vehicle.parameters import QuadrotorParameters

Derivative = Callable[[np.ndarray, Any], np.ndarray]


def quadrotor_step(
    rigid_body: np.ndarray,
    rotor_speed: Sequence[Row],
    rotor_speed_command: Sequence[Row],
    wind: Sequence[Row],
    parameters: QuadrotorParameters,
    kinematics: AttitudeKinematics,
    time_step: float,
) -> tuple[np.ndarray, list[Row]]:
    """Returns the rigid body's state and the rotor speeds a time step later.

    Args:
        rigid_body: (12,), or (12, N) for a fleet: the state of `rigid_body_derivative`.
        rotor_speed: ω₁ to ω₄, rad/s.
        rotor_speed_command: rad/s; what lies outside the rotors' limits is clipped.
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
        time_step: s.
    """

    def derivative(state: np.ndarray, rotors: Any) -> np.ndarray:
        wrench, residual = rotors
        rows = state.tolist() if state.ndim == 1 else state
        slope = np.empty_like(state)
        for i, row in enumerate(rigid_body_derivative(rows, wrench, residual, wind, parameters, kinematics)):
            slope[i] = row
        return slope

    command = limited_rotor_speed(rotor_speed_command, parameters)
    decay = exp(-0.5 * time_step / parameters.rotor_time_constant)
    speeds = [rotor_speed]
    for _ in range(2):
        speeds.append([target + (speed - target) * decay for speed, target in zip(speeds[-1], command, strict=True)])
    start, middle, end = ((rotor_wrench(speed, parameters), rotor_residual(speed)) for speed in speeds)
    return runge_kutta_4(derivative, rigid_body, (start, middle, end), time_step), speeds[-1]


def runge_kutta_4(derivative: Derivative, state: np.ndarray, inputs: tuple[Any, Any, Any], step: float) -> np.ndarray:
    """One step of the classical fourth-order Runge–Kutta method.

    Args:
        derivative: of the state, given the state and an input.
        state: at the beginning of the step; any shape.
        inputs: at the beginning, the middle and the end of the step.
        step: its length, s.
    """
    start, middle, end = inputs
    k_1 = derivative(state, start)
    k_2 = derivative(state + 0.5 * step * k_1, middle)
    k_3 = derivative(state + 0.5 * step * k_2, middle)
    k_4 = derivative(state + step * k_3, end)
    return state + step / 6.0 * (k_1 + 2.0 * (k_2 + k_3) + k_4)
