"""Piecewise polynomial paths in segment-local unit time: values, derivatives, and their peaks."""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

# Number of intervals into which a segment is divided to find peaks. A polynomial of low degree has at most one relevant
# peak in each interval.
NUM_CELLS = 48
_CELL_EDGES = np.linspace(0.0, 1.0, NUM_CELLS + 1)  # ends of the intervals, as fractions of the segment
# Number of bisections that locate a peak. The error in the peak value is quadratic in the error of its position, so
# only rounding errors remain.
_NUM_BISECTIONS = 16


class PolynomialPath(NamedTuple):
    """Piecewise polynomial in segment-local unit time.

    Attributes:
        times: (segments + 1,) times of the waypoints, s.
        coefficients: (segments, degree + 1, axes) coefficients of s^k with s in [0, 1], m.
    """

    times: np.ndarray
    coefficients: np.ndarray

    @property
    def durations(self) -> np.ndarray:
        """(segments,) duration of each segment, s."""
        return np.diff(self.times)

    @property
    def duration(self) -> float:
        """Time from the first to the last waypoint, s."""
        return float(self.times[-1] - self.times[0])

    @property
    def waypoints(self) -> np.ndarray:
        """(segments + 1, axes) points at which the segments begin and end, m."""
        return np.vstack([self.coefficients[:, 0], self.coefficients[-1:].sum(axis=1)])

    def scaled_in_time(self, factor: float) -> "PolynomialPath":
        """Return the path with all durations multiplied by a factor."""
        return PolynomialPath(self.times[0] + factor * (self.times - self.times[0]), self.coefficients)


class Peaks(NamedTuple):
    """Peaks of the norm of a vector along a path.

    Attributes:
        segment: (peaks,) indices of the segments.
        s: (peaks,) unit times on the segments, 0 to 1.
        value: (peaks, axes) vectors at the peaks.
    """

    segment: np.ndarray
    s: np.ndarray
    value: np.ndarray

    @property
    def norm(self) -> np.ndarray:
        """(peaks,) norms of the vectors."""
        return np.asarray(np.linalg.norm(self.value, axis=1))


def power_basis(order: int, s: ArrayLike, powers: int) -> np.ndarray:
    """Return the derivatives of the powers 1, s, s², ... with respect to s, as an array (..., powers)."""
    falling, exponent = _derivative_of_powers(order, powers)
    return np.asarray(falling * np.asarray(s, dtype=float)[..., np.newaxis] ** exponent)


@cache
def _derivative_of_powers(order: int, powers: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (powers,) factors and exponents of the derivatives of the monomials 1, s, s², ..."""
    falling = np.array([math.perm(k, order) for k in range(powers)], dtype=float)
    return falling, np.maximum(np.arange(powers) - order, 0)


@cache
def hermite_matrix(orders: int) -> np.ndarray:
    """Return the (2 orders, 2 orders) matrix that maps a segment's boundary derivatives to its coefficients.

    The boundary derivatives are the position and its derivatives with respect to s up to order `orders` - 1. Those at
    the start come first, then those at the end.
    """
    to_boundary = np.array([power_basis(order, s, 2 * orders) for s in (0.0, 1.0) for order in range(orders)])
    # The entries of the exact inverse are integers divided by this factorial. Rounding to such fractions removes the
    # inversion error.
    denominator = math.factorial(orders - 1)
    return np.asarray(np.round(denominator * np.linalg.inv(to_boundary)) / denominator)


def hermite_path(times: np.ndarray, derivatives: np.ndarray) -> PolynomialPath:
    """Return the path with given derivatives at its knots.

    Args:
        times: (knots,) increasing times, s.
        derivatives: (knots, orders, axes) position and its derivatives up to order `orders` - 1, in m and s.
    """
    orders = derivatives.shape[1]
    scale = np.diff(times)[:, np.newaxis, np.newaxis] ** np.arange(orders)[:, np.newaxis]
    boundary = np.concatenate([derivatives[:-1] * scale, derivatives[1:] * scale], axis=1)
    # Positions are relative to the start, so that a large distance from the origin does not reduce the accuracy.
    boundary[:, orders] -= boundary[:, 0]
    start, boundary[:, 0] = boundary[:, 0].copy(), 0.0
    coefficients = hermite_matrix(orders) @ boundary
    coefficients[:, 0] = start
    return PolynomialPath(times, coefficients)


def knots(path: PolynomialPath, orders: int) -> np.ndarray:
    """Return the position and its derivatives at the knots of a path, the inverse of `hermite_path`.

    Returns:
        (knots, orders, axes) position and its derivatives up to order `orders` - 1, in m and s.
    """
    last = len(path.coefficients) - 1
    segment = np.append(np.arange(last + 1), last)
    s = np.append(np.zeros(last + 1), 1.0)
    return np.stack([evaluate_at(path, segment, s, order) for order in range(orders)], axis=1)


def path_derivative(path: PolynomialPath, order: int) -> PolynomialPath:
    """Return the time derivative of a given order as a path, whose degree is lower by this order."""
    powers = np.arange(path.coefficients.shape[1])
    falling = np.array([math.perm(k, order) for k in powers], dtype=float)[order:]
    scale = falling * path.durations[:, np.newaxis] ** -order
    return PolynomialPath(path.times, path.coefficients[:, order:] * scale[:, :, np.newaxis])


def evaluate(path: PolynomialPath, times: ArrayLike, order: int = 0) -> np.ndarray:
    """Return the (axes, samples) time derivative of a path; before and after the path, the value at its nearer end.

    Args:
        path: path to evaluate.
        times: (samples,) times, s.
        order: order of the derivative, 0 for the position.
    """
    instants = np.clip(np.asarray(times, dtype=float), path.times[0], path.times[-1])
    segment = np.clip(np.searchsorted(path.times, instants, side="right") - 1, 0, len(path.coefficients) - 1)
    s = (instants - path.times[segment]) / path.durations[segment]
    return evaluate_at(path, segment, s, order).T


def evaluate_at(path: PolynomialPath, segment: np.ndarray, s: np.ndarray, order: int = 0) -> np.ndarray:
    """Return the (samples, axes) time derivative of a path at given points.

    Args:
        path: path to evaluate.
        segment: (samples,) indices of the segments.
        s: (samples,) unit times on the segments, 0 to 1.
        order: order of the derivative, 0 for the position.
    """
    basis = power_basis(order, s, path.coefficients.shape[1])
    scale = path.durations[segment] ** -order
    return np.einsum("nk,nka->na", basis * scale[:, np.newaxis], path.coefficients[segment])


def subdivide(path: PolynomialPath, times: np.ndarray) -> PolynomialPath:
    """Return the same path with its segments divided at additional times, (instants,) in s."""
    next_index = np.clip(np.searchsorted(path.times, times), 1, len(path.times) - 1)
    distance = np.minimum(np.abs(times - path.times[next_index - 1]), np.abs(times - path.times[next_index]))
    inside = (times > path.times[0]) & (times < path.times[-1])
    # Times that differ only by rounding errors count as one time.
    joined = np.union1d(path.times, times[inside & (distance > 1e-9 * path.durations.min())])
    segment = np.searchsorted(path.times, joined[:-1], side="right") - 1
    duration = path.durations[segment]
    start, fraction = (joined[:-1] - path.times[segment]) / duration, np.diff(joined) / duration
    # A part of a segment consists of the unit times start + fraction u, where u runs from 0 to 1. The coefficients of
    # the part are those of the Taylor series of p(start + fraction u) in u. An undivided segment keeps its
    # coefficients.
    powers = path.coefficients.shape[1]
    taylor = np.stack([power_basis(k, start, powers) / math.factorial(k) for k in range(powers)], axis=1)
    taylor *= fraction[:, np.newaxis, np.newaxis] ** np.arange(powers)[:, np.newaxis]
    return PolynomialPath(joined, taylor @ path.coefficients[segment])


def norm_peaks(path: PolynomialPath, order: int) -> Peaks:
    """Return the local maxima of a time derivative's norm, together with its values at the segment ends."""
    components = path_derivative(path, order).coefficients
    powers = components.shape[1]
    # The derivative of half the squared norm is the sum over the axes of products of two polynomials.
    rates = components[:, 1:] * np.arange(1.0, powers)[:, np.newaxis]
    derivatives = np.zeros((len(components), 2 * powers - 2))
    for power in range(powers):
        derivatives[:, power : power + powers - 1] += np.einsum("na,nka->nk", components[:, power], rates)

    def derivative(segment: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nk->n", power_basis(0, s, 2 * powers - 2), derivatives[segment])

    segment, s = _find_maxima(derivatives @ power_basis(0, _CELL_EDGES, 2 * powers - 2).T, derivative)
    segments_in_order = np.arange(len(components))
    segment = np.concatenate([segment, segments_in_order, segments_in_order])
    s = np.concatenate([s, np.zeros(len(segments_in_order)), np.ones(len(segments_in_order))])
    return Peaks(segment, s, evaluate_at(path, segment, s, order))


def peak_norm(path: PolynomialPath, order: int) -> float:
    """Return the largest norm of a time derivative along the whole path, exact up to rounding."""
    return float(norm_peaks(path, order).norm.max())


def turning_points(path: PolynomialPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the points inside segments at which the position reverses along an axis.

    The result is the segment, the axis and s of each point, three arrays of shape (points,). Each segment is divided
    into `NUM_CELLS` cells. The search misses two turning points in the same cell, and a turning point in a cell that
    begins or ends at rest. The position then turns back by at most M h³ / 12, where M is the largest third derivative
    with respect to s and h is the cell width.
    """
    segments, powers, axes = path.coefficients.shape
    rows = path.coefficients.transpose(0, 2, 1).reshape(segments * axes, powers)
    # Minima of the position are maxima of its negative.
    row, s, _ = inner_maxima(np.concatenate([rows, -rows]))
    segment, axis = np.divmod(row % len(rows), axes)
    return segment, axis, s


def inner_maxima(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the index of the polynomial, s and value of each maximum inside [0, 1], three arrays (maxima,).

    Args:
        rows: (rows, powers) coefficients of each polynomial, starting with the constant term.
    """
    powers = rows.shape[1]

    def derivative(row: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nk->n", power_basis(1, s, powers), rows[row])

    row, s = _find_maxima(rows @ power_basis(1, _CELL_EDGES, powers).T, derivative)
    return row, s, np.einsum("nk,nk->n", power_basis(0, s, powers), rows[row])


def _find_maxima(
    derivatives: np.ndarray, derivative: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of the functions and the arguments of all maxima of functions on [0, 1].

    Args:
        derivatives: (rows, samples) derivatives of the functions at equidistant samples.
        derivative: function that returns derivatives, given indices of functions and arguments.
    """
    row, sample = np.nonzero((derivatives[:, :-1] > 0.0) & (derivatives[:, 1:] <= 0.0))
    low, high = _CELL_EDGES[sample], _CELL_EDGES[sample + 1]
    for _ in range(_NUM_BISECTIONS):
        middle = 0.5 * (low + high)
        rising = derivative(row, middle) > 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    return row, 0.5 * (low + high)
