"""From a commanded acceleration to thrust and attitude: eq (7), at any yaw and within limits."""

from typing import Any, NamedTuple

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, maximum, minimum, sin_cos, sqrt
from drake_quad.flatness import angular_accelerations, attitude_of, body_rates, in_heading, tilt_of
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system

# Keeps 0 / 0 away where no horizontal force is commanded or allowed, and infinite derivatives of its square root.
_TINY = 1e-100


class ThrustLimits(NamedTuple):
    """What thrust vectoring may command.

    Attributes:
        slope: tangent of the largest angle between thrust and vertical.
        min_thrust: least vertical thrust, N: it keeps u_z + g well above zero, where eq (7) loses its meaning.
        max_thrust: largest thrust, N.
    """

    slope: Row
    min_thrust: Row
    max_thrust: Row


@formula
def specific_thrust(acceleration: Rows, mass: Row, gravity: Row, limits: ThrustLimits) -> tuple[Row, Row, Row]:
    """Returns the commanded thrust over mass (m/s²) within limits.

    The vertical part is limited first; then the horizontal part is shortened, in its direction, to what the slope
    and the remaining thrust allow.

    Args:
        acceleration: commanded, forward, left and up, m/s².
        mass: kg.
        gravity: m/s².
        limits: of thrust and tilt.
    """
    forward, left, u_z = acceleration
    low, high = limits.min_thrust / mass, limits.max_thrust / mass
    up = minimum(maximum(u_z + gravity, low), high)
    # Not a difference of squares: the compiler rounds only one of them, which may leave less than nothing.
    reach = maximum(minimum(up * up * limits.slope * limits.slope, (high - up) * (high + up)), _TINY)
    share = sqrt(reach / maximum(forward * forward + left * left, reach))
    return share * forward, share * left, up


@formula
def vectored_thrust(
    command: Rows, measurement: Rows, reference: Rows, jerk: Rows, snap: Rows, parameters: Rows, with_snap: float
) -> tuple[Rows, Rows, Rows, Rows]:
    """Thrust (N), attitude (rad), body rates (rad/s) and angular accelerations (rad/s²) for an acceleration.

    Args:
        command: the acceleration, 3 rows in W, m/s².
        measurement: 12 rows, as the vehicle's state.
        reference: 11 rows.
        jerk: of the reference, 3 rows, m/s³.
        snap: of the reference (3 rows, m/s⁴) and the acceleration of its yaw (rad/s²).
        parameters: of a `ThrustVectoring`, 5 rows.
        with_snap: 0 if there shall be no angular acceleration.
    """
    mass, gravity, slope, min_thrust, max_thrust = parameters
    sin_yaw, cos_yaw = sin_cos(measurement[5])
    limits = ThrustLimits(slope, min_thrust, max_thrust)
    tilt = tilt_of(specific_thrust(in_heading(command, sin_yaw, cos_yaw), mass, gravity, limits))
    turned_jerk, turned_snap = in_heading(jerk, sin_yaw, cos_yaw), in_heading(snap[0:3], sin_yaw, cos_yaw)
    rates = body_rates(tilt, turned_jerk, reference[10])
    a_x, a_y, a_z = angular_accelerations(tilt, rates, turned_jerk, turned_snap, reference[10], snap[3])
    roll, pitch = attitude_of(tilt)
    return (
        (mass * tilt.thrust,),
        (roll, pitch, reference[9]),
        rates,
        (with_snap * a_x, with_snap * a_y, with_snap * a_z),
    )


@fleet_system(float, AutoDiffXd)
class ThrustVectoring(FleetSystem):
    """Thrust and attitude for a commanded acceleration, eq (7).

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

    `acceleration_command` (3 rows, m/s²) is turned by minus the measured yaw in `measurement` (12), so that eq (7),
    written for zero yaw, holds at any. The output packs `thrust`, F_z (N); `attitude_command`, φ_r, θ_r, ψ_r (rad);
    `body_rate_command` (rad/s) and `angular_acceleration_command` (rad/s²), p, q, r and their rates. These are what
    keeps the thrust on its way (`drake_quad.flatness`) under `reference_jerk` (3, m/s³) and `reference_snap` (4: snap,
    m/s⁴, and the yaw's acceleration, rad/s²), with yaw and its rate as in `reference` (11). Without a jerk the thrust
    is taken to stay as it is; without a snap there is no angular acceleration.

    One numeric parameter of the context: mass, gravity and the three rows of the limits.

    Args:
        num_vehicles: N.
        mass: believed, kg.
        gravity: m/s².
        limits: of thrust and tilt.
    """

    def declare(self, *, num_vehicles: int = 1, mass: Row, gravity: Row, limits: ThrustLimits) -> None:
        """Declares the system; see the class for the arguments."""
        self._parameters = self.numeric_parameter([mass, gravity, *limits])
        self._command = self.input("acceleration_command", 3)
        self._measurement = self.input("measurement", 12)
        self._reference = self.input("reference", 11)
        self._jerk = self.input("reference_jerk", 3)
        self._snap = self.input("reference_snap", 4)
        self._vector = self.mapped(vectored_thrust, inputs=(3, 12, 11, 3, 4, 5), outputs=(1, 3, 3, 3))
        uses = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        parts = {"thrust": 1, "attitude_command": 3, "body_rate_command": 3, "angular_acceleration_command": 3}
        self.packed_output("thrust_and_attitude", parts, self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        inputs = self.inputs(context, self._command, self._measurement, self._reference, self._jerk, self._snap)
        parameters = self.parameter(context, self._parameters)
        self._vector([output], [*inputs, parameters], 0.0 if inputs[-1] is None else 1.0)
