"""Routes flown in laps: from rest into a path that repeats itself, and out of it to rest.

The laps in between are one and the same path, the minimum-snap path with periodic ends: velocity, acceleration and jerk
at the seam are those with which the fourth to sixth derivatives go on there, too, as at any waypoint. The first lap
begins at rest, the last one ends so, and both share the seam's motion with the others. So three derivatives are
continuous everywhere, and what is learned in one lap serves in the next.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.reference.minimum_snap import MinimumSnap, rest_at_ends
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at

# Of a free velocity, acceleration and jerk: the derivative that goes on where it is chosen best.
_ORDERS = np.array([6, 5, 4])


class LapDurations(NamedTuple):
    """(segments,) durations, s.

    Attributes:
        first: of the first lap, with what leads to it.
        between: of a lap in between.
        last: of the last lap.
    """

    first: np.ndarray
    between: np.ndarray
    last: np.ndarray


def flown_in_laps(
    waypoints: np.ndarray, durations: LapDurations, laps: int, *, lead: int = 0, stops: np.ndarray | None = None
) -> tuple[PolynomialPath, tuple[float, ...]]:
    """Returns the path of some laps, and when they begin and the last one ends, s.

    Args:
        waypoints: (segments + 1, axes) points to pass, m, the last one that with the number `lead`.
        durations: of the segments.
        laps: two or more.
        lead: how many segments lead to the first lap.
        stops: (segments + 1,) whether velocity, acceleration and jerk are zero at a waypoint; nowhere but at the first
            and the last by default. With a stop at the last one there is rest between laps.
    """
    axes, lap = waypoints.shape[1], waypoints[lead:]
    free = np.full((len(waypoints), 3, axes), np.nan)
    if stops is not None:
        free[stops] = 0.0
    at_rest = rest_at_ends(2, axes)
    seam = periodic_motion(lap, durations.between, free[lead:])
    parts = [_between(waypoints, durations.first, free, at_rest[0], seam)]
    parts += [_between(lap, durations.between, free[lead:], seam, seam)] * (laps - 2)
    parts += [_between(lap, durations.last, free[lead:], seam, at_rest[0])]
    every = np.concatenate([np.diff(part.times) for part in parts])
    times = np.concatenate([[0.0], np.cumsum(every)])
    path = PolynomialPath(times, np.concatenate([part.coefficients for part in parts]))
    starts = lead + (len(lap) - 1) * np.arange(laps + 1)
    return path, tuple(times[starts].tolist())


def periodic_motion(points: np.ndarray, durations: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """(3, axes) velocity, acceleration and jerk at both ends of a closed lap, flown again and again with least snap.

    Args:
        points: (segments + 1, axes), the last one the first, m.
        durations: (segments,), s.
        derivatives: (segments + 1, 3, axes) as for `minimum_snap`; those at the last waypoint are the seam's.
    """
    given = derivatives[-1]
    unknown = np.isnan(given).any(axis=1)
    start = np.where(np.isnan(given), 0.0, given)

    def jump(seam: np.ndarray) -> np.ndarray:
        """(unknown, axes) by how much the derivatives that shall go on do not."""
        path = _between(points, durations, derivatives, seam, seam)
        first, last = np.array([0]), np.array([len(durations) - 1])
        return np.concatenate(
            [
                evaluate_at(path, first, np.zeros(1), order) - evaluate_at(path, last, np.ones(1), order)
                for order in _ORDERS[unknown]
            ]
        )

    if not unknown.any():
        return start
    # The path is linear in the seam's motion, alike on all axes: trials of one unit each tell how. A unit of time as
    # long as a segment keeps them of one size.
    unit = durations.mean() ** -np.arange(1.0, 4.0)[unknown]
    before = jump(start)
    answers = []
    for place, size in zip(np.flatnonzero(unknown), unit, strict=True):
        trial = start.copy()
        trial[place] += size
        answers.append((jump(trial) - before).mean(axis=1))
    start[unknown] += unit[:, np.newaxis] * np.linalg.solve(np.transpose(answers), -before)
    return start


def _between(
    points: np.ndarray, durations: np.ndarray, derivatives: np.ndarray, start: np.ndarray, end: np.ndarray
) -> PolynomialPath:
    """The minimum-snap path with given motion (3, axes) at its start and its end."""
    given = derivatives.copy()
    given[0], given[-1] = start, end
    return MinimumSnap(points, durations, given).path()
