"""Control allocation from a commanded wrench to rotor speeds: the paper's eq (5), inverted within the rotors' limits.

If the rotors cannot produce the whole wrench, a `Priority` determines the order in which its parts are chosen:

- "roll_pitch", the default: roll and pitch torque first, thrust second, yaw torque third;
- "thrust": thrust first, roll and pitch torque second, yaw torque third.

With roll and pitch torque first, each part is chosen within the freedom that the earlier parts leave:

1. Roll and pitch torque are multiplied by the same fraction in [0, 1], which keeps their direction. It is the largest
   fraction that the rotors can produce at any thrust, with a yaw torque between zero and the commanded value.
2. The thrust is the feasible value nearest to the commanded thrust. It is reduced if a rotor would exceed its maximum
   speed, and increased if a rotor would fall below idle speed.
3. The yaw torque is the feasible value nearest to the commanded yaw torque.

With thrust first, the thrust is the value nearest to the commanded thrust that the rotors can produce without torque.
The fraction of roll and pitch torque, and then the yaw torque, are chosen as above.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain, combinations
from typing import Literal, NamedTuple

from drake_quad.framework.elementary import lazy_where, maximum, minimum, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import RotorRate, RotorSpeed, Row, Wrench
from drake_quad.vehicle.mixer import Mixer, mixer_from_parameters
from drake_quad.vehicle.parameters import QuadrotorParameters

Priority = Literal["roll_pitch", "thrust"]
"""Part of a wrench that has priority if the rotors cannot produce the whole wrench."""

# Offset that avoids 0 / 0 if both the available range and the demand are zero. Otherwise it is negligible.
_ZERO_DIVISION_OFFSET = 1e-100
_UNBOUNDED = 1e100  # larger than any force or torque
# Coefficients below this limit, relative to the sum of the coefficients of all rotors, are treated as rounding errors
# of zero.
_MIN_COEFFICIENT = 1e-9


class RotorModel(NamedTuple):
    """Autopilot's model of the rotors.

    Attributes:
        mixer: mixer from a wrench to squared rotor speeds.
        min_speed: idle speed, rad/s.
        max_speed: maximum speed, rad/s.
    """

    mixer: Mixer
    min_speed: RotorRate
    max_speed: RotorRate

    @classmethod
    def of(cls, parameters: QuadrotorParameters) -> "RotorModel":
        """Return the exact rotor model of a vehicle."""
        return cls(mixer_from_parameters(parameters), parameters.min_rotor_speed, parameters.max_rotor_speed)


class AllocationOutput(NamedTuple):
    """Result of a control allocation to rotor speeds.

    Attributes:
        rotor_speed_command: rotor speeds that produce the wrench, or the part of it that the rotors can produce.
        shortfall: commanded wrench minus the wrench of these speeds; exactly zero for each part that is produced
            completely.
    """

    rotor_speed_command: RotorSpeed
    shortfall: Wrench


class _SquaredSpeed(NamedTuple):
    """Squared speed of one rotor, as the coefficients of a linear function of the wrench.

    Attributes:
        thrust: squared speed per newton of thrust; positive.
        tilt: part of the squared speed that the whole commanded roll and pitch torque requires.
        yaw: squared speed per newton metre of yaw torque.
    """

    thrust: Row
    tilt: Row
    yaw: Row


class _Bound(NamedTuple):
    """Inequality that bounds the fraction of roll and pitch torque: lower <= tilt * fraction <= upper."""

    tilt: Row
    lower: Row
    upper: Row


class _Producible(NamedTuple):
    """Producible part of a wrench: thrust (N), fraction of roll and pitch torque, and yaw torque (N m)."""

    thrust: Row
    fraction: Row
    tau_z: Row


def allocate(wrench: Wrench, rotors: RotorModel, priority: Priority = "roll_pitch") -> AllocationOutput:
    """Return the rotor speeds for a wrench, and the part of the wrench that the rotors cannot produce.

    The function works for any layout in which all rotors carry a part of the thrust in hover. The whole wrench is
    produced if every rotor is within its limits both for the whole wrench and for the thrust without torque.

    Args:
        wrench: commanded wrench.
        rotors: autopilot's model of the rotors.
        priority: part of the wrench that has priority.
    """
    low, high = rotors.min_speed * rotors.min_speed, rotors.max_speed * rotors.max_speed
    squares = [
        _SquaredSpeed(row.thrust, row.tau_x * wrench.tau_x + row.tau_y * wrench.tau_y, row.tau_z)
        for row in rotors.mixer
    ]
    lowest, highest = high, low
    for square in squares:
        level = square.thrust * wrench.thrust
        whole = level + square.tilt + square.yaw * wrench.tau_z
        lowest, highest = minimum(minimum(level, whole), lowest), maximum(maximum(level, whole), highest)
    kept = lazy_where(
        (lowest < low) | (highest > high),
        partial(_within_limits, priority),
        (wrench.thrust, wrench.tau_z, low, high, *chain.from_iterable(squares)),
        _Producible(wrench.thrust, 1.0, wrench.tau_z),
    )
    given_up = 1.0 - kept.fraction
    speeds = []
    for square in squares:
        whole = square.thrust * kept.thrust + kept.fraction * square.tilt + square.yaw * kept.tau_z
        speeds.append(sqrt(minimum(maximum(whole, low), high)))
    return AllocationOutput(
        RotorSpeed._make(speeds),
        Wrench(
            wrench.thrust - kept.thrust, given_up * wrench.tau_x, given_up * wrench.tau_y, wrench.tau_z - kept.tau_z
        ),
    )


def _within_limits(priority: Priority, thrust: Row, tau_z: Row, low: Row, high: Row, *rows: Row) -> _Producible:
    """Return the part of a wrench that the rotors can produce.

    The squared speed of each rotor is a linear function of three unknowns (thrust, fraction of roll and pitch torque,
    yaw torque) and lies between two limits. In weighted sums of two or three squared speeds, the weights cancel the yaw
    torque, the thrust, or both. The limits of these sums bound the other unknowns. By Helly's theorem, sums over more
    rotors give no tighter bounds.

    Args:
        priority: part of the wrench that has priority.
        thrust: commanded thrust, N.
        tau_z: commanded yaw torque, N m.
        low: smallest squared speed, rad²/s².
        high: largest squared speed, rad²/s².
        rows: values of the `_SquaredSpeed` of each rotor, one rotor after the other.
    """
    squares = [_SquaredSpeed(*three) for three in zip(*[iter(rows)] * len(_SquaredSpeed._fields))]
    size = sum(abs(square.yaw) for square in squares)
    squares = [square._replace(yaw=_without_rounding(square.yaw, size)) for square in squares]
    thrust_kept, fraction = _THRUST_AND_FRACTION[priority](squares, thrust, tau_z, low, high)
    yaw_bounds = []
    for square in squares:
        bare = square.thrust * thrust_kept + fraction * square.tilt
        yaw_bounds.append(_interval(low - bare, high - bare, square.yaw))
    return _Producible(thrust_kept, fraction, _nearest(tau_z, yaw_bounds))


def _roll_pitch_first(
    squares: Sequence[_SquaredSpeed], thrust: Row, tau_z: Row, low: Row, high: Row
) -> tuple[Row, Row]:
    """Return thrust and fraction of roll and pitch torque, if roll and pitch torque are chosen first.

    The fraction is the largest feasible one. The thrust is the value nearest to `thrust` that is feasible with this
    fraction.
    """
    fraction = _max_fraction(_fraction_bounds(squares, tau_z, low, high))
    bounds = [
        _interval(bound.lower - bound.tilt * fraction, bound.upper - bound.tilt * fraction, factor)
        for factor, bound in _thrust_and_fraction_bounds(squares, tau_z, low, high)
    ]
    return _nearest(thrust, bounds), fraction


def _thrust_first(squares: Sequence[_SquaredSpeed], thrust: Row, tau_z: Row, low: Row, high: Row) -> tuple[Row, Row]:
    """Return thrust and fraction of roll and pitch torque, if the thrust is chosen first.

    The thrust is the value nearest to `thrust` that is feasible without torque. The fraction is the largest one that is
    feasible with this thrust.
    """
    thrust_kept = _nearest(thrust, [(low / square.thrust, high / square.thrust) for square in squares])
    bounds = [
        _Bound(bound.tilt, bound.lower - factor * thrust_kept, bound.upper - factor * thrust_kept)
        for factor, bound in _thrust_and_fraction_bounds(squares, tau_z, low, high)
    ]
    return thrust_kept, _max_fraction(bounds)


_THRUST_AND_FRACTION: dict[Priority, Callable[..., tuple[Row, Row]]] = {
    "roll_pitch": _roll_pitch_first,
    "thrust": _thrust_first,
}


def _thrust_and_fraction_bounds(
    squares: Sequence[_SquaredSpeed], tau_z: Row, low: Row, high: Row
) -> list[tuple[Row, _Bound]]:
    """Return bounds on the thrust and on the fraction of roll and pitch torque.

    Within these bounds, some yaw torque between zero and tau_z is feasible. Each rotor gives a bound with the most
    favourable yaw torque for this rotor. Each pair of rotors gives a bound that does not depend on the yaw torque.

    Returns:
        List of pairs `(factor, bound)`, each of which is the inequality
        `bound.lower <= factor * thrust + bound.tilt * fraction <= bound.upper`.
    """
    bounds = [(square.thrust, _Bound(square.tilt, *_widened(low, high, square.yaw * tau_z))) for square in squares]
    for one, other in combinations(squares, 2):
        tilt = other.yaw * one.tilt - one.yaw * other.tilt
        bounds.append((_determinant(one, other, squares), _Bound(tilt, *_range((other.yaw, -one.yaw), low, high))))
    return bounds


def _fraction_bounds(squares: Sequence[_SquaredSpeed], tau_z: Row, low: Row, high: Row) -> list[_Bound]:
    """Return bounds on the fraction of roll and pitch torque.

    Within these bounds, some thrust and some yaw torque between zero and tau_z are feasible. Each pair of rotors gives
    a bound that does not depend on the thrust, with the most favourable yaw torque for this pair. Each triple of rotors
    gives a bound that depends on neither thrust nor yaw torque.
    """
    bounds = []
    for one, other in combinations(squares, 2):
        tilt, yaw = other.thrust * one.tilt - one.thrust * other.tilt, -_determinant(one, other, squares) * tau_z
        bounds.append(_Bound(tilt, *_widened(*_range((other.thrust, -one.thrust), low, high), yaw)))
    for one, two, three in combinations(squares, 3):
        of_one, of_two, of_three = (
            _determinant(two, three, squares),
            _determinant(three, one, squares),
            _determinant(one, two, squares),
        )
        tilt = of_one * one.tilt + of_two * two.tilt + of_three * three.tilt
        bounds.append(_Bound(tilt, *_range((of_one, of_two, of_three), low, high)))
    return bounds


def _determinant(one: _SquaredSpeed, other: _SquaredSpeed, squares: Sequence[_SquaredSpeed]) -> Row:
    """Return the determinant of the thrust and yaw coefficients of two rotors."""
    size = sum(square.thrust for square in squares) * sum(abs(square.yaw) for square in squares)
    return _without_rounding(one.thrust * other.yaw - other.thrust * one.yaw, size)


def _without_rounding(coefficient: Row, size: Row) -> Row:
    """Return a coefficient, or exactly zero if it is only a rounding error compared with `size`."""
    return where(abs(coefficient) <= _MIN_COEFFICIENT * size, 0.0, coefficient)


def _range(weights: Sequence[Row], low: Row, high: Row) -> tuple[Row, Row]:
    """Return the smallest and the largest weighted sum of squared speeds, each of which lies between two limits."""
    up, down = sum(maximum(weight, 0.0) for weight in weights), sum(minimum(weight, 0.0) for weight in weights)
    return up * low + down * high, up * high + down * low


def _widened(lower: Row, upper: Row, yaw: Row) -> tuple[Row, Row]:
    """Return the limits of the other terms of a sum, given the limits of the sum and the range of its yaw term.

    Args:
        lower: lower limit of the sum.
        upper: upper limit of the sum.
        yaw: the contribution of yaw torque to the sum may have any value between zero and this number.
    """
    return lower - maximum(yaw, 0.0), upper - minimum(yaw, 0.0)


def _max_fraction(bounds: Sequence[_Bound]) -> Row:
    """Return the largest fraction of roll and pitch torque, at most 1, that satisfies all bounds."""
    fraction: Row = 1.0
    for tilt, lower, upper in bounds:
        room = where(tilt > 0.0, upper, -lower)
        fraction = minimum(_fitting_fraction(maximum(room, 0.0), abs(tilt)), fraction)
    return fraction


def _interval(lower: Row, upper: Row, factor: Row) -> tuple[Row, Row]:
    """Return the smallest and the largest x with lower <= factor * x <= upper; unbounded for a factor of zero."""
    rising, free = factor > 0.0, factor == 0.0
    inverse = 1.0 / where(free, 1.0, factor)
    down, up = where(rising, lower, upper) * inverse, where(rising, upper, lower) * inverse
    return where(free, -_UNBOUNDED, down), where(free, _UNBOUNDED, up)


def _nearest(wanted: Row, bounds: Sequence[tuple[Row, Row]]) -> Row:
    """Return the number nearest to `wanted` that satisfies all bounds, each a pair of smallest and largest value."""
    lower, upper = -_UNBOUNDED, _UNBOUNDED
    for down, up in bounds:
        lower, upper = maximum(down, lower), minimum(up, upper)
    return minimum(maximum(wanted, lower), upper)


def _fitting_fraction(room: Row, demand: Row) -> Row:
    """Return the largest fraction of `demand`, at most 1, that is not larger than `room`; 1 if `demand` is zero."""
    room = room + _ZERO_DIVISION_OFFSET
    return room / maximum(demand, room)


class _Pairs(NamedTuple):
    """Contributions of a wrench to the squared speeds of paired rotors.

    Attributes:
        level: contribution of the thrust, the same for all rotors.
        pair_13: contribution of roll and pitch torque to rotor 1; the contribution to rotor 3 is -pair_13.
        pair_24: contribution of roll and pitch torque to rotor 2; the contribution to rotor 4 is -pair_24.
        yaw: contribution of yaw torque to rotors 1 and 3; the contribution to rotors 2 and 4 is -yaw.
    """

    level: Row
    pair_13: Row
    pair_24: Row
    yaw: Row


def allocate_to_pairs(wrench: Wrench, rotors: RotorModel, priority: Priority = "roll_pitch") -> AllocationOutput:
    """Return the result of `allocate` for equal rotors in opposite pairs, with fewer operations.

    The layouts plus, x and h consist of such pairs. The squared speeds are

        1, 3: level ± pair_13 + yaw        2, 4: level ± pair_24 - yaw

    so that the feasible yaw torques form an interval, given the thrust and the roll and pitch torque.

    Args:
        wrench: commanded wrench.
        rotors: autopilot's model of the rotors.
        priority: part of the wrench that has priority.
    """
    thrust, tau_x, tau_y, tau_z = wrench
    mixer, min_speed, max_speed = rotors
    low, high = min_speed * min_speed, max_speed * max_speed
    rotor_1, rotor_2 = mixer.rotor_1, mixer.rotor_2

    wanted = _Pairs(
        rotor_1.thrust * thrust,
        rotor_1.tau_x * tau_x + rotor_1.tau_y * tau_y,
        rotor_2.tau_x * tau_x + rotor_2.tau_y * tau_y,
        rotor_1.tau_z * tau_z,
    )
    level, fraction = _PAIRED_LEVEL_AND_FRACTION[priority](wanted, low, high)
    pair_13, pair_24 = fraction * wanted.pair_13, fraction * wanted.pair_24
    size_13, size_24, above, below = abs(pair_13), abs(pair_24), high - level, level - low
    lower, upper = maximum(size_13 - below, size_24 - above), minimum(above - size_13, below - size_24)
    yaw = maximum(minimum(wanted.yaw, upper), lower)
    given_up = 1.0 - fraction
    return AllocationOutput(
        RotorSpeed(
            sqrt(maximum(level + pair_13 + yaw, low)),
            sqrt(maximum(level + pair_24 - yaw, low)),
            sqrt(maximum(level - pair_13 + yaw, low)),
            sqrt(maximum(level - pair_24 - yaw, low)),
        ),
        Wrench(
            (wanted.level - level) * (1.0 / rotor_1.thrust),
            given_up * tau_x,
            given_up * tau_y,
            (wanted.yaw - yaw) * (1.0 / rotor_1.tau_z),
        ),
    )


def _paired_roll_pitch_first(wanted: _Pairs, low: Row, high: Row) -> tuple[Row, Row]:
    """Return the tuple (level, fraction), if roll and pitch torque are chosen first.

    Roll and pitch torque move the squared speeds of a pair of rotors apart, symmetrically about their mean. If the mean
    is in the middle of the range of squared speeds, each speed can move by half of the range. This determines the
    largest fraction of roll and pitch torque.

    With this fraction, the mean of the pair (level + yaw for one pair, level - yaw for the other) may deviate from the
    middle by the part of the half range that is left. The level is the value nearest to `wanted.level` for which some
    yaw between zero and `wanted.yaw` satisfies these bounds.
    """
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    size_13, size_24 = abs(wanted.pair_13), abs(wanted.pair_24)
    fraction = _fitting_fraction(half, maximum(size_13, size_24))
    room_13, room_24 = half - fraction * size_13, half - fraction * size_24
    positive_yaw, negative_yaw = maximum(wanted.yaw, 0.0), minimum(wanted.yaw, 0.0)
    both = 0.5 * (room_13 + room_24)
    up = minimum(minimum(room_13 - negative_yaw, room_24 + positive_yaw), both)
    down = minimum(minimum(room_13 + positive_yaw, room_24 - negative_yaw), both)
    return minimum(maximum(wanted.level, middle - down), middle + up), fraction


def _paired_thrust_first(wanted: _Pairs, low: Row, high: Row) -> tuple[Row, Row]:
    """Return the tuple (level, fraction), if the thrust is chosen first.

    The level is the value nearest to `wanted.level` that is feasible without torque. The fraction of roll and pitch
    torque is the largest one with which some yaw between zero and `wanted.yaw` is feasible at this level.
    """
    level = minimum(maximum(wanted.level, low), high)
    size_13, size_24 = abs(wanted.pair_13), abs(wanted.pair_24)
    above, below, half = high - level, level - low, 0.5 * (high - low)
    positive_yaw, negative_yaw = maximum(wanted.yaw, 0.0), minimum(wanted.yaw, 0.0)
    room_13 = minimum(minimum(below + positive_yaw, above - negative_yaw), half)
    room_24 = minimum(minimum(above + positive_yaw, below - negative_yaw), half)
    room_both = 2.0 * minimum(above, below)
    fraction = minimum(_fitting_fraction(room_13, size_13), _fitting_fraction(room_24, size_24))
    return level, minimum(fraction, _fitting_fraction(room_both, size_13 + size_24))


_PAIRED_LEVEL_AND_FRACTION: dict[Priority, Callable[[_Pairs, Row, Row], tuple[Row, Row]]] = {
    "roll_pitch": _paired_roll_pitch_first,
    "thrust": _paired_thrust_first,
}


@fleet_system(float, AutoDiffXd)
class Allocation(FleetSystem):
    """Control allocation on board the vehicle, from a commanded wrench to rotor speeds.

    .. pydrake_system::

        name: Allocation
        input_ports:
        - wrench
        output_ports:
        - rotor_speed_command_and_shortfall

    The output packs the two signals of `AllocationOutput`: `rotor_speed_command`, from the inverse of eq (5) within the
    limits of the rotors, and `shortfall`, the part of the `wrench` that the rotors cannot produce.

    The only parameter of the context is `rotors`.

    Args:
        num_vehicles: number N of vehicles.
        paired: True if all rotors are equal and in opposite pairs, which saves operations.
        priority: part of the wrench that has priority if the rotors cannot produce the whole wrench.
        parameters: autopilot's model of the rotors.
    """

    def declare(
        self,
        *,
        paired: bool = False,
        priority: Priority = "roll_pitch",
        parameters: RotorModel = RotorModel.of(QuadrotorParameters()),
    ) -> None:
        """Declare the ports and parameters of this system."""
        wrench, rotors = self.input("wrench"), self.parameter("rotors", lambda rotors: rotors)
        formula = allocate_to_pairs if paired else allocate
        self.packed_output("rotor_speed_command_and_shortfall", AllocationOutput, formula, wrench, rotors, priority)
