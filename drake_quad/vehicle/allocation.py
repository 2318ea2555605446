"""From a commanded wrench to rotor speeds: the inverse of eq (5) within the rotors' limits.

Where the rotors cannot give all of a wrench, yaw torque is given up first, then roll and pitch torque in equal shares,
and thrust last:

- thrust is what is wanted, within what all rotors can give together without any torque;
- the share of roll and pitch torque in [0, 1] is the largest that leaves the rotors a yaw torque between none and the
  one that is wanted;
- the yaw torque is the one nearest to what is wanted that the rotors then have room for.
"""

from itertools import combinations
from typing import NamedTuple

from drake_quad.framework.elementary import maximum, minimum, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import RotorRate, RotorSpeed, Row, Wrench
from drake_quad.vehicle.mixer import Mixer, mixer_of
from drake_quad.vehicle.parameters import QuadrotorParameters

# Keeps 0 / 0 away where there is neither room nor demand; no room is as small.
_TINY = 1e-100
# Larger than any torque.
_ENDLESS = 1e100


class RotorModel(NamedTuple):
    """What the autopilot believes of the rotors.

    Attributes:
        mixer: from a wrench to squared speeds.
        min_speed: idle.
        max_speed: the largest.
    """

    mixer: Mixer
    min_speed: RotorRate
    max_speed: RotorRate

    @classmethod
    def of(cls, parameters: QuadrotorParameters) -> "RotorModel":
        """The model of a vehicle."""
        return cls(mixer_of(parameters), parameters.min_rotor_speed, parameters.max_rotor_speed)


class Allocated(NamedTuple):
    """What comes of a wrench.

    Attributes:
        rotor_speed_command: the rotor speeds that give it, or the part of it that the rotors can give.
        shortfall: the part that is given up, exactly zero where nothing is.
    """

    rotor_speed_command: RotorSpeed
    shortfall: Wrench


class _Demand(NamedTuple):
    """Of the squared speed of one rotor, what each part of a wrench takes.

    Attributes:
        level: the thrust that is given.
        tilt: the roll and pitch torque that are wanted.
        yaw: the yaw torque that is wanted.
        per_yaw: a yaw torque of 1 N m.
    """

    level: Row
    tilt: Row
    yaw: Row
    per_yaw: Row


def allocate(wrench: Wrench, rotors: RotorModel) -> Allocated:
    """The rotor speeds for a wrench, or for the part of it that the rotors can give, and what is given up.

    For any layout whose rotors all carry a part of the thrust in hover. The share of roll and pitch is the least of
    the bounds that rotors set, one by one with the yaw that helps most, and two by two, whatever the yaw: intervals
    of a line have a point in common if any two of them have.
    """
    thrust, tau_x, tau_y, tau_z = wrench
    mixer, min_speed, max_speed = rotors
    low, high = min_speed * min_speed, max_speed * max_speed

    least_thrust: Row = -_ENDLESS
    most_thrust: Row = _ENDLESS
    for row in mixer:
        least_thrust, most_thrust = maximum(low / row.thrust, least_thrust), minimum(high / row.thrust, most_thrust)
    given = minimum(maximum(thrust, least_thrust), most_thrust)
    demands = [
        _Demand(row.thrust * given, row.tau_x * tau_x + row.tau_y * tau_y, row.tau_z * tau_z, row.tau_z)
        for row in mixer
    ]
    share: Row = 1.0
    for demand in demands:
        share = minimum(_share_of_one(demand, low, high), share)
    for one, other in combinations(demands, 2):
        share = minimum(_share_of_two(one, other, low, high), share)

    bare = [demand.level + share * demand.tilt for demand in demands]
    least, most = -_ENDLESS, _ENDLESS
    for square, demand in zip(bare, demands, strict=True):
        down, up = _yaw_between(square, demand.per_yaw, low, high)
        least, most = maximum(down, least), minimum(up, most)
    yaw = maximum(minimum(tau_z, most), least)
    given_up = 1.0 - share
    speeds = [
        sqrt(minimum(maximum(square + demand.per_yaw * yaw, low), high))
        for square, demand in zip(bare, demands, strict=True)
    ]
    return Allocated(RotorSpeed._make(speeds), Wrench(thrust - given, given_up * tau_x, given_up * tau_y, tau_z - yaw))


def _share_of_one(demand: _Demand, low: Row, high: Row) -> Row:
    """The largest share of roll and pitch for which a rotor has room with some yaw between none and the wanted one."""
    above = high - demand.level - minimum(demand.yaw, 0.0)
    below = demand.level - low + maximum(demand.yaw, 0.0)
    return _share(maximum(where(demand.tilt > 0.0, above, below), 0.0), abs(demand.tilt))


def _share_of_two(one: _Demand, other: _Demand, low: Row, high: Row) -> Row:
    """The largest share of roll and pitch for which two rotors have room with the same yaw, whatever it is.

    The difference of their squared speeds, each times what yaw takes of the other, does not depend on the yaw.
    """
    of_one, of_other = other.per_yaw, -one.per_yaw
    level = of_one * one.level + of_other * other.level
    tilt = of_one * one.tilt + of_other * other.tilt
    up = maximum(of_one, 0.0) + maximum(of_other, 0.0)
    down = minimum(of_one, 0.0) + minimum(of_other, 0.0)
    above, below = up * high + down * low - level, level - (up * low + down * high)
    return _share(maximum(where(tilt > 0.0, above, below), 0.0), abs(tilt))


def _yaw_between(square: Row, per_yaw: Row, low: Row, high: Row) -> tuple[Row, Row]:
    """The yaw torques between which a rotor has room beside a squared speed; endless if yaw takes nothing of it."""
    rising, nothing = per_yaw > 0.0, per_yaw == 0.0
    inverse = 1.0 / where(nothing, 1.0, per_yaw)
    down, up = (where(rising, low, high) - square) * inverse, (where(rising, high, low) - square) * inverse
    return where(nothing, -_ENDLESS, down), where(nothing, _ENDLESS, up)


def allocate_to_pairs(wrench: Wrench, rotors: RotorModel) -> Allocated:
    """The same with fewer operations, where the rotors are in pairs and all alike, as in a plus, an x and an h.

    In squared rotor speeds, with the thrust's `level`, the `room` above and below it, and what roll and pitch torque
    ask of the pairs, the rotors are at

        1, 3: level ± pair_13 + yaw        2, 4: level ± pair_24 - yaw

    so roll and pitch leave yaw an interval, and their share is the largest for which that interval still holds a
    yaw between none and the one that is wanted.
    """
    thrust, tau_x, tau_y, tau_z = wrench
    mixer, min_speed, max_speed = rotors
    low, high = min_speed * min_speed, max_speed * max_speed
    rotor_1, rotor_2 = mixer.rotor_1, mixer.rotor_2

    wanted_level, wanted_yaw = rotor_1.thrust * thrust, rotor_1.tau_z * tau_z
    wanted_13 = rotor_1.tau_x * tau_x + rotor_1.tau_y * tau_y
    wanted_24 = rotor_2.tau_x * tau_x + rotor_2.tau_y * tau_y
    level = minimum(maximum(wanted_level, low), high)
    share = _share_of_pairs(level, abs(wanted_24), abs(wanted_13), wanted_yaw, low, high)
    pair_13, pair_24 = share * wanted_13, share * wanted_24
    size_13, size_24, above, below = abs(pair_13), abs(pair_24), high - level, level - low
    least, most = maximum(size_13 - below, size_24 - above), minimum(above - size_13, below - size_24)
    yaw = maximum(minimum(wanted_yaw, most), least)
    given_up = 1.0 - share
    return Allocated(
        RotorSpeed(
            sqrt(maximum(level + pair_13 + yaw, low)),
            sqrt(maximum(level + pair_24 - yaw, low)),
            sqrt(maximum(level - pair_13 + yaw, low)),
            sqrt(maximum(level - pair_24 - yaw, low)),
        ),
        Wrench(
            (wanted_level - level) * (1.0 / rotor_1.thrust),
            given_up * tau_x,
            given_up * tau_y,
            (wanted_yaw - yaw) * (1.0 / rotor_1.tau_z),
        ),
    )


def _share_of_pairs(level: Row, size_24: Row, size_13: Row, yaw: Row, low: Row, high: Row) -> Row:
    """The largest share, at most 1, of roll and pitch that leaves a yaw between none and the wanted one.

    Args:
        level: squared rotor speed of the thrust.
        size_24: of what roll and pitch ask of rotors 2 and 4.
        size_13: of what they ask of rotors 1 and 3.
        yaw: what yaw asks of rotors 1 and 3.
        low: least squared rotor speed.
        high: largest.
    """
    above, below, half = high - level, level - low, 0.5 * (high - low)
    left, right = maximum(yaw, 0.0), minimum(yaw, 0.0)
    room_13 = minimum(minimum(below + left, above - right), half)
    room_24 = minimum(minimum(above + left, below - right), half)
    room_both = 2.0 * minimum(above, below)
    return minimum(minimum(_share(room_13, size_13), _share(room_24, size_24)), _share(room_both, size_13 + size_24))


def _share(room: Row, demand: Row) -> Row:
    """The part of a demand for which there is room, at most 1; all of no demand."""
    room = room + _TINY
    return room / maximum(demand, room)


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
        paired: whether the rotors are known to be in pairs and all alike, which spares operations.
        numbers: what the autopilot believes of the rotors.
    """

    def declare(self, *, paired: bool = False, numbers: RotorModel = RotorModel.of(QuadrotorParameters())) -> None:
        """Declares the system."""
        wrench, rotors = self.input("wrench"), self.parameter("rotors", lambda rotors: rotors)
        formula = allocate_to_pairs if paired else allocate
        self.packed_output("rotor_speed_command_and_shortfall", Allocated, formula, wrench, rotors)
