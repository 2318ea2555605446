"""Minimum-snap interpolation: the algebra, in segment-local unit time.

On segment i, of duration T_i, an axis flies p(s) = Σ c_k s^k, k = 0..7, with s = (t - t_i) / T_i in [0, 1]
(paper eq (20)). The cost is ∫ (d⁴p/dt⁴)² dt, summed over the segments (paper eqs (18), (19)).

A degree-7 segment is fixed by its boundary derivatives, position to jerk at both ends. Positions are the
waypoints; velocity, acceleration and jerk are zero at both ends of the path (paper, section on the trajectory);
what is left, three numbers a waypoint and axis in between, is shared by the two segments that meet there, so that
the path has three continuous derivatives by construction. The cost is a positive definite quadratic form in these
numbers whose matrix is block tridiagonal, so its minimum costs one banded Cholesky factorisation: linear in the
number of segments. At the minimum the fourth to sixth derivatives are continuous too (paper eq (21)).

Every quantity is scaled by the duration of the shorter segment that it touches, and the matrix to unit diagonal;
absolute time never enters. That keeps 0.2 s segments beside 20 s ones accurate.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_solve_banded, cholesky_banded

from drake_quad.errors import InputError

DEGREE = 7
FREE = 3  # velocity, acceleration, jerk: what a waypoint leaves free


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

    def stretched(self, factor: float) -> "PolynomialPath":
        """The same path flown `factor` times slower."""
        return PolynomialPath(self.times[0] + factor * (self.times - self.times[0]), self.coefficients)


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
    duration = path.durations[segment]
    s = (instants - path.times[segment]) / duration
    powers = path.coefficients.shape[1]
    falling = np.array([math.perm(k, order) for k in range(powers)], dtype=float)
    basis = falling[order:] * s[:, np.newaxis] ** np.arange(powers - order)
    return np.einsum("nk,nka->an", basis * duration[:, np.newaxis] ** -order, path.coefficients[segment, order:])


def boundary_derivatives(order: int, s: float) -> np.ndarray:
    """(8,) row that maps the coefficients to the derivative of that order with respect to s, at s = 0 or 1."""
    powers = np.arange(DEGREE + 1)
    row = np.array([math.perm(k, order) for k in powers], dtype=float)
    if s == 0.0:
        row[powers != order] = 0.0
    return row


def _snap_form() -> np.ndarray:
    """(8, 8) matrix of ∫₀¹ (d⁴p/ds⁴)² ds as a quadratic form in the coefficients."""
    falling = np.array([math.perm(k, 4) for k in range(DEGREE + 1)], dtype=float)
    exponent = np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1)) - 7.0
    return np.outer(falling, falling) / np.where(exponent > 0, exponent, 1.0)


SNAP_FORM = _snap_form()
_TO_BOUNDARY = np.array([boundary_derivatives(r, s) for s in (0.0, 1.0) for r in range(4)])
# The inverse holds sixths of integers only; rounding to them removes the error of the inversion.
_FROM_BOUNDARY = np.round(6.0 * np.linalg.inv(_TO_BOUNDARY)) / 6.0
_BOUNDARY_FORM = np.round(_FROM_BOUNDARY.T @ SNAP_FORM @ _FROM_BOUNDARY)
_START, _END = slice(1, 4), slice(5, 8)  # velocity to jerk within a segment's boundary derivatives


def minimum_snap(waypoints: ArrayLike, times: ArrayLike) -> PolynomialPath:
    """Returns the path of least integrated squared snap through waypoints at given times, at rest at both ends.

    This is the fast path: the same problem as `minimum_snap_program` without its inequalities.

    Args:
        waypoints: (segments + 1, axes) points to pass, m.
        times: (segments + 1,) when to pass them, strictly increasing, s.

    Raises:
        InputError: a shape does not fit, a number is not finite or the times do not increase.
    """
    points, times = checked_waypoints(waypoints, times)
    durations, steps = np.diff(times), np.diff(points, axis=0)
    boundary = np.zeros((len(steps), 8, points.shape[1]))
    boundary[:, 4] = steps
    if len(steps) > 1:
        scales = _waypoint_scales(durations)
        shared = _free_derivatives(scales, durations, steps)
        boundary[1:, _START] = shared * scales[1:, _START, np.newaxis]
        boundary[:-1, _END] = shared * scales[:-1, _END, np.newaxis]
    coefficients = _FROM_BOUNDARY @ boundary
    coefficients[:, 0] = points[:-1]
    return PolynomialPath(times, coefficients)


def snap_cost(path: PolynomialPath) -> np.ndarray:
    """Returns the (axes,) integrals of the squared snap over the path, m²/s⁷."""
    c = path.coefficients
    return np.einsum("nka,kl,nla,n->a", c, SNAP_FORM, c, path.durations**-7.0)


def checked_waypoints(waypoints: ArrayLike, times: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Returns both as float arrays, (segments + 1, axes) and (segments + 1,), or raises InputError."""
    points, instants = np.array(waypoints, dtype=float), np.array(times, dtype=float)
    if points.ndim != 2 or len(points) < 2 or instants.shape != (len(points),):
        raise InputError(
            f"waypoints of shape {points.shape} with times of shape {instants.shape}: "
            "two or more waypoints are needed, as rows, and one time for each"
        )
    if not (np.isfinite(points).all() and np.isfinite(instants).all()):
        raise InputError("waypoints and times must be finite numbers")
    late = np.flatnonzero(np.diff(instants) <= 0.0)
    if late.size:
        i = late[0]
        raise InputError(
            f"waypoint times must increase, but time {i + 1} is {instants[i + 1]:g} s after {instants[i]:g} s"
        )
    return points, instants


def _waypoint_scales(durations: np.ndarray) -> np.ndarray:
    """(segments, 8) factors from derivatives in a waypoint's own unit of time to those in the segment's.

    The waypoint's unit is the duration of the shorter of its two segments.
    """
    unit = np.minimum(durations[:-1], durations[1:])
    start = durations / np.concatenate([durations[:1], unit])
    end = durations / np.concatenate([unit, durations[-1:]])
    order = np.arange(4)
    return np.hstack([start[:, np.newaxis] ** order, end[:, np.newaxis] ** order])


def _free_derivatives(scales: np.ndarray, durations: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(segments - 1, 3, axes) velocity, acceleration and jerk at the inner waypoints, in the waypoints' units."""
    weight = (durations.min() / durations) ** 7.0
    form = _BOUNDARY_FORM * scales[:, :, np.newaxis] * scales[:, np.newaxis, :] * weight[:, np.newaxis, np.newaxis]
    diagonal = form[:-1, _END, _END] + form[1:, _START, _START]
    coupling = form[1:-1, _END, _START]
    # Position enters only through its change over the segment: the rows of the form cancel on constants.
    pull = -form[:, :, 4, np.newaxis] * steps[:, np.newaxis, :]
    right_side = (pull[:-1, _END] + pull[1:, _START]).reshape(FREE * len(diagonal), -1)

    size = len(right_side)
    bands = np.zeros((2 * FREE, size))
    for row in range(FREE):
        for column in range(FREE):
            if row >= column:
                bands[row - column, column::FREE] = diagonal[:, row, column]
            bands[FREE + row - column, column : size - FREE : FREE] = coupling[:, row, column]
    unit = 1.0 / np.sqrt(bands[0])
    for distance in range(min(2 * FREE, size)):
        bands[distance, : size - distance] *= unit[: size - distance] * unit[distance:]
    factor = cholesky_banded(bands, lower=True, check_finite=False)
    solution = cho_solve_banded((factor, True), right_side * unit[:, np.newaxis], check_finite=False)
    return (solution * unit[:, np.newaxis]).reshape(len(diagonal), FREE, -1)
