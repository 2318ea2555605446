"""What the vehicle does under its inputs: a step over an interval in which they are held, or the slope at an instant.

The rotors do not feel the rigid body, and their lag behind a held command has a closed form. So the step takes the
rotors exactly, at the beginning, the middle and the end of the interval, and integrates the rigid body under their
wrench by the classical fourth-order Runge–Kutta method.
"""

from typing import NamedTuple

from drake_quad.framework.elementary import exp, where
from drake_quad.signals import Crashed, RotorSpeed, Row, State, Wind
from drake_quad.vehicle.dynamics import (
    ActionOfRotors,
    AttitudeKinematics,
    Motion,
    equations_of_motion,
    held_rotor_speed,
    rigid_body_derivative,
    rotor_action,
)
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors, speed_factors
from drake_quad.vehicle.parameters import QuadrotorParameters


class VehicleState(NamedTuple):
    """Rigid body and rotors; or their rates, per second."""

    body: State
    rotors: RotorSpeed


def quadrotor_step(
    body: State,
    rotors: RotorSpeed,
    command: RotorSpeed,
    wind: Wind,
    crashed: Crashed | None,
    parameters: QuadrotorParameters,
    faults: RotorFaults | None,
    time: Row,
    time_step: float,
    kinematics: AttitudeKinematics,
    action: ActionOfRotors = rotor_action,
) -> VehicleState:
    """The vehicle at the end of a step.

    Args:
        body: at its beginning.
        rotors: at its beginning.
        command: rotor speeds; those beyond the rotors' limits are clipped.
        wind: velocity of the air.
        crashed: a vehicle for which it is not zero stays as it is; None if all fly.
        parameters: of the vehicle.
        faults: of the rotors, taken at the middle of the step; None if there are none.
        time: at the end of the step, s.
        time_step: h, s.
        kinematics: `rigid_kinematics` or `small_angle_kinematics`.
        action: of the rotors, for any layout, or for pairs: `paired_rotor_action`.
    """
    factors = SpeedFactors() if faults is None else speed_factors(faults, time - 0.5 * time_step)
    target = held_rotor_speed(command, parameters, factors)
    after = step_of_flight(body, rotors, target, wind, parameters, time_step, kinematics, action)
    return after if crashed is None else where(crashed.crashed != 0.0, VehicleState(body, rotors), after)


def step_of_flight(
    body: State,
    rotors: RotorSpeed,
    target: RotorSpeed,
    wind: Wind,
    parameters: QuadrotorParameters,
    time_step: float,
    kinematics: AttitudeKinematics,
    action: ActionOfRotors = rotor_action,
) -> VehicleState:
    """The same for a vehicle that has not crashed and whose rotors are on their way to a target."""
    decay = exp(-0.5 * time_step / parameters.rotor_time_constant)
    middle = lagging(rotors, target, decay)
    end = lagging(middle, target, decay)
    action_1, action_2, action_3 = (action(speed, parameters) for speed in (rotors, middle, end))

    motion_1 = Motion.of(body)
    slope_1 = equations_of_motion(motion_1, action_1, wind, parameters, kinematics)
    motion_2 = moved(motion_1, slope_1, 0.5 * time_step)
    slope_2 = equations_of_motion(motion_2, action_2, wind, parameters, kinematics)
    motion_3 = moved(motion_1, slope_2, 0.5 * time_step)
    slope_3 = equations_of_motion(motion_3, action_2, wind, parameters, kinematics)
    motion_4 = moved(motion_1, slope_3, time_step)
    slope_4 = equations_of_motion(motion_4, action_3, wind, parameters, kinematics)

    sixth, third = time_step / 6.0, time_step / 3.0
    motion = moved(moved(moved(moved(motion_1, slope_1, sixth), slope_2, third), slope_3, third), slope_4, sixth)
    # Nothing depends on the position: its part of the method is a weighted mean of the stages' velocities.
    x = body.x + sixth * (motion_1.v_x + 2.0 * (motion_2.v_x + motion_3.v_x) + motion_4.v_x)
    y = body.y + sixth * (motion_1.v_y + 2.0 * (motion_2.v_y + motion_3.v_y) + motion_4.v_y)
    z = body.z + sixth * (motion_1.v_z + 2.0 * (motion_2.v_z + motion_3.v_z) + motion_4.v_z)
    return VehicleState(State(x, y, z, *motion), end)


def lagging(speed: RotorSpeed, target: RotorSpeed, decay: Row) -> RotorSpeed:
    """Rotor speeds some time later, on their way to a target: the decay is exp(-time / time constant)."""
    return RotorSpeed._make(t + (w - t) * decay for w, t in zip(speed, target, strict=True))


def moved(motion: Motion, slope: Motion, time: Row) -> Motion:
    """A motion after a time (s) with a slope."""
    return Motion._make(row + time * rate for row, rate in zip(motion, slope, strict=True))


def quadrotor_slope(
    state: VehicleState,
    command: RotorSpeed,
    wind: Wind,
    crashed: Crashed | None,
    parameters: QuadrotorParameters,
    faults: RotorFaults | None,
    time: Row,
    kinematics: AttitudeKinematics,
    action: ActionOfRotors = rotor_action,
) -> VehicleState:
    """The time derivative of rigid body and rotors; arguments as for `quadrotor_step`."""
    factors = SpeedFactors() if faults is None else speed_factors(faults, time)
    target = held_rotor_speed(command, parameters, factors)
    body = rigid_body_derivative(state.body, action(state.rotors, parameters), wind, parameters, kinematics)
    lag = parameters.rotor_time_constant
    rotors = RotorSpeed._make((t - w) / lag for t, w in zip(target, state.rotors, strict=True))
    slope = VehicleState(body, rotors)
    if crashed is None:
        return slope
    at_rest = VehicleState(State(*[0.0] * len(body)), RotorSpeed(*[0.0] * len(rotors)))
    return where(crashed.crashed != 0.0, at_rest, slope)
