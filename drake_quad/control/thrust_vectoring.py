"""Thrust vectoring: thrust and attitude for an acceleration by the paper's eq (7), at any yaw and within limits.

Equation numbers refer to Kayacan and Maslim (2016), unless another paper is named.
"""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import maximum, minimum, sin_cos, sqrt
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.axes import BodyAxes
from drake_quad.geometry.flatness import (
    EulerSequence,
    HeadingVector,
    ThrustTilt,
    acceleration_from_quarter_turn,
    angular_accelerations,
    attitude_from_quarter_turn,
    attitude_from_tilt,
    body_rates,
    in_heading,
    rates_from_quarter_turn,
    tilt_from_thrust,
)
from drake_quad.signals import (
    Acceleration,
    AngularAcceleration,
    Attitude,
    BodyRates,
    ForceB,
    Jerk,
    Number,
    Quantity,
    Reference,
    Row,
    Snap,
    State,
    Thrust,
)

# Lower limit on a squared horizontal acceleration, m²/s⁴. It avoids 0 / 0, and an infinite derivative of the square
# root, at zero.
_MIN_SQUARED_ACCELERATION = 1e-100


class ThrustLimits(NamedTuple):
    """Limits of the commanded thrust.

    Attributes:
        tan_max_tilt: tangent of the largest angle between thrust and vertical.
        min_thrust: smallest vertical thrust. It keeps u_z + g well above zero, where eq (7) of the paper is singular.
        max_thrust: largest thrust.
    """

    tan_max_tilt: Number
    min_thrust: ForceB
    max_thrust: ForceB


class VectoringParameters(NamedTuple):
    """Parameters of the nominal vehicle, and limits.

    Attributes:
        mass: mass of the nominal vehicle.
        gravity: g of the nominal model.
        limits: limits of thrust and tilt.
    """

    mass: Annotated[Row, Quantity("kg")]
    gravity: Annotated[Row, Quantity("m/s²")]
    limits: ThrustLimits


class VectoringOutput(NamedTuple):
    """Commands that produce a commanded acceleration.

    Attributes:
        thrust: thrust F_z.
        attitude_command: commanded roll φ_r, pitch θ_r and yaw ψ_r.
        body_rate_command: body rates that produce the jerk and the yaw rate of the reference.
        angular_acceleration_command: time derivatives of these body rates.
    """

    thrust: Thrust
    attitude_command: Attitude
    body_rate_command: BodyRates
    angular_acceleration_command: AngularAcceleration


def specific_thrust(acceleration: HeadingVector, mass: Row, gravity: Row, limits: ThrustLimits) -> HeadingVector:
    """Return the commanded thrust divided by mass (m/s²), within limits.

    The vertical component is limited first. The horizontal component is then limited, without changing its direction,
    such that the tilt and the total thrust are within their limits.

    Args:
        acceleration: commanded acceleration, m/s².
        mass: mass, kg.
        gravity: g, m/s².
        limits: limits of thrust and tilt.
    """
    forward, left, u_z = acceleration
    low, high = limits.min_thrust / mass, limits.max_thrust / mass
    up = minimum(maximum(u_z + gravity, low), high)
    max_horizontal_squared = maximum(
        minimum(up * up * limits.tan_max_tilt * limits.tan_max_tilt, (high - up) * (high + up)),
        _MIN_SQUARED_ACCELERATION,
    )
    fraction = sqrt(max_horizontal_squared / maximum(forward * forward + left * left, max_horizontal_squared))
    return HeadingVector(fraction * forward, fraction * left, up)


def vectored_thrust(
    command: Acceleration,
    measurement: State,
    reference: Reference,
    jerk: Jerk,
    snap: Snap | None,
    parameters: VectoringParameters,
    projects: bool = False,
    sequence: EulerSequence = "zyx",
) -> VectoringOutput:
    """Return thrust, attitude, body rates and angular accelerations for a commanded acceleration.

    Args:
        command: commanded acceleration in W.
        measurement: measured state of the vehicle.
        reference: reference with the commanded yaw.
        jerk: jerk of the reference.
        snap: snap of the reference; None for zero angular accelerations.
        parameters: parameters of the nominal vehicle, and limits.
        projects: True if the commanded force is projected on the measured thrust axis.
        sequence: Euler sequence that defines the yaw of a tilted body, see `drake_quad.geometry.flatness`; "zxy"
            requires `projects`.
    """
    mass, gravity, limits = parameters
    sin_yaw, cos_yaw = sin_cos(reference.yaw if projects else measurement.yaw)
    if sequence == "zxy":
        # The sequence zxy is computed as zyx with a yaw that is larger by π/2, see `drake_quad.geometry.flatness`.
        sin_yaw, cos_yaw = cos_yaw, -sin_yaw
    tilt = tilt_from_thrust(specific_thrust(in_heading(command, sin_yaw, cos_yaw), mass, gravity, limits))
    heading_jerk = in_heading(jerk, sin_yaw, cos_yaw)
    rates = body_rates(tilt, heading_jerk, reference.yaw_rate)
    attitude = Attitude(*attitude_from_tilt(tilt), reference.yaw)
    acceleration = AngularAcceleration(0.0, 0.0, 0.0)
    if snap is not None:
        heading_snap = in_heading(snap, sin_yaw, cos_yaw)
        acceleration = angular_accelerations(tilt, rates, heading_jerk, heading_snap, reference.yaw_rate, snap.yaw)
    thrust = mass * tilt.thrust
    if projects:
        thrust = maximum(thrust * _alignment(tilt, measurement, sin_yaw, cos_yaw), limits.min_thrust)
    if sequence == "zxy":
        attitude = attitude_from_quarter_turn(tilt, reference.yaw)
        rates, acceleration = rates_from_quarter_turn(rates), acceleration_from_quarter_turn(acceleration)
    return VectoringOutput(Thrust(thrust), attitude, rates, acceleration)


def _alignment(tilt: ThrustTilt, measurement: State, sin_yaw: Row, cos_yaw: Row) -> Row:
    """Return the cosine of the angle between the commanded and the measured thrust axis, given the commanded yaw."""
    measured = BodyAxes.of(measurement.roll, measurement.pitch, measurement.yaw).z
    forward, left, up = in_heading(measured, sin_yaw, cos_yaw)
    return (forward * tilt.sin_pitch + up * tilt.cos_pitch) * tilt.cos_roll - left * tilt.sin_roll


@fleet_system(float, AutoDiffXd)
class ThrustVectoring(FleetSystem):
    """Thrust and attitude for a commanded acceleration, eq (7) of the paper.

    .. pydrake_system::

        name: ThrustVectoring
        input_ports:
        - acceleration_command
        - measurement
        - reference
        - reference_jerk
        - reference_snap
        output_ports:
        - thrust_and_attitude

    Eq (7) is written for zero yaw, so `acceleration_command` is rotated by minus the measured yaw. The output contains
    all signals of `VectoringOutput`. Body rates and angular accelerations are computed from `reference_jerk`,
    `reference_snap`, and the yaw and yaw rate in `reference`, by differential flatness
    (`drake_quad.geometry.flatness`). If `reference_jerk` is not connected, the thrust vector is assumed to be constant.
    If `reference_snap` is not connected, the angular accelerations are zero.

    `projects` is meant for geometric control, which also works when the vehicle is upside down. With `projects`, eq (7)
    uses the commanded yaw, and the thrust is the component of the commanded force along the measured thrust axis,
    F_d · R e₃ (T. Lee, M. Leok and N. H. McClamroch, 2010, eq (15)). It is at least the minimum thrust, because rotors
    without thrust cannot rotate the vehicle. The yaw may then be defined by the sequence zxy, as in the same paper,
    instead of zyx, eq (1). `attitude_command` contains the angles of eq (1) in either case. With zxy its yaw therefore
    differs from the yaw of the reference unless roll or pitch is zero.

    The only parameter of the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        projects: True if the commanded force is projected on the measured thrust axis.
        sequence: Euler sequence of the yaw, see `drake_quad.geometry.flatness`; "zxy" requires `projects`.
        parameters: parameters of the nominal vehicle, and limits of thrust and tilt.
    """

    def declare(
        self, *, projects: bool = False, sequence: EulerSequence = "zyx", parameters: VectoringParameters
    ) -> None:
        """Declare the ports and parameters of this system."""
        parameter = self.parameter("parameters", lambda parameters: parameters)
        command, measurement = self.input("acceleration_command"), self.input("measurement")
        reference = self.input("reference")
        jerk, snap = self.input("reference_jerk", absent=Jerk(0.0, 0.0, 0.0)), self.input("reference_snap", absent=None)
        reads = command, measurement, reference, jerk, snap, parameter, projects, sequence
        self.packed_output("thrust_and_attitude", VectoringOutput, vectored_thrust, *reads)
