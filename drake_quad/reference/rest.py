"""The reference outside its route: it rests before the start, and after the end, where it brakes first if it moves.

A minimum-snap path that ends at rest ends without velocity, acceleration and jerk, but not without snap. A path that is
evaluated at its end for ever would feed that snap forward for ever.
"""

import math

import numpy as np

from drake_quad.reference.polynomial_path import PolynomialPath, knots, peak_norm, power_basis

# Velocity, acceleration and jerk below which a path is at rest, in m (or rad) and s. Solvers and files of six decimals
# leave less, and no vehicle shows a jump of this size: 0.01 m/s² is 1 mrad of tilt.
_AT_REST = np.array([1e-3, 1e-2, 1e-1])
# Length of the constant pieces, s. A trajectory keeps its first and last value outside, so any length serves.
_REST = 1.0
# Durations of a braking piece that are tried, s. An attitude loop needs some tenths of a second to follow.
_DURATIONS = np.geomspace(1.0, 30.0, 60)


def moves_at_end(path: PolynomialPath, orders: int) -> bool:
    """Return whether a path ends with a derivative above zero of an order below `orders`."""
    return bool((np.abs(knots(path, orders)[-1, 1:]) > _AT_REST[: orders - 1, np.newaxis]).any())


def with_rest(path: PolynomialPath, *, orders: int, acceleration: float) -> PolynomialPath:
    """Return a path with rest before it and after it, and with a braking piece in between if it ends in motion.

    Braking keeps to the largest speed and acceleration of the path where it can, and else exceeds them as little as it
    can.

    Args:
        path: in m (or rad) and s.
        orders: derivatives that are continuous at the end of the path, the position included: four for a position,
            since rotors follow snap, and two for a yaw.
        acceleration: allowed for braking even if the path itself has less, m/s² (or rad/s²).

    Returns:
        The path with one piece more before it and one or two after it. All derivatives are zero in the first piece and
        in the last one.
    """
    pieces = [_resting(path.coefficients[0, 0]), path.coefficients]
    times = [path.times[:1] - _REST, path.times]
    if moves_at_end(path, orders):
        braking = _braking(path, orders, acceleration)
        pieces.append(braking.coefficients)
        times.append(path.times[-1] + braking.times[1:])
        end = braking.waypoints[-1]
    else:
        end = path.waypoints[-1]
    pieces.append(_resting(end))
    times.append(times[-1][-1:] + _REST)
    powers = max(piece.shape[1] for piece in pieces)
    padded = [np.pad(piece, ((0, 0), (0, powers - piece.shape[1]), (0, 0))) for piece in pieces]
    return PolynomialPath(np.concatenate(times), np.concatenate(padded))


def _resting(position: np.ndarray) -> np.ndarray:
    """(1, 1, axes) the coefficients of a piece that stays at a position (axes,)."""
    return position[np.newaxis, np.newaxis]


def _braking(path: PolynomialPath, orders: int, acceleration: float) -> PolynomialPath:
    """The piece from the motion at the end of a path to rest, from time 0 on."""
    start = knots(path, orders)[-1]
    limits = peak_norm(path, 1), max(peak_norm(path, 2), acceleration)

    def excess(piece: PolynomialPath) -> float:
        return max(peak_norm(piece, order) / limit for order, limit in enumerate(limits, start=1) if limit > 0.0)

    pieces = [_brake_within(duration, start) for duration in _DURATIONS]
    excesses = np.array([excess(piece) for piece in pieces])
    # A path may end with its largest acceleration, which rounding must not make too much.
    within = np.flatnonzero(excesses <= 1.0 + 1e-9)
    return pieces[int(within[0]) if within.size else int(np.argmin(excesses))]


def _brake_within(duration: float, start: np.ndarray) -> PolynomialPath:
    """The piece that comes to rest at a free position, with the least integral of its highest derivative squared.

    With n orders that derivative is the n-th, and the polynomial is of degree 2n - 2: where the end is free, the
    derivative of order 2n - 1 is zero.

    Args:
        duration: s.
        start: (n, axes) the motion at the start, from the position on.
    """
    orders, unit = len(start), np.array([0.0, 1.0])
    powers = 2 * orders - 1
    coefficients = np.zeros((powers, start.shape[1]))
    factorials = np.array([math.factorial(order) for order in range(orders)])
    coefficients[:orders] = start * (duration ** np.arange(orders) / factorials)[:, np.newaxis]
    at_end = np.array([power_basis(order, 1.0, powers) for order in range(1, orders)])
    coefficients[orders:] = np.linalg.solve(at_end[:, orders:], -at_end[:, :orders] @ coefficients[:orders])
    return PolynomialPath(unit * duration, coefficients[np.newaxis])
