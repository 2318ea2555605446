"""Paths as piecewise polynomials in segment-local unit time: values, derivatives and where they peak."""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

# Samples of a segment between which a polynomial of low degree has at most one peak worth finding; at a peak the value
# depends on the square of an error of place, so this many bisections leave only rounding.
NUM_CELLS = 48
_SAMPLES = np.linspace(0.0, 1.0, NUM_CELLS + 1)
_BISECTIONS = 16


class PolynomialPath(NamedTuple):
    """A piecewise polynomial in segment-local unit time.

    Attributes:
        times: (segments + 1,) when the waypoints are passed, s.
        coefficients: (segments, degree + 1, axes), of s^k with s in [0, 1]; m.
    """

    times: np.ndarray
    coefficients: np.ndarray

    @property
    def durations(self) -> np.ndarray:
        """(segments,) duration of each segment, s."""
        return np.diff(self.times)

    @property
    def duration(self) -> float:
        """From the first to the last waypoint, s."""
        return float(self.times[-1] - self.times[0])

    @property
    def waypoints(self) -> np.ndarray:
        """(segments + 1, axes) where the segments begin and end, m."""
        return np.vstack([self.coefficients[:, 0], self.coefficients[-1:].sum(axis=1)])

    def stretched(self, factor: float) -> "PolynomialPath":
        """The same path flown `factor` times slower."""
        return PolynomialPath(self.times[0] + factor * (self.times - self.times[0]), self.coefficients)


class Peaks(NamedTuple):
    """Where something is largest, one entry for each peak.

    Attributes:
        segment: (peaks,) index.
        s: (peaks,) place on the segment, 0 to 1.
        value: (peaks, axes) the vector there.
    """

    segment: np.ndarray
    s: np.ndarray
    value: np.ndarray

    @property
    def norm(self) -> np.ndarray:
        """(peaks,) the norm of the vector."""
        return np.asarray(np.linalg.norm(self.value, axis=1))


def power_basis(order: int, s: ArrayLike, powers: int) -> np.ndarray:
    """(..., powers) the derivatives with respect to s, of that order, of 1, s, s², ..."""
    falling, exponent = _derivative_of_powers(order, powers)
    return np.asarray(falling * np.asarray(s, dtype=float)[..., np.newaxis] ** exponent)


@cache
def _derivative_of_powers(order: int, powers: int) -> tuple[np.ndarray, np.ndarray]:
    """(powers,) factors and exponents of the derivatives of 1, s, s², ..."""
    falling = np.array([math.perm(k, order) for k in range(powers)], dtype=float)
    return falling, np.maximum(np.arange(powers) - order, 0)


@cache
def hermite_matrix(orders: int) -> np.ndarray:
    """(2 orders, 2 orders) from a segment's boundary derivatives with respect to s to its coefficients.

    The boundary derivatives are the position and its derivatives below that order, at the start and then at the end.
    """
    to_boundary = np.array([power_basis(order, s, 2 * orders) for s in (0.0, 1.0) for order in range(orders)])
    # The inverse holds integers over this factorial; rounding to them removes the error of the inversion.
    denominator = math.factorial(orders - 1)
    return np.asarray(np.round(denominator * np.linalg.inv(to_boundary)) / denominator)


def hermite_path(times: np.ndarray, derivatives: np.ndarray) -> PolynomialPath:
    """Returns the path with given derivatives at its knots.

    Args:
        times: (knots,) increasing, s.
        derivatives: (knots, orders, axes) position and derivatives below that order, in m and s.
    """
    orders = derivatives.shape[1]
    scale = np.diff(times)[:, np.newaxis, np.newaxis] ** np.arange(orders)[:, np.newaxis]
    boundary = np.concatenate([derivatives[:-1] * scale, derivatives[1:] * scale], axis=1)
    # Relative to the start, so that a position far from the origin costs the derivatives no digits.
    boundary[:, orders] -= boundary[:, 0]
    start, boundary[:, 0] = boundary[:, 0].copy(), 0.0
    coefficients = hermite_matrix(orders) @ boundary
    coefficients[:, 0] = start
    return PolynomialPath(times, coefficients)


def knots(path: PolynomialPath, orders: int) -> np.ndarray:
    """(knots, orders, axes) position and derivatives below that order at the times of the path: of `hermite_path`."""
    last = len(path.coefficients) - 1
    segment = np.append(np.arange(last + 1), last)
    s = np.append(np.zeros(last + 1), 1.0)
    return np.stack([evaluate_at(path, segment, s, order) for order in range(orders)], axis=1)


def path_derivative(path: PolynomialPath, order: int) -> PolynomialPath:
    """Returns the path's derivative in time, of a degree lower by the order."""
    powers = np.arange(path.coefficients.shape[1])
    falling = np.array([math.perm(k, order) for k in powers], dtype=float)[order:]
    scale = falling * path.durations[:, np.newaxis] ** -order
    return PolynomialPath(path.times, path.coefficients[:, order:] * scale[:, :, np.newaxis])


def evaluate(path: PolynomialPath, times: ArrayLike, order: int = 0) -> np.ndarray:
    """Returns the (axes, samples) derivative of that order in time; outside the path that at its nearer end.

    Args:
        path: to evaluate.
        times: (samples,), s.
        order: 0 for the position.
    """
    instants = np.clip(np.asarray(times, dtype=float), path.times[0], path.times[-1])
    segment = np.clip(np.searchsorted(path.times, instants, side="right") - 1, 0, len(path.coefficients) - 1)
    s = (instants - path.times[segment]) / path.durations[segment]
    return evaluate_at(path, segment, s, order).T


def evaluate_at(path: PolynomialPath, segment: np.ndarray, s: np.ndarray, order: int = 0) -> np.ndarray:
    """Returns the (samples, axes) derivative of that order in time at places (samples,) on segments (samples,)."""
    basis = power_basis(order, s, path.coefficients.shape[1])
    scale = path.durations[segment] ** -order
    return np.einsum("nk,nka->na", basis * scale[:, np.newaxis], path.coefficients[segment])


def refined(path: PolynomialPath, times: np.ndarray) -> PolynomialPath:
    """Returns the same path with further times (instants,), s, at which one polynomial ends and the next begins."""
    after = np.clip(np.searchsorted(path.times, times), 1, len(path.times) - 1)
    distance = np.minimum(np.abs(times - path.times[after - 1]), np.abs(times - path.times[after]))
    inside = (times > path.times[0]) & (times < path.times[-1])
    # Times that differ by rounding only are one.
    joined = np.union1d(path.times, times[inside & (distance > 1e-9 * path.durations.min())])
    segment = np.searchsorted(path.times, joined[:-1], side="right") - 1
    duration = path.durations[segment]
    start, share = (joined[:-1] - path.times[segment]) / duration, np.diff(joined) / duration
    # p(start + share u) by its Taylor series in u; a piece that is a whole segment keeps its coefficients.
    powers = path.coefficients.shape[1]
    taylor = np.stack([power_basis(k, start, powers) / math.factorial(k) for k in range(powers)], axis=1)
    taylor *= share[:, np.newaxis, np.newaxis] ** np.arange(powers)[:, np.newaxis]
    return PolynomialPath(joined, taylor @ path.coefficients[segment])


def norm_peaks(path: PolynomialPath, order: int) -> Peaks:
    """Returns the local maxima of the norm of the derivative of that order, and its values at the segments' ends."""
    components = path_derivative(path, order).coefficients
    powers = components.shape[1]
    # Of half the square of the norm: the product of two polynomials, axis by axis.
    rates = components[:, 1:] * np.arange(1.0, powers)[:, np.newaxis]
    slopes = np.zeros((len(components), 2 * powers - 2))
    for power in range(powers):
        slopes[:, power : power + powers - 1] += np.einsum("na,nka->nk", components[:, power], rates)

    def slope(segment: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nk->n", power_basis(0, s, 2 * powers - 2), slopes[segment])

    segment, s = _maxima(slopes @ power_basis(0, _SAMPLES, 2 * powers - 2).T, slope)
    every = np.arange(len(components))
    segment = np.concatenate([segment, every, every])
    s = np.concatenate([s, np.zeros(len(every)), np.ones(len(every))])
    return Peaks(segment, s, evaluate_at(path, segment, s, order))


def peak_norm(path: PolynomialPath, order: int) -> float:
    """Returns the largest norm of the path's derivative of that order, over all time and to rounding error."""
    return float(norm_peaks(path, order).norm.max())


def turning_points(path: PolynomialPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the inner points at which the position turns back along an axis: segment, axis and s, each (points,).

    Two points in one of `NUM_CELLS` cells of a segment are not found, nor one in a cell that begins or ends at rest.
    There, the axis turns back by at most M h³ / 12, where M is the largest third derivative with respect to s, and h is
    the width of a cell.
    """
    segments, powers, axes = path.coefficients.shape
    rows = path.coefficients.transpose(0, 2, 1).reshape(segments * axes, powers)
    # As largest value of the position, and of its mirror image.
    row, s, _ = summits(np.concatenate([rows, -rows]))
    segment, axis = np.divmod(row % len(rows), axes)
    return segment, axis, s


def summits(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns row, s and value of the inner maxima of polynomials on [0, 1], each (maxima,).

    Args:
        rows: (rows, powers) coefficients, from the constant on.
    """
    powers = rows.shape[1]

    def slope(row: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nk->n", power_basis(1, s, powers), rows[row])

    row, s = _maxima(rows @ power_basis(1, _SAMPLES, powers).T, slope)
    return row, s, np.einsum("nk,nk->n", power_basis(0, s, powers), rows[row])


def _maxima(slopes: np.ndarray, slope: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and places at which functions on [0, 1] have maxima, from their (rows, samples) slopes."""
    row, sample = np.nonzero((slopes[:, :-1] > 0.0) & (slopes[:, 1:] <= 0.0))
    low, high = _SAMPLES[sample], _SAMPLES[sample + 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        rising = slope(row, middle) > 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    return row, 0.5 * (low + high)
