"""The inner loop: from the attitude error to torques."""

from typing import Any

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, wrapped
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system


@formula
def attitude_law(
    measurement: Rows, attitude: Rows, rates: Rows, accelerations: Rows, parameters: Rows
) -> tuple[tuple[Row, Row, Row]]:
    """The torque of an `AttitudeController`, N m.

    Args:
        measurement: 12 rows, as the vehicle's state.
        attitude: commanded roll, pitch and yaw, rad.
        rates: commanded p, q, r, rad/s.
        accelerations: commanded rates of p, q, r, rad/s².
        parameters: k_P, k_D and the moments of inertia, 9 rows.
    """
    p_roll, p_pitch, p_yaw, d_roll, d_pitch, d_yaw, i_xx, i_yy, i_zz = parameters
    roll, pitch, yaw = measurement[3:6]
    p, q, r = measurement[9:12]
    roll_r, pitch_r, yaw_r = attitude
    p_r, q_r, r_r = rates
    a_x, a_y, a_z = accelerations
    torque = (
        i_xx * (p_roll * (roll_r - roll) + d_roll * (p_r - p) + a_x) + (i_zz - i_yy) * q_r * r_r,
        i_yy * (p_pitch * (pitch_r - pitch) + d_pitch * (q_r - q) + a_y) + (i_xx - i_zz) * p_r * r_r,
        i_zz * (p_yaw * wrapped(yaw_r - yaw) + d_yaw * (r_r - r) + a_z) + (i_yy - i_xx) * p_r * q_r,
    )
    return (torque,)


@fleet_system(float, AutoDiffXd)
class AttitudeController(FleetSystem):
    """PD on roll, pitch and yaw with feed-forward: τ = I (k_P e + k_D ė + ω̇_r) + ω_r × I ω_r in B.

    .. pydrake_system::

        name: AttitudeController
        input_ports:
        - measurement
        - attitude_command
        - body_rate_command
        - angular_acceleration_command
        output_ports:
        - torque

    e is `attitude_command` (3 rows, rad) minus roll, pitch, yaw of `measurement` (12), the yaw error wrapped to half
    a turn; ė is `body_rate_command` ω_r (3, rad/s) minus p, q, r; ω̇_r is `angular_acceleration_command` (3, rad/s²),
    zero if not connected.
    `torque` (3, N m) is scaled by the moments of inertia, so that the gains are those of a double integrator.

    One numeric parameter of the context: k_P and k_D of the three axes, then I_xx, I_yy, I_zz.

    Args:
        num_vehicles: N.
        k_p: 3 rows, 1/s².
        k_d: 3 rows, 1/s.
        inertia: believed, 3 rows, kg m².
    """

    def declare(self, *, num_vehicles: int = 1, k_p: Rows, k_d: Rows, inertia: Rows) -> None:
        """Declares the system; see the class for the arguments."""
        self._gains = self.numeric_parameter([*k_p, *k_d, *inertia])
        self._measurement = self.input("measurement", 12)
        self._attitude = self.input("attitude_command", 3)
        self._rates = self.input("body_rate_command", 3)
        self._acceleration = self.input("angular_acceleration_command", 3)
        self._law = self.mapped(attitude_law, inputs=(12, 3, 3, 3, 9), outputs=(3,))
        uses = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        self.output("torque", 3, self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        inputs = self.inputs(context, self._measurement, self._attitude, self._rates, self._acceleration)
        self._law([output], [*inputs, self.parameter(context, self._gains)])
