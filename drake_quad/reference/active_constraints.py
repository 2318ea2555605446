"""Active constraints of a path: the limits that it attains, and the walls of corridors that it touches."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.polynomial_path import PolynomialPath, norm_peaks
from drake_quad.reference.regions import Corridor
from drake_quad.reference.walls import wall_approaches

# A constraint is active if the path comes closer to a limit or a wall than this tolerance, relative to the limit or to
# the largest extent of the corridor.
_RELATIVE_TOLERANCE = 1e-3


class ActiveConstraint(NamedTuple):
    """Constraint that is active at a point of a path.

    Attributes:
        quantity: type of the constraint: "speed", "acceleration" or "corridor".
        location: wall of the corridor, such as "y max" or "face 0"; empty for a limit.
        segment: index of the segment.
        time: time at which the constraint is active, s.
    """

    quantity: str
    location: str
    segment: int
    time: float


def active_constraints(
    path: PolynomialPath, limits: PathLimits, corridors: Sequence[Corridor | None] = ()
) -> list[ActiveConstraint]:
    """Return the active constraints of a path, in order of time.

    Args:
        path: path of the position.
        limits: limits of speed and acceleration.
        corridors: corridor of each segment, None for a segment without a corridor; empty if there are no corridors.
    """
    active = [*_active_limits(path, limits), *_active_walls(path, corridors)]
    return sorted(active, key=lambda constraint: constraint.time)


def _active_limits(path: PolynomialPath, limits: PathLimits) -> list[ActiveConstraint]:
    """Return the peaks of speed and acceleration at which a path attains its limit."""
    active = []
    for order, limit in limits.by_order.items():
        peaks = norm_peaks(path, order)
        for i in np.flatnonzero(peaks.norm >= (1.0 - _RELATIVE_TOLERANCE) * limit):
            segment, s = int(peaks.segment[i]), float(peaks.s[i])
            active.append(ActiveConstraint(("speed", "acceleration")[order - 1], "", segment, _time(path, segment, s)))
    return active


def _active_walls(path: PolynomialPath, corridors: Sequence[Corridor | None]) -> list[ActiveConstraint]:
    """Return the points at which a path touches a wall of a corridor."""
    active = []
    for approach in wall_approaches(path, corridors):
        for side, clearance in (("min", approach.position - approach.low), ("max", approach.high - approach.position)):
            if clearance < _RELATIVE_TOLERANCE * approach.size:
                # A face of a polytope has no lower bound, so its name needs no side.
                where = f"{approach.wall} {side}" if np.isfinite(approach.low) else approach.wall
                active.append(
                    ActiveConstraint("corridor", where, approach.segment, _time(path, approach.segment, approach.s))
                )
    return active


def _time(path: PolynomialPath, segment: int, s: float) -> float:
    """Return the time (s) of a point, given its segment and its unit time on the segment, 0 to 1."""
    return float(path.times[segment] + s * (path.times[segment + 1] - path.times[segment]))
