"""The signals of the loop: what the rows of each port mean, in what unit and along whose axes.

World frame W: Z up. Body frame B: x forward, y to the left, z up. The yaw turns from X towards Y.
"""

import functools
import re
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_type_hints

# One number a vehicle: a float for one, an array for a fleet, or whatever Drake or the compiler put in their place
# (`drake_quad.framework.elementary`). To a type checker it is a float: formulas are checked as if of one vehicle.
Row = float


class Quantity(NamedTuple):
    """What a row is.

    Attributes:
        unit: SI.
        frame: along whose axes, W or B; empty if it has no direction.
        sign: sign that the parameters of a system must have; empty if they may have any.
    """

    unit: str
    frame: str = ""
    sign: Literal["", "positive", "nonnegative"] = ""


PositionW = Annotated[Row, Quantity("m", "W")]
VelocityW = Annotated[Row, Quantity("m/s", "W")]
AccelerationW = Annotated[Row, Quantity("m/s²", "W")]
AccelerationB = Annotated[Row, Quantity("m/s²", "B")]
JerkW = Annotated[Row, Quantity("m/s³", "W")]
SnapW = Annotated[Row, Quantity("m/s⁴", "W")]
Angle = Annotated[Row, Quantity("rad")]
AngleRate = Annotated[Row, Quantity("rad/s")]
AngleAcceleration = Annotated[Row, Quantity("rad/s²")]
BodyRateB = Annotated[Row, Quantity("rad/s", "B")]
BodyAccelerationB = Annotated[Row, Quantity("rad/s²", "B")]
ForceB = Annotated[Row, Quantity("N", "B")]
TorqueB = Annotated[Row, Quantity("N m", "B")]
RotorRate = Annotated[Row, Quantity("rad/s")]
Number = Annotated[Row, Quantity("1")]
Time = Annotated[Row, Quantity("s")]
Gain = Annotated[Row, Quantity("1/s")]


class State(NamedTuple):
    """Position, attitude, velocity and body rates of the vehicle, or what is measured of them."""

    x: PositionW
    y: PositionW
    z: PositionW
    roll: Angle
    pitch: Angle
    yaw: Angle
    v_x: VelocityW
    v_y: VelocityW
    v_z: VelocityW
    p: BodyRateB
    q: BodyRateB
    r: BodyRateB


class VehicleAcceleration(NamedTuple):
    """Acceleration of the origin of B, and the rates of the body rates."""

    a_x: AccelerationW
    a_y: AccelerationW
    a_z: AccelerationW
    p_rate: BodyAccelerationB
    q_rate: BodyAccelerationB
    r_rate: BodyAccelerationB


class RotorSpeed(NamedTuple):
    """Speeds of the four rotors."""

    rotor_1: RotorRate
    rotor_2: RotorRate
    rotor_3: RotorRate
    rotor_4: RotorRate


class Throttle(NamedTuple):
    """Throttles of the four rotors, from 0 to 1."""

    rotor_1: Number
    rotor_2: Number
    rotor_3: Number
    rotor_4: Number


class Charge(NamedTuple):
    """Charge that has been drawn from the battery."""

    drawn: Annotated[Row, Quantity("A h")]


class Swing(NamedTuple):
    """How the cable of a slung load hangs: turned by its pitch about Y, then by its roll about X, and their rates."""

    roll: Angle
    pitch: Angle
    roll_rate: AngleRate
    pitch_rate: AngleRate


class Wrench(NamedTuple):
    """Thrust F_z and torques τ_x, τ_y, τ_z."""

    thrust: ForceB
    tau_x: TorqueB
    tau_y: TorqueB
    tau_z: TorqueB


class Wind(NamedTuple):
    """Velocity of the air."""

    x: VelocityW
    y: VelocityW
    z: VelocityW


class Reference(NamedTuple):
    """Where the vehicle shall be, how it shall move, and where it shall look."""

    x: PositionW
    y: PositionW
    z: PositionW
    v_x: VelocityW
    v_y: VelocityW
    v_z: VelocityW
    a_x: AccelerationW
    a_y: AccelerationW
    a_z: AccelerationW
    yaw: Angle
    yaw_rate: AngleRate


class Jerk(NamedTuple):
    """Third derivative of the reference's position."""

    x: JerkW
    y: JerkW
    z: JerkW


class Snap(NamedTuple):
    """Fourth derivative of the reference's position, second of its yaw."""

    x: SnapW
    y: SnapW
    z: SnapW
    yaw: AngleAcceleration


class PositionError(NamedTuple):
    """Reference minus measured position, e."""

    x: PositionW
    y: PositionW
    z: PositionW


class PositionErrorRate(NamedTuple):
    """Rate of the position error, ė."""

    x: VelocityW
    y: VelocityW
    z: VelocityW


class Acceleration(NamedTuple):
    """A commanded acceleration, or a part of it; or one that is estimated, of what disturbs the vehicle."""

    x: AccelerationW
    y: AccelerationW
    z: AccelerationW


class Thrust(NamedTuple):
    """Thrust F_z."""

    thrust: ForceB


class Torque(NamedTuple):
    """Torques about the axes of the body."""

    tau_x: TorqueB
    tau_y: TorqueB
    tau_z: TorqueB


class Attitude(NamedTuple):
    """Roll, pitch and yaw."""

    roll: Angle
    pitch: Angle
    yaw: Angle


class BodyRates(NamedTuple):
    """Rates of turning about the axes of the body."""

    p: BodyRateB
    q: BodyRateB
    r: BodyRateB


class AttitudeTarget(NamedTuple):
    """What an autopilot is told: thrust F_z, attitude, and body rates, which are fed forward."""

    thrust: ForceB
    roll: Angle
    pitch: Angle
    yaw: Angle
    p: BodyRateB
    q: BodyRateB
    r: BodyRateB


class AngularAcceleration(NamedTuple):
    """Rates of the body rates."""

    p: BodyAccelerationB
    q: BodyAccelerationB
    r: BodyAccelerationB


class Crashed(NamedTuple):
    """1 for a vehicle that has crashed, 0 for one that flies."""

    crashed: Number


class CrashTime(NamedTuple):
    """When the vehicle crashed; infinite for one that flies."""

    crash_time: Time


# Signals of a fuzzy neural network have a row for each rule, axis, or parameter of a membership function. Signals with
# a row for each rule list all rules of the first axis, then all rules of the next.
Firing = tuple[Number, ...]
Weights = tuple[AccelerationW, ...]
CovarianceTrace = tuple[Gain, ...]
Antecedents = tuple[Number, ...]
# Those of a policy, as many as it sees, and as it acts with; and X, Y and Z of the reference at times ahead.
Observed = tuple[Number, ...]
Action = tuple[Number, ...]
Ahead = tuple[PositionW, ...]


class Signals(dict[str, Any]):
    """Types of the signals, by the names of their ports.

    Sensors add their readings when they are registered. Further sensors of one kind are numbered, as in
    `accelerometer_2`.
    """

    def __contains__(self, name: object) -> bool:
        """Return whether there is a signal of this name, which may have a number at its end."""
        return super().__contains__(name) or super().__contains__(_without_number(name))

    def __missing__(self, name: str) -> Any:
        """Return the type of a signal whose name has a number at its end."""
        if name not in self:
            raise KeyError(name)
        return self[_without_number(name)]


def numbered(kind: str, number: int) -> str:
    """Return the name of the port of a sensor, the first of its kind or a later one: `accelerometer_2`."""
    return kind if number == 1 else f"{kind}_{number}"


def _without_number(name: object) -> str:
    return re.sub(r"_\d+$", "", str(name))


SIGNALS = Signals()
SIGNALS |= {
    "state": State,
    "acceleration": VehicleAcceleration,
    "measurement": State,
    "rotor_speed": RotorSpeed,
    "rotor_speed_command": RotorSpeed,
    "throttle_command": Throttle,
    "charge": Charge,
    "swing": Swing,
    "wrench": Wrench,
    "shortfall": Wrench,
    "wind": Wind,
    "reference": Reference,
    "reference_jerk": Jerk,
    "reference_snap": Snap,
    "error": PositionError,
    "error_rate": PositionErrorRate,
    "pd": Acceleration,
    "feed_forward": Acceleration,
    "correction": Acceleration,
    "learned_disturbance": Acceleration,
    "disturbance": Acceleration,
    "acceleration_command": Acceleration,
    "thrust": Thrust,
    "torque": Torque,
    "attitude_command": Attitude,
    "body_rate_command": BodyRates,
    "attitude_target": AttitudeTarget,
    "angular_acceleration_command": AngularAcceleration,
    "crashed": Crashed,
    "crash_time": CrashTime,
    "firing": Firing,
    "firing_ahead": Firing,
    "weights": Weights,
    "covariance_trace": CovarianceTrace,
    "antecedents": Antecedents,
    "observation": Observed,
    "action": Action,
    "reference_ahead": Ahead,
}


def row_names(name: str, num_rows: int) -> list[str]:
    """Return the names of the rows of a signal of one vehicle.

    The rows of a network's signals are numbered from 1. `weights` lists all rules of the first axis, then all rules of
    the next.
    """
    kind = SIGNALS[name]
    return list(kind._fields) if hasattr(kind, "_fields") else [str(number + 1) for number in range(num_rows)]


def quantities(name: str, num_rows: int) -> list[Quantity]:
    """The quantities of the rows of a signal of one vehicle."""
    kind = SIGNALS[name]
    if hasattr(kind, "_fields"):
        return list(field_quantities(kind).values())
    row, *_ = get_args(kind)
    return [*row.__metadata__] * num_rows


@functools.cache
def field_quantities(kind: Any) -> dict[str, Quantity]:
    """Return the quantities of the fields of a record, by name; fields of other kinds are left out."""
    hints = get_type_hints(kind, include_extras=True).items()
    extras = ((name, extra) for name, hint in hints for extra in getattr(hint, "__metadata__", ()))
    return {name: extra for name, extra in extras if isinstance(extra, Quantity)}
