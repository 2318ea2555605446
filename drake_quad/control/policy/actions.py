"""What the actions of a policy, numbers from -1 to 1, command; beyond these bounds they are as on them."""

from typing import NamedTuple

from drake_quad.control.attitude import MomentOfInertia
from drake_quad.control.policy.frames import LevelFrame, level_axes
from drake_quad.control.thrust_vectoring import Vectored
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.geometry.axes import Vector
from drake_quad.geometry.kinematics import torque_of
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
    """The wrench of each rotor over its squared speed."""

    rotor_1: Wrench
    rotor_2: Wrench
    rotor_3: Wrench
    rotor_4: Wrench


class ThrustRange(NamedTuple):
    """Thrusts of an action of -1 and of 1."""

    least: ForceB
    most: ForceB


class AccelerationScale(NamedTuple):
    """Accelerations that an action of 1 commands along each axis of the frame of the action."""

    x: AccelerationW
    y: AccelerationW
    z: AccelerationW


class AttitudeScale(NamedTuple):
    """What actions mean as thrust and attitude.

    Attributes:
        thrust: of the first action.
        tilt: roll and pitch of 1 in the second and third.
        yaw: by which 1 in the fourth turns away from the reference's yaw.
    """

    thrust: ThrustRange
    tilt: Angle
    yaw: Angle


class RatesScale(NamedTuple):
    """What actions mean as thrust and body rates, and the loop of the rates on the ground.

    Attributes:
        thrust: of the first action.
        rates: of 1 in the others.
        gains: angular acceleration over the error of a rate, 1/s.
        i_xx: moment of inertia about x_B, believed.
        i_yy: about y_B.
        i_zz: about z_B.
    """

    thrust: ThrustRange
    rates: BodyRates
    gains: PerAngle
    i_xx: MomentOfInertia
    i_yy: MomentOfInertia
    i_zz: MomentOfInertia


class SpeedScale(NamedTuple):
    """What actions mean as speeds of rotors, and which wrench these are believed to give.

    Attributes:
        least: of -1.
        most: of 1.
        wrenches: of each rotor, over its squared speed.
    """

    least: RotorRate
    most: RotorRate
    wrenches: PerRotor


def within(action: Row) -> Row:
    """Return an action limited to its bounds; NaN if it is NaN or infinite, so that the flight ends there."""
    # The limits alone would turn NaN into a bound, since comparisons with NaN are false. 0 · NaN and 0 · ∞ are NaN.
    return minimum(maximum(action, -1.0), 1.0) + 0.0 * action


def _scaled_thrust(action: Row, between: ThrustRange) -> ForceB:
    return between.least + 0.5 * (within(action) + 1.0) * (between.most - between.least)


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
        action: three rows, one for each axis of the frame.
        measurement: measured state of the vehicle; None with the frame `world`.
        reference: reference that the vehicle follows; None with the frame `world`.
        scale: accelerations that an action of 1 commands.
        frame: name of the frame.
        turn: additional rotation of the frame about Z, rad.
    """
    along = Vector._make(within(row) * most for row, most in zip(action, scale, strict=True))
    if measurement is None or reference is None:
        return Acceleration(*along)
    axes = level_axes(frame, measurement.yaw, reference.yaw, turn)
    return Acceleration(*(along if axes is None else axes.in_world(along)))


def commanded_attitude(action: Action, reference: Reference, scale: AttitudeScale) -> Vectored:
    """Thrust and attitude that an action of four rows commands: thrust, roll, pitch, and yaw from the reference's."""
    thrust, roll, pitch, yaw = action
    return Vectored(
        Thrust(_scaled_thrust(thrust, scale.thrust)),
        Attitude(within(roll) * scale.tilt, within(pitch) * scale.tilt, reference.yaw + within(yaw) * scale.yaw),
        BodyRates(0.0, 0.0, 0.0),
        AngularAcceleration(0.0, 0.0, 0.0),
    )


def _commanded_rates(action: Action, rates: BodyRates) -> tuple[BodyRateB, BodyRateB, BodyRateB]:
    p, q, r = (within(row) * most for row, most in zip(action, rates, strict=True))
    return p, q, r


def rates_on_board(action: Action, scale: RatesScale) -> AttitudeTarget:
    """Thrust and body rates that an action of four rows commands, for an autopilot that heeds no attitude."""
    thrust, *turning = action
    return AttitudeTarget(
        _scaled_thrust(thrust, scale.thrust), 0.0, 0.0, 0.0, *_commanded_rates(tuple(turning), scale.rates)
    )


def rates_from_the_ground(action: Action, measurement: State, scale: RatesScale) -> Wrench:
    """The wrench for thrust and body rates that an action of four rows commands: τ = I k (ω_r - ω) + ω × I ω in B."""
    thrust, *turning = action
    own = BodyRates(measurement.p, measurement.q, measurement.r)
    wanted = AngularAcceleration._make(
        k * (commanded - rate)
        for k, commanded, rate in zip(scale.gains, _commanded_rates(tuple(turning), scale.rates), own, strict=True)
    )
    return Wrench(_scaled_thrust(thrust, scale.thrust), *torque_of(wanted, own, scale.i_xx, scale.i_yy, scale.i_zz))


def wrench_of_speeds(action: Action, scale: SpeedScale, order: tuple[int, ...]) -> Wrench:
    """The wrench that rotors of the commanded speeds are believed to give, from which allocation makes these speeds.

    Args:
        action: of four rows.
        scale: of the speeds.
        order: place of each rotor's row in the action.
    """
    total: list[Row] = [0.0, 0.0, 0.0, 0.0]
    for place, wrench in zip(order, scale.wrenches, strict=True):
        speed = scale.least + 0.5 * (within(action[place]) + 1.0) * (scale.most - scale.least)
        total = [whole + part * speed * speed for whole, part in zip(total, wrench, strict=True)]
    return Wrench._make(total)
