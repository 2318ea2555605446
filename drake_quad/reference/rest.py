"""Extension of a reference beyond its route: rest before the start, braking if it ends in motion, and rest afterwards.

A minimum-snap path that ends at rest has zero velocity, acceleration and jerk at its end, but not zero snap. If the
path were not extended, a controller would feed forward this snap for ever.
"""

import math

import numpy as np

from drake_quad.reference.polynomial_path import PolynomialPath, knots, norm_peaks, peak_norm, power_basis

# Velocity, acceleration and jerk, in m (or rad) and s, below which a path counts as at rest. The rounding errors of
# solvers, and of files with six decimals, are smaller. Jumps of this magnitude have no visible effect: an acceleration
# of 0.01 m/s² corresponds to a tilt of 1 mrad.
_REST_TOLERANCES = np.array([1e-3, 1e-2, 1e-1])
# Duration of the constant pieces before and after the motion, s. The value does not matter, since a trajectory is
# constant before its first and after its last time.
_REST_DURATION = 1.0
# Candidate durations of the braking piece, s. The attitude needs some tenths of a second to follow.
_BRAKING_DURATIONS = np.geomspace(1.0, 30.0, 60)


def moves_at_end(path: PolynomialPath, orders: int) -> bool:
    """Return whether a path ends with a nonzero derivative of an order from 1 to `orders` - 1."""
    return bool((np.abs(knots(path, orders)[-1, 1:]) > _REST_TOLERANCES[: orders - 1, np.newaxis]).any())


def with_rest(path: PolynomialPath, *, orders: int, acceleration: float) -> PolynomialPath:
    """Extend a path by rest before its start and after its end, with a braking piece if it ends in motion.

    Braking stays within the largest speed and acceleration of the path if possible, and exceeds them as little as
    possible otherwise.

    Args:
        path: path to extend, in m (or rad) and s.
        orders: number of continuous derivatives at the end of the path, including the position: 4 for a position,
            since rotor speeds depend on snap, and 2 for a yaw.
        acceleration: acceleration that braking may use even if the path stays below it, m/s² (or rad/s²).

    Returns:
        The path with an additional piece before it and one or two pieces after it. All derivatives are zero in the
        first and the last piece.
    """
    pieces = [_resting(path.coefficients[0, 0]), path.coefficients]
    times = [path.times[:1] - _REST_DURATION, path.times]
    if moves_at_end(path, orders):
        braking = _braking(path, orders, acceleration)
        pieces.append(braking.coefficients)
        times.append(path.times[-1] + braking.times[1:])
        end = braking.waypoints[-1]
    else:
        end = path.waypoints[-1]
    pieces.append(_resting(end))
    times.append(times[-1][-1:] + _REST_DURATION)
    powers = max(piece.shape[1] for piece in pieces)
    padded = [np.pad(piece, ((0, 0), (0, powers - piece.shape[1]), (0, 0))) for piece in pieces]
    return PolynomialPath(np.concatenate(times), np.concatenate(padded))


def _resting(position: np.ndarray) -> np.ndarray:
    """Return the coefficients (1, 1, axes) of a piece that rests at a position (axes,)."""
    return position[np.newaxis, np.newaxis]


def _braking(path: PolynomialPath, orders: int, acceleration: float) -> PolynomialPath:
    """Return the piece that brakes from the motion at the end of a path to rest; it starts at time 0."""
    limits = peak_norm(path, 1), max(peak_norm(path, 2), acceleration)
    pieces = _pieces_to_rest(_BRAKING_DURATIONS, knots(path, orders)[-1])
    # All candidates are joined to one path, so one call finds the peaks of all of them.
    candidates = PolynomialPath(np.concatenate([[0.0], np.cumsum(_BRAKING_DURATIONS)]), pieces)
    excess = np.zeros(len(pieces))
    for order, limit in enumerate(limits, start=1):
        peaks = norm_peaks(candidates, order)
        if limit > 0.0:
            np.maximum.at(excess, peaks.segment, peaks.norm / limit)
    # A path may end with its largest acceleration, so the comparison needs a tolerance for rounding errors.
    within = np.flatnonzero(excess <= 1.0 + 1e-9)
    best = int(within[0] if within.size else np.argmin(excess))
    return PolynomialPath(np.array([0.0, _BRAKING_DURATIONS[best]]), pieces[best : best + 1])


def _pieces_to_rest(durations: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return pieces that reach rest in given durations and minimise the integral of their squared n-th derivative.

    The end position is free, so the derivative of order 2n - 1 is zero there. The optimal polynomial therefore has
    degree 2n - 2.

    Args:
        durations: (pieces,) durations, s.
        start: (n, axes) position and its first n - 1 derivatives at the start.

    Returns:
        (pieces, 2n - 1, axes) coefficients.
    """
    orders = len(start)
    powers = 2 * orders - 1
    factorials = np.array([math.factorial(order) for order in range(orders)])
    scales = durations[:, np.newaxis] ** np.arange(orders) / factorials
    coefficients = np.zeros((len(durations), powers, start.shape[1]))
    coefficients[:, :orders] = start * scales[:, :, np.newaxis]
    at_end = np.array([power_basis(order, 1.0, powers) for order in range(1, orders)])
    coefficients[:, orders:] = np.linalg.solve(at_end[:, orders:], -at_end[:, :orders] @ coefficients[:, :orders])
    return coefficients
