"""Optimisation of waypoint times: the smallest snap for a given total time, or the shortest time within limits.

Both methods use exact gradients of the path without inequalities (`minimum_snap.MinimumSnap`) with respect to the
logarithms of the segments' durations. In logarithms, segments of 0.1 s and of 100 s have equal weight.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import scipy
from pydrake.solvers import ClpSolver, MathematicalProgram

from drake_quad.process_settings import single_threaded_blas
from drake_quad.reference.minimum_snap import DEGREE, FROM_BOUNDARY, Contact, MinimumSnap
from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.polynomial_path import norm_peaks, power_basis

# Largest change of the logarithm of a duration. Observed optima need smaller changes, and floating point is accurate
# enough up to this change.
_MAX_LOG_CHANGE = 5.0
# Radii of the trust region, as changes of the logarithm of a duration.
_INITIAL_TRUST_RADIUS = 0.3  # radius in the first step
_MAX_TRUST_RADIUS = 1.0  # the radius is not increased further
_MIN_TRUST_RADIUS = 1e-6  # the search ends if the radius is smaller
_MAX_STEPS = 60  # largest number of linear programs that are solved, one after another
# The optimisation ends when the predicted relative gain in the total duration is less than this.
_MIN_GAIN = 1e-4
# Weight of the excess over a limit, relative to the logarithm of the total duration, for a path that cannot be scaled
# in time. The weight is 1 for a path that can be scaled.
_EXCESS_WEIGHT = 10.0


def minimum_snap_durations(
    points: np.ndarray,
    durations: np.ndarray,
    derivatives: np.ndarray | None = None,
    *,
    contacts: Sequence[Contact] = (),
    max_log_change: float = _MAX_LOG_CHANGE,
) -> np.ndarray:
    """Return durations, (segments,) in s, that minimise the minimum-snap cost and have the given sum.

    The result is a local optimum of the logarithm of the cost, found with L-BFGS.

    Args:
        points: (segments + 1, axes) waypoints, m.
        durations: (segments,) initial durations, s.
        derivatives: derivatives that are given at the waypoints, as for `minimum_snap`.
        contacts: points at which the position along one direction is prescribed.
        max_log_change: largest change of the logarithm of a duration, before all durations are scaled to the given sum.
    """
    total = float(durations.sum())

    def with_same_sum(logarithms: np.ndarray) -> np.ndarray:
        weights = np.exp(logarithms - logarithms.max())
        return np.asarray(total * weights / weights.sum())

    best = math.inf, durations

    def logarithm_of_cost(logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal best
        durations = with_same_sum(logarithms)
        solution = MinimumSnap(points, durations, derivatives, contacts=contacts)
        value = math.log(solution.cost)
        best = min(best, (value, durations), key=lambda pair: pair[0])
        derivative = durations * solution.cost_gradient() / solution.cost
        return value, derivative - derivative.sum() * durations / total

    if len(durations) == 1 or MinimumSnap(points, durations, derivatives).cost == 0.0:
        return durations
    start = np.log(durations)
    bounds = [(x - max_log_change, x + max_log_change) for x in start]
    options = {"maxiter": 300, "maxfun": 600, "ftol": 1e-12, "gtol": 1e-8}
    # The durations can become so unequal that the matrix is not positive definite in floating point. The best durations
    # so far are then returned.
    with suppress(np.linalg.LinAlgError), single_threaded_blas():
        scipy.optimize.minimize(logarithm_of_cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return best[1]


def minimum_time_durations(
    points: np.ndarray,
    durations: np.ndarray,
    limits: PathLimits,
    derivatives: np.ndarray | None = None,
    *,
    contacts: Sequence[Contact] = (),
    max_log_change: float = math.inf,
) -> np.ndarray:
    """Return durations, (segments,) in s, with the smallest sum whose minimum-snap path satisfies the limits.

    The result is a local optimum. Each peak of speed or acceleration needs a certain slow-down factor to satisfy its
    limit. The method minimises the product of the largest factor and the total duration. It solves linear programs in a
    trust region, with exact gradients of the peaks. If nonzero derivatives are given, a path cannot be slowed down
    without changing its shape. The method then minimises a weighted sum of duration and excess, and some excess over
    the limits may remain.

    Args:
        points: (segments + 1, axes) waypoints, m.
        durations: (segments,) initial durations, s.
        limits: limits, of which at least one is finite.
        derivatives: derivatives that are given at the waypoints, as for `minimum_snap`.
        contacts: points at which the position along one direction is prescribed.
        max_log_change: largest change of the logarithms of the durations, before the final scaling.
    """
    stretchable = derivatives is None or not np.nan_to_num(derivatives).any()
    weight, floor = (1.0, -math.inf) if stretchable else (_EXCESS_WEIGHT, 0.0)

    def merit(durations: np.ndarray, excess: float) -> float:
        return math.log(durations.sum()) + weight * max(excess, floor)

    def peaks_of(durations: np.ndarray) -> _LimitPeaks:
        return _limit_peaks(MinimumSnap(points, durations, derivatives, contacts=contacts), limits)

    start = np.log(durations)
    radius = min(_INITIAL_TRUST_RADIUS, max_log_change)
    peaks = peaks_of(durations)
    for _ in range(_MAX_STEPS):
        value = merit(durations, peaks.worst)
        gradients = _excess_gradients(peaks)
        while True:
            log_change = np.log(durations) - start
            box = np.maximum(-radius, -max_log_change - log_change), np.minimum(radius, max_log_change - log_change)
            change, gain = _best_change(durations, peaks.excess, gradients, box=box, weight=weight, floor=floor)
            candidate = durations * np.exp(change)
            candidate_peaks = peaks_of(candidate)
            gain_ratio = (value - merit(candidate, candidate_peaks.worst)) / max(gain, 1e-300)
            if gain_ratio > 0.1 or radius < _MIN_TRUST_RADIUS or gain < _MIN_GAIN:
                break
            radius = float(np.abs(change).max()) / 3.0
        if gain_ratio > 0.0:
            durations, peaks = candidate, candidate_peaks
        if gain < _MIN_GAIN or radius < _MIN_TRUST_RADIUS:
            break
        radius = (
            min(2.0 * radius, _MAX_TRUST_RADIUS) if gain_ratio > 0.7 else radius / 2.0 if gain_ratio < 0.3 else radius
        )
    return durations * math.exp(peaks.worst) if stretchable else durations


class _LimitPeaks(NamedTuple):
    """Peaks of speed and acceleration along a path with limits.

    Attributes:
        solution: minimum-snap path.
        order: (peaks,) order of the derivative: 1 for speed, 2 for acceleration.
        segment: (peaks,) indices of the segments.
        s: (peaks,) unit times on the segments, 0 to 1.
        value: (peaks, axes) velocity or acceleration at the peaks, in m and s.
        excess: (peaks,) logarithm of the factor on the durations at which the peak equals its limit; positive if the
            peak exceeds the limit.
    """

    solution: MinimumSnap
    order: np.ndarray
    segment: np.ndarray
    s: np.ndarray
    value: np.ndarray
    excess: np.ndarray

    @property
    def worst(self) -> float:
        """Largest excess."""
        return float(self.excess.max(initial=-math.inf))


def _limit_peaks(solution: MinimumSnap, limits: PathLimits) -> _LimitPeaks:
    """Return the nonzero peaks of the quantities that have a limit, speed or acceleration or both."""
    path = solution.path()
    parts = []
    for order, limit in limits.by_order.items():
        peaks = norm_peaks(path, order)
        norm = peaks.norm
        is_moving = norm > 0.0
        excess = np.log(norm[is_moving] / limit) / order
        orders = np.full(len(excess), order)
        parts.append((orders, peaks.segment[is_moving], peaks.s[is_moving], peaks.value[is_moving], excess))
    return _LimitPeaks(solution, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _excess_gradients(peaks: _LimitPeaks) -> np.ndarray:
    """Return the (peaks, segments) derivatives of the excess with respect to the logarithms of the durations.

    If the durations change, a peak also moves along the path, but to first order this does not change its height.
    """
    solution = peaks.solution
    boundary_gradient = solution.boundary_gradient()
    bases = {order: power_basis(order, peaks.s, DEGREE + 1) for order in (1, 2)}
    basis = np.where(peaks.order[:, np.newaxis] == 1, bases[1], bases[2]) @ FROM_BOUNDARY
    scale = solution.durations[peaks.segment] ** -peaks.order.astype(float)
    gradient = np.einsum("m,mk,mkaj->maj", scale, basis, boundary_gradient[peaks.segment])
    gradient[np.arange(len(basis)), :, peaks.segment] -= peaks.order[:, np.newaxis] * peaks.value
    square = np.einsum("ma,ma->m", peaks.value, peaks.value)
    return np.asarray(np.einsum("ma,maj->mj", peaks.value, gradient) / (peaks.order * square)[:, np.newaxis])


def _best_change(
    durations: np.ndarray,
    excess: np.ndarray,
    gradients: np.ndarray,
    *,
    box: tuple[np.ndarray, np.ndarray],
    weight: float,
    floor: float,
) -> tuple[np.ndarray, float]:
    """Return the change (segments,) of the log-durations that is optimal in the linear model, and the predicted gain.

    Args:
        durations: (segments,) present durations, s.
        excess: (peaks,) excess of each peak.
        gradients: (peaks, segments) derivatives of the excess.
        box: lower and upper bounds of the change, each (segments,).
        weight: weight of the largest excess.
        floor: excess below which a further reduction has no benefit.
    """
    low, high = box
    worst = max(float(excess.max()), floor)
    # A peak is irrelevant if its largest possible value is below the smallest possible value of another peak.
    max_change = np.abs(gradients) @ np.maximum(-low, high)
    is_relevant = excess + max_change >= max(float((excess - max_change).max()), floor)
    segments = len(durations)
    derivative = np.append(durations / durations.sum(), weight)
    rows = np.column_stack([gradients[is_relevant], np.full(int(is_relevant.sum()), -1.0)])
    # SciPy's linprog takes 5 to 18 times as long for such small programs.
    program = MathematicalProgram()
    x = program.NewContinuousVariables(segments + 1)
    program.AddLinearCost(derivative, 0.0, x)
    program.AddLinearConstraint(rows, np.full(len(rows), -math.inf), worst - excess[is_relevant], x)
    program.AddBoundingBoxConstraint(np.append(low, floor - worst), np.append(high, math.inf), x)
    result = ClpSolver().Solve(program)
    if not result.is_success():
        return np.zeros(segments), 0.0
    return result.GetSolution(x)[:segments], -result.get_optimal_cost()
