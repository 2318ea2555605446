"""From a commanded acceleration to thrust and attitude: eq (7), at any yaw and within limits."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from drake_quad.elementary import Row, arcsin, arctan, cos, maximum, minimum, sin, sqrt
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


def specific_thrust(
    acceleration: Sequence[Row], yaw: Row, *, mass: Row, gravity: Row, limits: ThrustLimits
) -> tuple[Row, Row, Row]:
    """Returns the commanded thrust over mass (m/s²): its parts forward, left (both level) and up.

    The vertical part is limited first; then the horizontal part is shortened, in its direction, to what the slope
    and the remaining thrust allow.

    Args:
        acceleration: commanded, 3 rows in W, m/s².
        yaw: measured, rad.
        mass: kg.
        gravity: m/s².
        limits: of thrust and tilt.
    """
    u_x, u_y, u_z = acceleration
    low, high = limits.min_thrust / mass, limits.max_thrust / mass
    up = minimum(maximum(u_z + gravity, low), high)
    reach = minimum(up * up * limits.slope * limits.slope, high * high - up * up)
    share = sqrt(reach / maximum(u_x * u_x + u_y * u_y, maximum(reach, _TINY)))
    sin_yaw, cos_yaw = sin(yaw), cos(yaw)
    return share * (u_x * cos_yaw + u_y * sin_yaw), share * (u_y * cos_yaw - u_x * sin_yaw), up


def thrust_and_tilt(forward: Row, left: Row, up: Row) -> tuple[Row, Row, Row]:
    """Eq (7) per unit of mass: thrust (m/s²), roll and pitch (rad) that make a specific thrust (m/s²)."""
    thrust = sqrt(forward * forward + left * left + up * up)
    return thrust, arcsin(-left / thrust), arctan(forward / up)


def tilt_rates(
    force: Sequence[Row], jerk: Sequence[Row], yaw: Row, yaw_rate: Row
) -> tuple[Row, Row]:
    """The time derivative of roll and pitch in eq (7), rad/s.

    Args:
        force: specific thrust forward, left, up, m/s².
        jerk: rate of the commanded acceleration, 3 rows in W, m/s³.
        yaw: rad.
        yaw_rate: rad/s.
    """
    forward, left, up = force
    j_x, j_y, up_rate = jerk
    sin_yaw, cos_yaw = sin(yaw), cos(yaw)
    forward_rate = j_x * cos_yaw + j_y * sin_yaw + yaw_rate * left
    left_rate = j_y * cos_yaw - j_x * sin_yaw - yaw_rate * forward
    sagittal = forward * forward + up * up
    along = forward * forward_rate + up * up_rate
    roll_rate = (left * along - left_rate * sagittal) / (sqrt(sagittal) * (sagittal + left * left))
    return roll_rate, (forward_rate * up - forward * up_rate) / sagittal


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
    written for zero yaw, holds at any. `thrust_and_attitude` has 7 rows: F_z (N); φ_r, θ_r, ψ_r (rad); their rates
    (rad/s). Yaw and its rate are those of `reference` (11). The rates of roll and pitch are those of eq (7) under
    `reference_jerk` (3, m/s³); not connected they are zero.

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
        self.output("thrust_and_attitude", 7, self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        mass, gravity, *limits = self.parameter_rows(context, self._parameters)
        yaw = self.input_rows(context, self._measurement)[5]
        yaw_reference, yaw_rate = self.input_rows(context, self._reference)[9:11]
        command = self.input_rows(context, self._command)
        force = specific_thrust(command, yaw, mass=mass, gravity=gravity, limits=ThrustLimits(*limits))
        thrust, roll, pitch = thrust_and_tilt(*force)
        jerk = self.EvalVectorInput(context, self._jerk.get_index())
        rates = (0.0, 0.0) if jerk is None else tilt_rates(force, self.rows(self.values(jerk)), yaw, yaw_rate)
        self.write(output, [mass * thrust, roll, pitch, yaw_reference, *rates, yaw_rate])
