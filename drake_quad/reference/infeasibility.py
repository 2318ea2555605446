"""Explanations for an infeasible path: the violated limit or corridor, the segment, the excess, and a remedy."""

import math

import numpy as np

from drake_quad.reference.minimum_snap_program import (
    PLANNING_ERRORS,
    WALL_MARGIN,
    MinimumSnapProgram,
    RelaxedBounds,
    path_within,
)
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.polynomial_path import PolynomialPath, norm_peaks
from drake_quad.reference.time_allocation import stretch_factor
from drake_quad.reference.walls import wall_approaches

# Factors on the durations that are tried if the necessary factor cannot be estimated.
_TRIED_FACTORS = (1.05, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0)
_NUM_BISECTIONS = 10  # number of bisections for the smallest sufficient factor
_QUANTITY_AND_UNIT = {1: ("speed", "m/s"), 2: ("acceleration", "m/s²")}


def explain_infeasibility(problem: PathProblem, durations: np.ndarray) -> str:
    """Return a sentence that says why no path satisfies the constraints for given durations (segments,), s."""
    try:
        unlimited = path_within(problem.without_limits(), durations)
    except PLANNING_ERRORS:
        return _explain_corridors(problem, durations)
    if not problem.limits.by_order:
        # Without limits, both problems are the same, but this time the solver succeeded.
        return "there is a path, but the solver failed to find it; move a waypoint slightly, or change the times"
    try:
        least_excess = MinimumSnapProgram(problem, durations, slack=RelaxedBounds.LIMITS).solve()
        complaint = _describe_violation(problem, least_excess, "at least")
    except PLANNING_ERRORS:
        # The solver failed, so the message describes the path without limits.
        complaint = _describe_violation(problem, unlimited, "by the smoothest path")
    slower = _slower_factor(problem, durations, stretch_factor(unlimited, problem.limits))
    if slower is None:
        return f"{complaint}; no slower flight was found that satisfies the derivatives given at the waypoints"
    return f"{complaint}; flown {slower:.3g} times slower, it is feasible"


def _describe_violation(problem: PathProblem, path: PolynomialPath, qualifier: str) -> str:
    """Return a sentence with the limit that a path violates most, the segment, and the value that would be needed."""
    violations = []
    for order, limit in problem.limits.by_order.items():
        peaks = norm_peaks(path, order)
        i = int(np.argmax(peaks.norm))
        violations.append((peaks.norm[i] / limit, order, int(peaks.segment[i]), float(peaks.norm[i])))
    _, order, segment, value = max(violations)
    name, unit = _QUANTITY_AND_UNIT[order]
    return (
        f"the {name} limit of {problem.limits.by_order[order]:g} {unit} cannot be kept on segment {segment}: "
        f"at these times {qualifier} {_rounded_up(value):g} {unit} is needed"
    )


def _slower_factor(problem: PathProblem, durations: np.ndarray, enough: float) -> float | None:
    """Return the factor on all durations that makes the problem feasible, rounded up to three digits, or None.

    Args:
        problem: problem that is infeasible for these durations.
        durations: (segments,) durations, s.
        enough: factor with which a path without limits satisfies the limits. It is used if no motion is given at the
            waypoints, since the path can then be slowed down without changing its shape.
    """

    def feasible(factor: float) -> bool:
        try:
            path_within(problem, factor * durations)
        except PLANNING_ERRORS:
            return False
        return True

    low = 1.0
    factors = (1.001 * enough,) if problem.stretchable else _TRIED_FACTORS
    for high in factors:
        if feasible(high):
            break
        low = high
    else:
        return None
    for _ in range(_NUM_BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return _rounded_up(high)


def _explain_corridors(problem: PathProblem, durations: np.ndarray) -> str:
    """Return a sentence with the corridor that cannot be kept, and the additional width that the path needs."""
    unknown = "no path was found that satisfies the corridors and the derivatives given at the waypoints at these times"
    relaxed = MinimumSnapProgram(problem.without_limits(), durations, slack=RelaxedBounds.CORRIDORS)
    try:
        path = relaxed.solve()
    except PLANNING_ERRORS:
        return unknown
    worst = min(wall_approaches(path, problem.corridors), key=lambda approach: approach.room, default=None)
    if worst is None or worst.room >= 0.0:
        # The relaxed path stays in the corridors, so the solver failed although a path exists.
        return unknown
    wider = WALL_MARGIN * worst.size - worst.room
    return (
        f"the corridor of segment {worst.segment} cannot be kept at these times with the derivatives given at the"
        f" waypoints: it would have to be {_rounded_up(wider):g} m wider"
    )


def _rounded_up(value: float) -> float:
    """Return a positive number, rounded up to three significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / unit * (1.0 - 1e-12)) * unit
