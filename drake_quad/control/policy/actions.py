"""Conversion of policy actions to commands. Actions are saturated at -1 and 1."""

from typing import NamedTuple

from drake_quad.control.attitude import MomentOfInertia
from drake_quad.control.policy.frames import LevelFrame, level_axes
from drake_quad.control.thrust_vectoring import VectoringOutput
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.geometry.axes import Vector
from drake_quad.geometry.kinematics import euler_torque
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.signals import (
    Acceleration,
    AccelerationW,
    Action,
    Angle,
    AngularAcceleration,
    Attitude,
    AttitudeTarget,
    BodyRateB,
    BodyRates,
    ForceB,
    Reference,
    RotorRate,
    Row,
    State,
    Thrust,
    Wrench,
)


class PerRotor(NamedTuple):
    """Wrench of each rotor divided by its squared speed, in N s² and N m s²."""

    rotor_1: Wrench
    rotor_2: Wrench
    rotor_3: Wrench
    rotor_4: Wrench


class ThrustRange(NamedTuple):
    """Thrusts for an action of -1 and for an action of 1."""

    min_thrust: ForceB
    max_thrust: ForceB


class AccelerationScale(NamedTuple):
    """Accelerations that an action of 1 commands along each axis of the action's frame."""

    x: AccelerationW
    y: AccelerationW
    z: AccelerationW


class AttitudeScale(NamedTuple):
    """Thrust and attitude for actions of -1 and 1.

    Attributes:
        thrust: range of the thrust, for the first component of an action.
        tilt: roll and pitch that the value 1 commands in the second and third component of an action.
        yaw: yaw, relative to the reference yaw, that the value 1 commands in the fourth component.
    """

    thrust: ThrustRange
    tilt: Angle
    yaw: Angle


class RatesScale(NamedTuple):
    """Thrust and body rates for actions of -1 and 1, and parameters of the body rate loop on the ground computer.

    Attributes:
        thrust: range of the thrust, for the first component of an action.
        rates: body rates that the value 1 commands in the other components.
        gains: ratio of angular acceleration to body rate error, 1/s.
        i_xx: moment of inertia of the nominal vehicle about x_B, kg m².
        i_yy: moment of inertia of the nominal vehicle about y_B, kg m².
        i_zz: moment of inertia of the nominal vehicle about z_B, kg m².
    """

    thrust: ThrustRange
    rates: BodyRates
    gains: PerAngle
    i_xx: MomentOfInertia
    i_yy: MomentOfInertia
    i_zz: MomentOfInertia


class SpeedScale(NamedTuple):
    """Maps from actions to rotor speeds, and from rotor speeds to the wrench of the nominal vehicle.

    Attributes:
        min_speed: rotor speed for an action of -1.
        max_speed: rotor speed for an action of 1.
        wrenches: wrench of each rotor divided by its squared speed.
    """

    min_speed: RotorRate
    max_speed: RotorRate
    wrenches: PerRotor


def saturate_action(action: Row) -> Row:
    """Return an action saturated at -1 and 1; NaN if the action is NaN or infinite, so that the flight ends."""
    # Saturation alone would convert NaN to -1 or 1, because comparisons with NaN are false. The added product is NaN if
    # the action is NaN or infinite.
    return minimum(maximum(action, -1.0), 1.0) + 0.0 * action


def _scaled_thrust(action: Row, thrust_range: ThrustRange) -> ForceB:
    return thrust_range.min_thrust + 0.5 * (saturate_action(action) + 1.0) * (
        thrust_range.max_thrust - thrust_range.min_thrust
    )


def commanded_acceleration(
    action: Action,
    measurement: State | None,
    reference: Reference | None,
    scale: AccelerationScale,
    frame: LevelFrame,
    turn: Angle,
) -> Acceleration:
    """Return the acceleration in W that an action commands along the axes of a frame.

    Args:
        action: three components, one for each axis of the frame.
        measurement: measured state of the vehicle; None with the frame `world`.
        reference: reference that the vehicle follows; None with the frame `world`.
        scale: accelerations that an action of 1 commands.
        frame: name of the frame.
        turn: additional rotation of the frame about Z, rad.
    """
    components = Vector._make(saturate_action(row) * limit for row, limit in zip(action, scale, strict=True))
    if measurement is None or reference is None:
        return Acceleration(*components)
    axes = level_axes(frame, measurement.yaw, reference.yaw, turn)
    return Acceleration(*(components if axes is None else axes.in_world(components)))


def commanded_attitude(action: Action, reference: Reference, scale: AttitudeScale) -> VectoringOutput:
    """Return the thrust and the attitude for an action: thrust, roll, pitch, and yaw relative to the reference."""
    thrust, roll, pitch, yaw = action
    return VectoringOutput(
        Thrust(_scaled_thrust(thrust, scale.thrust)),
        Attitude(
            saturate_action(roll) * scale.tilt,
            saturate_action(pitch) * scale.tilt,
            reference.yaw + saturate_action(yaw) * scale.yaw,
        ),
        BodyRates(0.0, 0.0, 0.0),
        AngularAcceleration(0.0, 0.0, 0.0),
    )


def _commanded_rates(action: Action, rates: BodyRates) -> tuple[BodyRateB, BodyRateB, BodyRateB]:
    p, q, r = (saturate_action(row) * limit for row, limit in zip(action, rates, strict=True))
    return p, q, r


def onboard_rate_command(action: Action, scale: RatesScale) -> AttitudeTarget:
    """Return the thrust and the body rates for an action, for an autopilot that does not control the attitude."""
    thrust, *rates = action
    return AttitudeTarget(
        _scaled_thrust(thrust, scale.thrust), 0.0, 0.0, 0.0, *_commanded_rates(tuple(rates), scale.rates)
    )


def offboard_rate_command(action: Action, measurement: State, scale: RatesScale) -> Wrench:
    """Return the wrench for an action that commands thrust and body rates: τ = I k (ω_r - ω) + ω × I ω in B."""
    thrust, *rates = action
    measured = BodyRates(measurement.p, measurement.q, measurement.r)
    acceleration = AngularAcceleration._make(
        k * (commanded - rate)
        for k, commanded, rate in zip(scale.gains, _commanded_rates(tuple(rates), scale.rates), measured, strict=True)
    )
    return Wrench(
        _scaled_thrust(thrust, scale.thrust), *euler_torque(acceleration, measured, scale.i_xx, scale.i_yy, scale.i_zz)
    )


def wrench_of_speeds(action: Action, scale: SpeedScale, order: tuple[int, ...]) -> Wrench:
    """Return the nominal vehicle's wrench at the commanded rotor speeds; allocation converts the wrench back to speeds.

    Args:
        action: four components.
        scale: rotor speeds for actions of -1 and 1.
        order: index of each rotor's speed in the action.
    """
    total: list[Row] = [0.0, 0.0, 0.0, 0.0]
    for row, wrench in zip(order, scale.wrenches, strict=True):
        speed = scale.min_speed + 0.5 * (saturate_action(action[row]) + 1.0) * (scale.max_speed - scale.min_speed)
        total = [
            accumulated + coefficient * speed * speed for accumulated, coefficient in zip(total, wrench, strict=True)
        ]
    return Wrench._make(total)
