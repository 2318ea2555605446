"""Why there is no path: which limit, on which segment, by how much, and what would make it feasible."""

import math

import numpy as np

from drake_quad.reference.minimum_snap_program import (
    NO_PATH,
    WALL_MARGIN,
    MinimumSnapProgram,
    RelaxedBounds,
    path_within,
)
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.polynomial_path import PolynomialPath, norm_peaks
from drake_quad.reference.time_allocation import stretch_factor
from drake_quad.reference.walls import turns

# Slower flights that are tried where no rule says how much slower is enough.
_SLOWER = (1.05, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0)
_BISECTIONS = 10
_QUANTITIES = {1: ("speed", "m/s"), 2: ("acceleration", "m/s²")}


def explain(problem: PathProblem, durations: np.ndarray) -> str:
    """Returns a sentence on why no path keeps to a problem's demands at these durations (segments,), s."""
    try:
        unlimited = path_within(problem.without_limits(), durations)
    except NO_PATH:
        return _explain_corridors(problem, durations)
    if not problem.limits.by_order:
        # That began at points a little elsewhere.
        return "there is a path, but the solver gave up on the way to it; move a waypoint a little, or its times"
    try:
        least_excess = MinimumSnapProgram(problem, durations, slack=RelaxedBounds.LIMITS).solve()
        complaint = _broken_limit(problem, least_excess, "at least")
    except NO_PATH:
        # The numbers are beyond the solver; those of the path without limits are not.
        complaint = _broken_limit(problem, unlimited, "by the smoothest path")
    slower = _slower_factor(problem, durations, stretch_factor(unlimited, problem.limits))
    if slower is None:
        return f"{complaint}; no slower flight was found that keeps to what is given at the waypoints"
    return f"{complaint}; flown {slower:.3g} times slower it is feasible"


def _broken_limit(problem: PathProblem, path: PolynomialPath, how: str) -> str:
    """Names the limit and the segment that a path breaks most, and how much it needs there."""
    found = []
    for order, limit in problem.limits.by_order.items():
        peaks = norm_peaks(path, order)
        i = int(np.argmax(peaks.norm))
        found.append((peaks.norm[i] / limit, order, int(peaks.segment[i]), float(peaks.norm[i])))
    _, order, segment, value = max(found)
    name, unit = _QUANTITIES[order]
    return (
        f"the {name} limit of {problem.limits.by_order[order]:g} {unit} cannot be kept on segment {segment}: "
        f"at these times {how} {_rounded_up(value):g} {unit} is needed"
    )


def _slower_factor(problem: PathProblem, durations: np.ndarray, enough: float) -> float | None:
    """The factor of all durations that makes the problem feasible, rounded up to three digits; None if none does.

    Where no motion is given, `enough` is the factor by which a path without limits would have to be stretched.
    """

    def feasible(factor: float) -> bool:
        try:
            path_within(problem, factor * durations)
        except NO_PATH:
            return False
        return True

    low = 1.0
    tried = (1.001 * enough,) if problem.stretchable else _SLOWER
    for high in tried:
        if feasible(high):
            break
        low = high
    else:
        return None
    for _ in range(_BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return _rounded_up(high)


def _explain_corridors(problem: PathProblem, durations: np.ndarray) -> str:
    unknown = "no path was found that keeps to the corridors and to what is given at the waypoints at these times"
    relaxed = MinimumSnapProgram(problem.without_limits(), durations, slack=RelaxedBounds.CORRIDORS)
    try:
        path = relaxed.solve()
    except NO_PATH:
        return unknown
    worst = min(turns(path, problem.corridors), key=lambda turn: turn.room, default=None)
    if worst is None or worst.room >= 0.0:
        # There is one, but the solver gave up on it.
        return unknown
    wider = WALL_MARGIN * worst.size - worst.room
    return (
        f"the corridor of segment {worst.segment} cannot be kept at these times with what is given at the waypoints: "
        f"it would have to be {_rounded_up(wider):g} m wider"
    )


def _rounded_up(value: float) -> float:
    """The next larger number with three digits, of a positive one."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / unit * (1.0 - 1e-12)) * unit
