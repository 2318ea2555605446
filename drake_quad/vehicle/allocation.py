"""From a commanded wrench to rotor speeds: the inverse of eq (5) within the rotors' limits."""

from collections.abc import Sequence
from typing import Any

from drake_quad.elementary import Row, maximum, minimum, sqrt
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.vehicle.dynamics import rotor_wrench
from drake_quad.vehicle.parameters import QuadrotorParameters

# Keeps 0 / 0 away where there is neither room nor demand; no squared rotor speed is as small.
_TINY = 1e-100


def allocate(wrench: Sequence[Row], parameters: QuadrotorParameters) -> list[Row]:
    """Returns the rotor speeds (rad/s) for a wrench, or for the part of it that the rotors can give.

    Where they cannot give all, yaw torque is given up first, then roll and pitch torque, in equal shares, and
    thrust last: each is scaled down to what the rotor with the least room leaves.

    Args:
        wrench: F_z (N), τ_x, τ_y, τ_z (N m).
        parameters: the four thrust factors count with their mean.
    """
    thrust, tau_x, tau_y, tau_z = wrench
    b, d = sum(parameters.thrust_factor) / 4.0, parameters.drag_factor
    low, high = parameters.min_rotor_speed * parameters.min_rotor_speed, parameters.max_rotor_speed * parameters.max_rotor_speed
    lever = 2.0 * parameters.arm_length * b

    level = minimum(maximum(thrust / (4.0 * b), low), high)
    roll, pitch, yaw = tau_x / lever, tau_y / lever, tau_z / (4.0 * d)
    room = minimum(high - level, level - low)
    share = room / maximum(maximum(abs(roll), abs(pitch)), maximum(room, _TINY))
    roll, pitch = share * roll, share * pitch

    # Rotors 1 and 3 speed up for a positive yaw torque and carry the pitch torque; 2 and 4 slow down and carry roll.
    faster, slower = abs(pitch), abs(roll)
    room_up = minimum(high - level - faster, level - low - slower)
    room_down = minimum(level - low - faster, high - level - slower)
    yaw = minimum(maximum(yaw, -maximum(room_down, 0.0)), maximum(room_up, 0.0))
    squares = level - pitch + yaw, level - roll - yaw, level + pitch + yaw, level + roll - yaw
    return [sqrt(square) for square in squares]


@fleet_system(float, AutoDiffXd)
class Allocation(FleetSystem):
    """Rotor speeds for a commanded wrench, on board the vehicle.

    .. pydrake_system::

        name: Allocation
        input_ports:
        - wrench
        output_ports:
        - rotor_speed_command
        - shortfall

    `rotor_speed_command` (4 rows, rad/s) inverts eq (5) for `wrench` (4 rows: F_z in N; τ_x, τ_y, τ_z in N m) within
    the rotors' limits (see `allocate`). `shortfall` (4 rows) is what was given up: the commanded wrench minus the
    one that these rotor speeds make, zero to rounding when the rotors are within their limits.

    Args:
        num_vehicles: N.
        parameters: what the autopilot believes of the vehicle; a numeric parameter of the context.
    """

    def declare(
        self, *, num_vehicles: int = 1, parameters: QuadrotorParameters = QuadrotorParameters()
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self._parameters = self.numeric_parameter(parameters.to_rows())
        self._wrench = self.input("wrench", 4)
        uses = [self._wrench.ticket(), self.all_parameters_ticket()]
        self._command = self.output("rotor_speed_command", 4, self._calc_command, uses=uses)
        self.output("shortfall", 4, self._calc_shortfall, uses=uses)

    def _calc_command(self, context: Any, output: Any) -> None:
        self.write(output, allocate(self.input_rows(context, self._wrench), self._beliefs(context)))

    def _calc_shortfall(self, context: Any, output: Any) -> None:
        rotor_speed = self.rows(self._command.Eval(context))
        delivered = rotor_wrench(rotor_speed, self._beliefs(context))
        commanded = self.input_rows(context, self._wrench)
        self.write(output, [wanted - given for wanted, given in zip(commanded, delivered, strict=True)])

    def _beliefs(self, context: Any) -> QuadrotorParameters:
        return QuadrotorParameters.from_rows(self.parameter_rows(context, self._parameters))
