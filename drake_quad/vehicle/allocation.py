"""From a commanded wrench to rotor speeds: the inverse of eq (5) within the rotors' limits."""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import maximum, minimum, sqrt
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Quantity, RotorRate, RotorSpeed, Row, Wrench
from drake_quad.vehicle.parameters import QuadrotorParameters

# Keeps 0 / 0 away where there is neither room nor demand; no squared rotor speed is as small.
_TINY = 1e-100


class RotorModel(NamedTuple):
    """What the autopilot believes of the rotors, all four alike.

    Attributes:
        thrust_factor: b.
        drag_factor: d.
        arm_length: l.
        min_speed: idle.
        max_speed: the largest.
    """

    thrust_factor: Annotated[Row, Quantity("N s²")]
    drag_factor: Annotated[Row, Quantity("N m s²")]
    arm_length: Annotated[Row, Quantity("m")]
    min_speed: RotorRate
    max_speed: RotorRate

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


class Allocated(NamedTuple):
    """What comes of a wrench.

    Attributes:
        rotor_speed_command: the rotor speeds that give it, or the part of it that the rotors can give.
        shortfall: the part that is given up, exactly zero where nothing is.
    """

    rotor_speed_command: RotorSpeed
    shortfall: Wrench


def allocate(wrench: Wrench, rotors: RotorModel) -> Allocated:
    """The rotor speeds for a wrench, or for the part of it that the rotors can give, and what is given up.

    Where they cannot give all, yaw torque is given up first, then roll and pitch torque in equal shares, and thrust
    last. In squared rotor speeds, with the thrust's `level`, the `room` above and below it, and the sizes of what
    the torques ask for, the rotors are at

        1, 3: level ∓ pitch + yaw        2, 4: level ∓ roll - yaw

    so roll and pitch leave yaw an interval, and their share is the largest for which that interval still holds a
    yaw between none and the one that is wanted.
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
    return Allocated(
        RotorSpeed(
            sqrt(maximum(level - pitch + yaw, low)),
            sqrt(maximum(level - roll - yaw, low)),
            sqrt(maximum(level + pitch + yaw, low)),
            sqrt(maximum(level + roll - yaw, low)),
        ),
        Wrench(4.0 * b * (wanted_level - level), given_up * tau_x, given_up * tau_y, 4.0 * d * (wanted_yaw - yaw)),
    )


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

    The output packs the two signals of `Allocated`: `rotor_speed_command`, the inverse of eq (5) within the rotors'
    limits, and `shortfall`, what was given up of the `wrench` for that.

    The only parameter of the context is `rotors`.

    Args:
        num_vehicles: N.
        numbers: what the autopilot believes of the rotors.
    """

    def declare(self, *, numbers: RotorModel = RotorModel.of(QuadrotorParameters())) -> None:
        """Declares the system."""
        wrench, rotors = self.input("wrench"), self.parameter("rotors", lambda rotors: rotors)
        self.packed_output("rotor_speed_command_and_shortfall", Allocated, allocate, wrench, rotors)
