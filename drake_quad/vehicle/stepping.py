"""One step of the vehicle over an interval in which its inputs are held.

The rotors do not feel the rigid body, and their lag behind a held command has a closed form. So the step takes the
rotors exactly, at the beginning, the middle and the end of the interval, and integrates the rigid body under their
wrench by the classical fourth-order Runge–Kutta method.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drake_quad.elementary import Row, Rows, exp
from drake_quad.vehicle.dynamics import (
    AttitudeKinematics,
    equations_of_motion,
    held_rotor_speed,
    rotor_residual,
    rotor_wrench,
)
from drake_quad.vehicle.parameters import QuadrotorParameters


def quadrotor_step(
    rigid_body: Any,
    rotor_speed: Any,
    rotor_speed_command: Any,
    wind: Rows,
    parameters: QuadrotorParameters,
    kinematics: AttitudeKinematics,
    time_step: float,
    speed_factor: Any = None,
) -> tuple[Any, Any]:
    """Returns the rigid body's state and the rotor speeds a time step later.

    Args:
        rigid_body: the 12 rows of `rigid_body_derivative`: a list for one vehicle, a (12, N) array for a fleet.
        rotor_speed: ω₁ to ω₄, rad/s; a list or a (4, N) array.
        rotor_speed_command: rad/s, likewise; what lies outside the rotors' limits is clipped.
        wind: velocity of the air in W, m/s.
        parameters: of the vehicle.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
        time_step: s.
        speed_factor: of `held_rotor_speed`.
    """
    decay = exp(-0.5 * time_step / parameters.rotor_time_constant)
    command = held_rotor_speed(rotor_speed_command, parameters, speed_factor)
    if isinstance(rigid_body, list):
        middle = [lagging(speed, target, decay) for speed, target in zip(rotor_speed, command)]
        end = [lagging(speed, target, decay) for speed, target in zip(middle, command)]
    else:
        middle = lagging(rotor_speed, command, decay)
        end = lagging(middle, command, decay)
    rotors = [(*rotor_wrench(speed, parameters), rotor_residual(speed)) for speed in (rotor_speed, middle, end)]
    slope = equations_of_motion(wind, parameters, kinematics)

    def block_slope(motion: np.ndarray, rotors: Any) -> np.ndarray:
        return np.concatenate(slope(motion, rotors)).reshape(motion.shape)

    motion = rigid_body[3:12]
    if isinstance(rigid_body, list):
        stages = runge_kutta_4(slope, motion, rotors, time_step)
    else:
        stages = runge_kutta_4_of_block(block_slope, motion, rotors, time_step)
    # Nothing depends on the position: its part of the method is a weighted mean of the stages' velocities.
    sixth = time_step / 6.0
    velocities = [stage[3:6] for stage in (motion, *stages[:3])]
    position = [x + sixth * (v_1 + 2.0 * (v_2 + v_3) + v_4) for x, v_1, v_2, v_3, v_4 in zip(rigid_body, *velocities)]
    return [*position, *stages[3]], end


def lagging(speed: Row, target: Row, decay: Row) -> Row:
    """A rotor speed some time later, on its way to a target: the decay is exp(-time / time constant)."""
    return target + (speed - target) * decay


def runge_kutta_4(
    derivative: Callable[[Rows, Any], Rows], state: Rows, inputs: Sequence[Any], step: float
) -> tuple[Rows, Rows, Rows, Rows]:
    """One step of the classical fourth-order Runge–Kutta method.

    Args:
        derivative: of the state, given the state and an input.
        state: rows at the beginning of the step.
        inputs: three, at the beginning, the middle and the end of the step.
        step: its length, s.

    Returns:
        The states at which the derivative was taken for the second, third and fourth time, and the state after the
        step.
    """
    start, middle, end = inputs
    half, sixth = 0.5 * step, step / 6.0
    k_1 = derivative(state, start)
    x_2 = [x + half * k for x, k in zip(state, k_1)]
    k_2 = derivative(x_2, middle)
    x_3 = [x + half * k for x, k in zip(state, k_2)]
    k_3 = derivative(x_3, middle)
    x_4 = [x + step * k for x, k in zip(state, k_3)]
    k_4 = derivative(x_4, end)
    result = [x + sixth * (a + 2.0 * (b + c) + d) for x, a, b, c, d in zip(state, k_1, k_2, k_3, k_4)]
    return x_2, x_3, x_4, result


def runge_kutta_4_of_block(
    derivative: Callable[[np.ndarray, Any], np.ndarray], state: np.ndarray, inputs: Sequence[Any], step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The same for an array, in the memory of its derivatives: fresh memory would take twice the time.

    With the stages x₂ = x + h/2 k₁, x₃ = x + h/2 k₂, x₄ = x + h k₃ in place of the slopes, the step becomes
    (x₂ + 2 x₃ + x₄ - x + h/2 k₄) / 3. Arguments as for `runge_kutta_4`; the derivative must return new arrays.
    """
    start, middle, end = inputs

    def shifted(slope: np.ndarray, length: float) -> np.ndarray:
        slope *= length
        slope += state
        return slope

    x_2 = shifted(derivative(state, start), 0.5 * step)
    x_3 = shifted(derivative(x_2, middle), 0.5 * step)
    x_4 = shifted(derivative(x_3, middle), step)
    result = derivative(x_4, end)
    result *= 0.5 * step
    result += x_2
    result += x_3
    result += x_3
    result += x_4
    result -= state
    result /= 3.0
    return x_2, x_3, x_4, result
