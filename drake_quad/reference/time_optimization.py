"""When to pass the waypoints, optimised: for the least snap in a given time, or for the least time within limits.

Both follow exact gradients of the fast path (`minimum_snap.MinimumSnap`) with respect to the logarithms of the
segments' durations, so that a segment of 0.1 s counts as much as one of 100 s.
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

# Logarithms of how far durations may move from where they start: far beyond what any optimum was seen to need, and
# short of where floating point ends.
_REACH = 5.0
_FIRST_STEP, _LARGEST_STEP, _SMALLEST_STEP = 0.3, 1.0, 1e-6
_STEPS = 60
# A step that promises less than this share of the total duration is not worth taking.
_LEAST_GAIN = 1e-4
# What a unit of a limit's logarithmic excess costs where a path cannot be stretched at will, in units of the logarithm
# of the total duration; a stretch buys one for one.
_PRICE = 10.0


def least_snap_durations(
    points: np.ndarray,
    durations: np.ndarray,
    derivatives: np.ndarray | None = None,
    *,
    contacts: Sequence[Contact] = (),
    reach: float = _REACH,
) -> np.ndarray:
    """Return the durations (segments,) with the same sum that minimise the cost of the minimum-snap path, s.

    The result is a local optimum of the logarithm of the cost, found with L-BFGS.

    Args:
        points: (segments + 1, axes) waypoints, m.
        durations: (segments,) initial durations, s.
        derivatives: derivatives that are given at the waypoints, as for `minimum_snap`.
        contacts: further conditions on the path.
        reach: largest change of the logarithms of the durations, before these are scaled to their sum.
    """
    total = float(durations.sum())

    def shared(logarithms: np.ndarray) -> np.ndarray:
        weights = np.exp(logarithms - logarithms.max())
        return np.asarray(total * weights / weights.sum())

    best = math.inf, durations

    def logarithm_of_cost(logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal best
        durations = shared(logarithms)
        solution = MinimumSnap(points, durations, derivatives, contacts=contacts)
        value = math.log(solution.cost)
        best = min(best, (value, durations), key=lambda pair: pair[0])
        slope = durations * solution.cost_gradient() / solution.cost
        return value, slope - slope.sum() * durations / total

    if len(durations) == 1 or MinimumSnap(points, durations, derivatives).cost == 0.0:
        return durations
    start = np.log(durations)
    bounds = [(x - reach, x + reach) for x in start]
    options = {"maxiter": 300, "maxfun": 600, "ftol": 1e-12, "gtol": 1e-8}
    # A step of the search may reach durations so unequal that the form is no longer positive definite in floating
    # point; what was found before stands.
    with suppress(np.linalg.LinAlgError), single_threaded_blas():
        scipy.optimize.minimize(logarithm_of_cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return best[1]


def shortest_durations(
    points: np.ndarray,
    durations: np.ndarray,
    limits: PathLimits,
    derivatives: np.ndarray | None = None,
    *,
    contacts: Sequence[Contact] = (),
    reach: float = math.inf,
) -> np.ndarray:
    """Returns (segments,) durations of least sum whose minimum-snap path keeps to the limits, s.

    It is a local optimum. Every peak of speed or acceleration says by which factor the path would have to be stretched
    for that peak's sake; the largest of them times the total duration is minimised, by linear programs over the peaks'
    exact gradients within a trust region. If derivatives other than zero are given, which no stretch keeps, the excess
    over the limits is priced instead, and may remain.

    Args:
        points: (segments + 1, axes), m.
        durations: (segments,) where to start, s.
        limits: one at least.
        derivatives: given at the waypoints, as for `minimum_snap`.
        contacts: where the path is held too.
        reach: how far the logarithms of the durations may move, before a last stretch.
    """
    stretchable = derivatives is None or not np.nan_to_num(derivatives).any()
    price, floor = (1.0, -math.inf) if stretchable else (_PRICE, 0.0)

    def merit(durations: np.ndarray, excess: float) -> float:
        return math.log(durations.sum()) + price * max(excess, floor)

    def planned(durations: np.ndarray) -> _LimitPeaks:
        return _peaks(MinimumSnap(points, durations, derivatives, contacts=contacts), limits)

    start = np.log(durations)
    radius = min(_FIRST_STEP, reach)
    peaks = planned(durations)
    for _ in range(_STEPS):
        value = merit(durations, peaks.worst)
        gradients = _excess_gradients(peaks)
        while True:
            moved = np.log(durations) - start
            box = np.maximum(-radius, -reach - moved), np.minimum(radius, reach - moved)
            change, gain = _best_change(durations, peaks.excess, gradients, box=box, price=price, floor=floor)
            candidate = durations * np.exp(change)
            found = planned(candidate)
            share = (value - merit(candidate, found.worst)) / max(gain, 1e-300)
            if share > 0.1 or radius < _SMALLEST_STEP or gain < _LEAST_GAIN:
                break
            radius = float(np.abs(change).max()) / 3.0
        if share > 0.0:
            durations, peaks = candidate, found
        if gain < _LEAST_GAIN or radius < _SMALLEST_STEP:
            break
        radius = min(2.0 * radius, _LARGEST_STEP) if share > 0.7 else radius / 2.0 if share < 0.3 else radius
    return durations * math.exp(peaks.worst) if stretchable else durations


class _LimitPeaks(NamedTuple):
    """The peaks of a path under limits.

    Attributes:
        solution: the path.
        order: (peaks,) 1 for a peak of the speed, 2 for one of the acceleration.
        segment: (peaks,) where it is.
        s: (peaks,) where on the segment it is.
        value: (peaks, axes) the vector there, m and s.
        excess: (peaks,) logarithm of the stretch that would bring it to its limit.
    """

    solution: MinimumSnap
    order: np.ndarray
    segment: np.ndarray
    s: np.ndarray
    value: np.ndarray
    excess: np.ndarray

    @property
    def worst(self) -> float:
        return float(self.excess.max(initial=-math.inf))


def _peaks(solution: MinimumSnap, limits: PathLimits) -> _LimitPeaks:
    path = solution.path()
    parts = []
    for order, limit in limits.by_order.items():
        peaks = norm_peaks(path, order)
        norm = peaks.norm
        moving = norm > 0.0
        excess = np.log(norm[moving] / limit) / order
        orders = np.full(len(excess), order)
        parts.append((orders, peaks.segment[moving], peaks.s[moving], peaks.value[moving], excess))
    return _LimitPeaks(solution, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _excess_gradients(peaks: _LimitPeaks) -> np.ndarray:
    """(peaks, segments) derivatives of the excess with respect to the logarithms of the durations.

    A peak's place moves too, but to first order its height does not notice.
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
    price: float,
    floor: float,
) -> tuple[np.ndarray, float]:
    """(segments,) change of the logarithms within a box that the linear model likes best, and what it promises."""
    low, high = box
    worst = max(float(excess.max()), floor)
    # A peak that stays below what others fall to in the best case cannot matter.
    swing = np.abs(gradients) @ np.maximum(-low, high)
    matters = excess + swing >= max(float((excess - swing).max()), floor)
    segments = len(durations)
    slope = np.append(durations / durations.sum(), price)
    rows = np.column_stack([gradients[matters], np.full(int(matters.sum()), -1.0)])
    # For so few numbers SciPy's linprog takes five to eighteen times as long.
    program = MathematicalProgram()
    x = program.NewContinuousVariables(segments + 1)
    program.AddLinearCost(slope, 0.0, x)
    program.AddLinearConstraint(rows, np.full(len(rows), -math.inf), worst - excess[matters], x)
    program.AddBoundingBoxConstraint(np.append(low, floor - worst), np.append(high, math.inf), x)
    result = ClpSolver().Solve(program)
    if not result.is_success():
        return np.zeros(segments), 0.0
    return result.GetSolution(x)[:segments], -result.get_optimal_cost()
