"""From a commanded acceleration to thrust and attitude: eq (7), at any yaw and within limits."""

from typing import Any, NamedTuple

from drake_quad.elementary import Row, Rows, arcsin, arctan, maximum, minimum, sin_cos, sqrt
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system

# Keeps 0 / 0 away where neither a horizontal force is commanded nor one is allowed.
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


def in_heading(vector: Rows, sin_yaw: Row, cos_yaw: Row) -> tuple[Row, Row, Row]:
    """Turns a vector in W by minus the yaw: its parts forward, left (both level) and up."""
    x, y, z = vector
    return x * cos_yaw + y * sin_yaw, y * cos_yaw - x * sin_yaw, z


def specific_thrust(acceleration: Rows, *, mass: Row, gravity: Row, limits: ThrustLimits) -> tuple[Row, Row, Row]:
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
    up_squared = up * up
    reach = minimum(up_squared * limits.slope * limits.slope, high * high - up_squared)
    share = sqrt(reach / maximum(forward * forward + left * left, maximum(reach, _TINY)))
    return share * forward, share * left, up


def thrust_and_tilt(forward: Row, left: Row, up: Row) -> tuple[Row, Row, Row]:
    """Eq (7) per unit of mass: thrust (m/s²), roll and pitch (rad) that make a specific thrust (m/s²)."""
    thrust = sqrt(forward * forward + left * left + up * up)
    return thrust, arcsin(-left / thrust), arctan(forward / up)


def tilt_rates(force: Rows, jerk: Rows, yaw_rate: Row) -> tuple[Row, Row]:
    """The time derivative of roll and pitch in eq (7), rad/s.

    Args:
        force: specific thrust forward, left and up, m/s².
        jerk: rate of the commanded acceleration, its parts forward, left and up, m/s³.
        yaw_rate: at which the heading turns, rad/s.
    """
    forward, left, up = force
    forward_rate = jerk[0] + yaw_rate * left
    left_rate = jerk[1] - yaw_rate * forward
    up_rate = jerk[2]
    sagittal = forward * forward + up * up
    along = forward * forward_rate + up * up_rate
    roll_rate = (left * along - left_rate * sagittal) / (sqrt(sagittal) * (sagittal + left * left))
    return roll_rate, (forward_rate * up - forward * up_rate) / sagittal


def body_rates(force: Rows, roll_rate: Row, pitch_rate: Row, yaw_rate: Row) -> tuple[Row, Row, Row]:
    """Eq (2) at the attitude of eq (7): p, q, r (rad/s).

    Args:
        force: specific thrust forward, left and up, m/s².
        roll_rate: rad/s.
        pitch_rate: rad/s.
        yaw_rate: rad/s.
    """
    forward, left, up = force
    sagittal = sqrt(forward * forward + up * up)
    thrust = sqrt(sagittal * sagittal + left * left)
    sin_roll, cos_roll = -left / thrust, sagittal / thrust
    turning = up / sagittal * yaw_rate
    return (
        roll_rate - forward / sagittal * yaw_rate,
        cos_roll * pitch_rate + sin_roll * turning,
        cos_roll * turning - sin_roll * pitch_rate,
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
        output_ports:
        - thrust_and_attitude

    `acceleration_command` (3 rows, m/s²) is turned by minus the measured yaw in `measurement` (12), so that eq (7),
    written for zero yaw, holds at any. The output packs `thrust`, F_z (N); `attitude_command`, φ_r, θ_r, ψ_r (rad);
    and `body_rate_command`, p, q and r (rad/s) at the rates of these angles, eq (2). Yaw and its rate are those of
    `reference` (11); the rates of roll and pitch are those of eq (7) under `reference_jerk` (3, m/s³), or zero if it
    is not connected.

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
        uses = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        parts = {"thrust": 1, "attitude_command": 3, "body_rate_command": 3}
        self.packed_output("thrust_and_attitude", parts, self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        mass, gravity, *limits = self.parameter_rows(context, self._parameters)
        (sin_yaw,), (cos_yaw,) = sin_cos(self.input_rows(context, self._measurement)[5:6])
        yaw_reference, yaw_rate = self.input_rows(context, self._reference)[9:11]
        command = self.input_rows(context, self._command)
        jerk = self.optional_input_rows(context, self._jerk, default=None)
        force = specific_thrust(
            in_heading(command, sin_yaw, cos_yaw), mass=mass, gravity=gravity, limits=ThrustLimits(*limits)
        )
        thrust, roll, pitch = thrust_and_tilt(*force)
        roll_rate, pitch_rate = 0.0, 0.0
        if jerk is not None:
            roll_rate, pitch_rate = tilt_rates(force, in_heading(jerk, sin_yaw, cos_yaw), yaw_rate)
        rates = body_rates(force, roll_rate, pitch_rate, yaw_rate)
        self.write(output, [mass * thrust, roll, pitch, yaw_reference, *rates])
