"""From a commanded wrench to rotor speeds: the inverse of eq (5) within the rotors' limits."""

from typing import Any, NamedTuple

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, maximum, minimum, sqrt
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.vehicle.parameters import QuadrotorParameters

# Keeps 0 / 0 away where there is neither room nor demand; no squared rotor speed is as small.
_TINY = 1e-100


class RotorModel(NamedTuple):
    """What the autopilot believes of the rotors, all four alike.

    Attributes:
        thrust_factor: b, N s².
        drag_factor: d, N m s².
        arm_length: l, m.
        min_speed: rad/s.
        max_speed: rad/s.
    """

    thrust_factor: Row
    drag_factor: Row
    arm_length: Row
    min_speed: Row
    max_speed: Row

    @classmethod
    def of(cls, parameters: QuadrotorParameters) -> "RotorModel":
        """The model of a vehicle, with the mean of its thrust factors."""
        return cls(
            sum(parameters.thrust_factor) / 4.0,
            parameters.drag_factor,
            parameters.arm_length,
            parameters.min_rotor_speed,
            parameters.max_rotor_speed,
        )


@formula
def allocate(wrench: Rows, rotors: Rows) -> tuple[Rows, Rows]:
    """Returns the rotor speeds for a wrench, or for the part of it that the rotors can give, and what is given up.

    Where they cannot give all, yaw torque is given up first, then roll and pitch torque in equal shares, and thrust
    last. In squared rotor speeds, with the thrust's `level`, the `room` above and below it, and the sizes of what
    the torques ask for, the rotors are at

        1, 3: level ∓ pitch + yaw        2, 4: level ∓ roll - yaw

    so roll and pitch leave yaw an interval, and their share is the largest for which that interval still holds a
    yaw between none and the one that is wanted.

    Args:
        wrench: F_z (N), τ_x, τ_y, τ_z (N m).
        rotors: a `RotorModel`, as believed, or its five rows.

    Returns:
        Four rotor speeds (rad/s), and the four parts of the wrench that are given up (N, N m): exactly zero where
        nothing is.
    """
    thrust, tau_x, tau_y, tau_z = wrench
    b, d, length, min_speed, max_speed = rotors
    low, high = min_speed * min_speed, max_speed * max_speed
    lever = 2.0 * length * b

    wanted_level, wanted_roll, wanted_pitch = thrust / (4.0 * b), tau_x / lever, tau_y / lever
    wanted_yaw = tau_z / (4.0 * d)
    level = minimum(maximum(wanted_level, low), high)
    share = _share_of_roll_and_pitch(level, abs(wanted_roll), abs(wanted_pitch), wanted_yaw, low, high)
    roll, pitch = share * wanted_roll, share * wanted_pitch
    across, along, above, below = abs(roll), abs(pitch), high - level, level - low
    least, most = maximum(along - below, across - above), minimum(above - along, below - across)
    yaw = maximum(minimum(wanted_yaw, most), least)
    given_up = 1.0 - share
    return (
        (
            sqrt(maximum(level - pitch + yaw, low)),
            sqrt(maximum(level - roll - yaw, low)),
            sqrt(maximum(level + pitch + yaw, low)),
            sqrt(maximum(level + roll - yaw, low)),
        ),
        (4.0 * b * (wanted_level - level), given_up * tau_x, given_up * tau_y, 4.0 * d * (wanted_yaw - yaw)),
    )


@formula
def _share_of_roll_and_pitch(level: Row, across: Row, along: Row, yaw: Row, low: Row, high: Row) -> Row:
    """The largest share, at most 1, of roll and pitch that leaves a yaw between none and the wanted one.

    Args:
        level: squared rotor speed of the thrust.
        across: size of what roll asks for.
        along: size of what pitch asks for.
        yaw: what yaw asks for.
        low: least squared rotor speed.
        high: largest.
    """
    above, below, half = high - level, level - low, 0.5 * (high - low)
    left, right = maximum(yaw, 0.0), minimum(yaw, 0.0)
    room_along = minimum(minimum(below + left, above - right), half)
    room_across = minimum(minimum(above + left, below - right), half)
    room_both = 2.0 * minimum(above, below)
    return minimum(minimum(_share(room_along, along), _share(room_across, across)), _share(room_both, along + across))


@formula
def _share(room: Row, demand: Row) -> Row:
    return room / maximum(demand, maximum(room, _TINY))


@fleet_system(float, AutoDiffXd)
class Allocation(FleetSystem):
    """Rotor speeds for a commanded wrench, on board the vehicle.

    .. pydrake_system::

        name: Allocation
        input_ports:
        - wrench
        output_ports:
        - rotor_speed_command_and_shortfall

    The output packs what `allocate` returns for `wrench` (4 rows: F_z in N; τ_x, τ_y, τ_z in N m):
    `rotor_speed_command` (4 rows, rad/s), the inverse of eq (5) within the rotors' limits, and `shortfall` (4 rows),
    what was given up of the wrench for that.

    The model of the rotors is one numeric parameter of the context, the five rows of `RotorModel`.

    Args:
        num_vehicles: N.
        rotors: what the autopilot believes of them.
    """

    def declare(self, *, num_vehicles: int = 1, rotors: RotorModel = RotorModel.of(QuadrotorParameters())) -> None:
        """Declares the system; see the class for the arguments."""
        self._rotors = self.numeric_parameter(rotors)
        self._wrench = self.input("wrench", 4)
        self._allocate = self.mapped(allocate, inputs=(4, 5), outputs=(4, 4))
        uses = [self.all_input_ports_ticket(), self.all_parameters_ticket()]
        parts = {"rotor_speed_command": 4, "shortfall": 4}
        self.packed_output("rotor_speed_command_and_shortfall", parts, self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        self._allocate([output], [self.EvalVectorInput(context, self._wrench), self.parameter(context, self._rotors)])
