"""Explanations for an infeasible path: the violated limit or corridor, the segment, the excess, and a remedy."""

import math

import numpy as np

from drake_quad.reference.minimum_snap_program import (
    PLANNING_ERRORS,
    WALL_MARGIN,
    MinimumSnapProgram,
    RelaxedBounds,
    constrained_minimum_snap,
)
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.polynomial_path import PolynomialPath, norm_peaks
from drake_quad.reference.time_allocation import stretch_factor
from drake_quad.reference.walls import wall_approaches

# Factors on the durations that are tried in this order if a sufficient factor cannot be estimated.
_TRIED_FACTORS = (1.05, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0)
_NUM_BISECTIONS = 10  # steps of the search for the smallest factor on the durations at which a path exists
_QUANTITY_AND_UNIT = {1: ("speed", "m/s"), 2: ("acceleration", "m/s²")}  # keyed by the order of the derivative


def explain_infeasibility(problem: PathProblem, durations: np.ndarray) -> str:
    """Explain in one sentence why no path satisfies the constraints for the given durations, (segments,) in s."""
    try:
        unlimited = constrained_minimum_snap(problem.without_limits(), durations)
    except PLANNING_ERRORS:
        return _explain_corridors(problem, durations)
    if not problem.limits.by_order:
        # The call above found a path, so no constraint is violated. The solver failed only for the original problem.
        return "there is a path, but the solver failed to find it; move a waypoint slightly, or change the times"
    try:
        least_excess = MinimumSnapProgram(problem, durations, slack=RelaxedBounds.LIMITS).solve()
        violation = _describe_violation(problem, least_excess, "at least {} is needed")
    except PLANNING_ERRORS:
        # The solver failed for the relaxed problem, so the message describes the path that was planned without limits.
        violation = _describe_violation(problem, unlimited, "the smoothest path needs {}")
    slower = _slower_factor(problem, durations, stretch_factor(unlimited, problem.limits))
    if slower is None:
        return f"{violation}; no slower flight was found that satisfies the derivatives given at the waypoints"
    return f"{violation}; the flight is feasible if all durations are multiplied by {slower:.3g}"


def _describe_violation(problem: PathProblem, path: PolynomialPath, need: str) -> str:
    """Return a sentence that names the most violated limit, its segment, and the value that the path would need.

    Args:
        problem: problem with limits.
        path: path that violates a limit.
        need: part of the sentence that states this value, with {} for the value and its unit.
    """
    violations = []
    for order, limit in problem.limits.by_order.items():
        peaks = norm_peaks(path, order)
        i = int(np.argmax(peaks.norm))
        violations.append((peaks.norm[i] / limit, order, int(peaks.segment[i]), float(peaks.norm[i])))
    _, order, segment, value = max(violations)
    name, unit = _QUANTITY_AND_UNIT[order]
    return (
        f"the {name} limit of {problem.limits.by_order[order]:g} {unit} cannot be kept on segment {segment}: "
        f"at these times {need.format(f'{_rounded_up(value):g} {unit}')}"
    )


def _slower_factor(problem: PathProblem, durations: np.ndarray, sufficient_factor: float) -> float | None:
    """Return a factor on all durations that makes the problem feasible, rounded up to three digits, or None.

    Args:
        problem: problem that is infeasible for these durations.
        durations: (segments,) durations, s.
        sufficient_factor: factor with which the path that was planned without limits satisfies the limits. It is used
            if all given derivatives are zero, since the shape of the path then does not depend on the factor.
    """

    def feasible(factor: float) -> bool:
        try:
            constrained_minimum_snap(problem, factor * durations)
        except PLANNING_ERRORS:
            return False
        return True

    low = 1.0
    factors = (1.001 * sufficient_factor,) if problem.is_time_scalable else _TRIED_FACTORS
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
    """Return a sentence that names the corridor that the path must leave, and the missing width of the corridor."""
    unknown = "no path was found that satisfies the corridors and the derivatives given at the waypoints at these times"
    relaxed = MinimumSnapProgram(problem.without_limits(), durations, slack=RelaxedBounds.CORRIDORS)
    try:
        path = relaxed.solve()
    except PLANNING_ERRORS:
        return unknown
    worst = min(wall_approaches(path, problem.corridors), key=lambda approach: approach.clearance, default=None)
    if worst is None or worst.clearance >= 0.0:
        # The relaxed path stays in the corridors, so a path exists and only the solver failed.
        return unknown
    missing_width = WALL_MARGIN * worst.size - worst.clearance
    return (
        f"the path cannot stay in the corridor of segment {worst.segment} at these times with the derivatives given at"
        f" the waypoints: the corridor would have to be {_rounded_up(missing_width):g} m wider"
    )


def _rounded_up(value: float) -> float:
    """Return a positive number, rounded up to three significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / unit * (1.0 - 1e-12)) * unit
