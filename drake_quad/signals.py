"""Signal types of the control loop, with the name, unit and frame of each component.

The Z axis of the world frame W points up. The axes of the body frame B point forward (x), to the left (y) and up (z).
A positive yaw turns from X towards Y.
"""

import functools
import re
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_type_hints

Row = float
"""Type of one number per vehicle.

A row is a float for one vehicle and an array for a fleet. Drake and the compiler replace it with types of their own,
see `drake_quad.framework.elementary`. Type checkers see only the float, so they check formulas for a single vehicle.
"""


class Quantity(NamedTuple):
    """Physical quantity of a signal component: its unit, frame and allowed sign.

    Attributes:
        unit: SI unit.
        frame: frame in which the component is expressed, W or B; empty for a component without a direction.
        sign: sign required of a parameter with this quantity; empty if any sign is allowed.
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
    """Position, attitude, velocity and body rates of the vehicle, either true or measured."""

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
    """Acceleration of the origin of B, and angular acceleration of the body."""

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


class BatteryLoad(NamedTuple):
    """Terminal voltage and current of the battery."""

    voltage: Annotated[Row, Quantity("V")]
    current: Annotated[Row, Quantity("A")]


class Swing(NamedTuple):
    """Angles and angular rates of a slung load's cable, which is rotated by pitch about Y, then by roll about X."""

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
    """Desired position, velocity, acceleration, yaw and yaw rate of the vehicle."""

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
    """Third time derivative of the reference position."""

    x: JerkW
    y: JerkW
    z: JerkW


class Snap(NamedTuple):
    """Fourth time derivative of the reference position, and second time derivative of the reference yaw."""

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
    """Commanded acceleration, one term of the command, or the estimated acceleration due to disturbances."""

    x: AccelerationW
    y: AccelerationW
    z: AccelerationW


class Thrust(NamedTuple):
    """Thrust F_z along the z axis of the body."""

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
    """Angular velocity about the axes of the body."""

    p: BodyRateB
    q: BodyRateB
    r: BodyRateB


class AttitudeTarget(NamedTuple):
    """Command to an autopilot: thrust F_z and attitude, with body rates as feed-forward."""

    thrust: ForceB
    roll: Angle
    pitch: Angle
    yaw: Angle
    p: BodyRateB
    q: BodyRateB
    r: BodyRateB


class AngularAcceleration(NamedTuple):
    """Angular acceleration about the axes of the body."""

    p: BodyAccelerationB
    q: BodyAccelerationB
    r: BodyAccelerationB


class EstimateDeviation(NamedTuple):
    """Standard deviations of the errors of an estimated state, and of the estimated biases of the inertial sensors.

    The error of the attitude is a rotation about the axes of W.
    """

    x: PositionW
    y: PositionW
    z: PositionW
    v_x: VelocityW
    v_y: VelocityW
    v_z: VelocityW
    rotation_x: Annotated[Row, Quantity("rad", "W")]
    rotation_y: Annotated[Row, Quantity("rad", "W")]
    rotation_z: Annotated[Row, Quantity("rad", "W")]
    gyroscope_x: BodyRateB
    gyroscope_y: BodyRateB
    gyroscope_z: BodyRateB
    accelerometer_x: AccelerationB
    accelerometer_y: AccelerationB
    accelerometer_z: AccelerationB


class Crashed(NamedTuple):
    """Crash indicator: 1 if the vehicle has crashed, else 0."""

    crashed: Number


class CrashTime(NamedTuple):
    """Time of the crash; infinite if the vehicle has not crashed."""

    crash_time: Time


class Valid(NamedTuple):
    """Validity of a measurement: 1 if it is new, 0 if it is missing and the previous measurement is repeated."""

    valid: Number


# Signals of a fuzzy neural network have one component per rule, per axis, or per parameter of a membership function.
# Rules are ordered by axis: all rules of the first axis precede all rules of the second.
Firing = tuple[Number, ...]
Weights = tuple[AccelerationW, ...]
CovarianceTrace = tuple[Gain, ...]
Antecedents = tuple[Number, ...]
# Signals of a policy have one component per observed value or per action.
Observation = tuple[Number, ...]
Action = tuple[Number, ...]
# Normalised innovations of the scalar measurements of a Kalman filter.
Innovation = tuple[Number, ...]
# The future reference has three components (X, Y and Z) per future time.
FutureReference = tuple[PositionW, ...]


class Signals(dict[str, Any]):
    """Signal types by port name.

    Registering a sensor adds the type of its measurements. Ports of the second and later sensors of the same type are
    numbered, as in `accelerometer_2`.
    """

    def __contains__(self, name: object) -> bool:
        """Return whether a signal has this name; the name may end with a sensor number, as in `accelerometer_2`."""
        return super().__contains__(name) or super().__contains__(without_number(name))

    def __missing__(self, name: str) -> Any:
        """Return the type of a signal whose name ends with a sensor number, as in `accelerometer_2`."""
        if name not in self:
            raise KeyError(name)
        return self[without_number(name)]


def sensor_port_name(kind: str, number: int) -> str:
    """Return the port name of the n-th sensor of a type: `accelerometer`, `accelerometer_2`, and so on."""
    return kind if number == 1 else f"{kind}_{number}"


def valid_signal(name: str) -> str:
    """Return the port name of a sensor's validity: `gnss_valid` for `gnss`, `gnss_valid_2` for `gnss_2`, and so on."""
    kind = without_number(name)
    return f"{kind}_valid{name.removeprefix(kind)}"


def without_number(name: object) -> str:
    """Return the name of a sensor signal without the number of the sensor: `gnss_valid` for `gnss_valid_2`."""
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
    "battery": BatteryLoad,
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
    "estimate_deviation": EstimateDeviation,
    "innovation": Innovation,
    "crashed": Crashed,
    "crash_time": CrashTime,
    "firing": Firing,
    "firing_ahead": Firing,
    "weights": Weights,
    "covariance_trace": CovarianceTrace,
    "antecedents": Antecedents,
    "observation": Observation,
    "action": Action,
    "reference_ahead": FutureReference,
}


def row_names(name: str, num_rows: int) -> list[str]:
    """Return the names of the components of a signal; components without names are numbered from 1.

    Args:
        name: name of the signal.
        num_rows: number of components of the signal for one vehicle.
    """
    kind = SIGNALS[name]
    return list(kind._fields) if hasattr(kind, "_fields") else [str(number + 1) for number in range(num_rows)]


def quantities(name: str, num_rows: int) -> list[Quantity]:
    """Return the quantity of each of the `num_rows` components of a signal."""
    kind = SIGNALS[name]
    if hasattr(kind, "_fields"):
        return list(field_quantities(kind).values())
    row, *_ = get_args(kind)
    return [*row.__metadata__] * num_rows


@functools.cache
def field_quantities(kind: Any) -> dict[str, Quantity]:
    """Return the quantities of the fields of a record type by name; fields without a quantity are left out."""
    hints = get_type_hints(kind, include_extras=True).items()
    extras = ((name, extra) for name, hint in hints for extra in getattr(hint, "__metadata__", ()))
    return {name: extra for name, extra in extras if isinstance(extra, Quantity)}
