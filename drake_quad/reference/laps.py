"""Paths with several laps: they begin at rest, are periodic, and end at rest.

The laps between the first and the last are identical. Each is the minimum-snap path with periodic ends: velocity,
acceleration and jerk at the seam, the point between two laps, are chosen so that the fourth to sixth derivatives are
continuous there, as at any other waypoint. The first lap begins at rest and the last lap ends at rest, and both share
the motion of the other laps at the seam. Three derivatives are therefore continuous along the whole path, and a
controller that learns in one lap can use the result in the next.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.reference.minimum_snap import MinimumSnap, rest_at_ends
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at

# For velocity, acceleration and jerk at the seam: order of the derivative that is continuous there if this quantity is
# free.
_CONTINUOUS_ORDERS = np.array([6, 5, 4])


class LapDurations(NamedTuple):
    """Segment durations of the first, the middle and the last laps, (segments,) arrays in s.

    Attributes:
        first: durations of the segments before the first lap and in the first lap.
        between: durations of the segments in each lap between the first and the last.
        last: durations of the segments in the last lap.
    """

    first: np.ndarray
    between: np.ndarray
    last: np.ndarray


def path_of_laps(
    waypoints: np.ndarray, durations: LapDurations, laps: int, *, lead: int = 0, stops: np.ndarray | None = None
) -> tuple[PolynomialPath, tuple[float, ...]]:
    """Return the path of several laps, the start time of each lap, and the end time of the last lap, s.

    Args:
        waypoints: (segments + 1, axes) points to pass, m. The last point equals the point with the index `lead`.
        durations: durations of the segments.
        laps: number of laps, two or more.
        lead: number of segments before the first lap.
        stops: (segments + 1,) True for a waypoint at which velocity, acceleration and jerk are zero. The path also
            rests at both ends. If the entry of the last waypoint is True, the path also rests between laps.
    """
    axes, lap = waypoints.shape[1], waypoints[lead:]
    free = np.full((len(waypoints), 3, axes), np.nan)
    if stops is not None:
        free[stops] = 0.0
    at_rest = rest_at_ends(2, axes)
    seam = periodic_boundary_derivatives(lap, durations.between, free[lead:])
    laps_in_order = [_between(waypoints, durations.first, free, at_rest[0], seam)]
    laps_in_order += [_between(lap, durations.between, free[lead:], seam, seam)] * (laps - 2)
    laps_in_order += [_between(lap, durations.last, free[lead:], seam, at_rest[0])]
    durations_of_parts = np.concatenate([np.diff(part.times) for part in laps_in_order])
    times = np.concatenate([[0.0], np.cumsum(durations_of_parts)])
    path = PolynomialPath(times, np.concatenate([part.coefficients for part in laps_in_order]))
    starts = lead + (len(lap) - 1) * np.arange(laps + 1)
    return path, tuple(times[starts].tolist())


def periodic_boundary_derivatives(points: np.ndarray, durations: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """Return the (3, axes) velocity, acceleration and jerk between two laps of the periodic minimum-snap path.

    Args:
        points: (segments + 1, axes) waypoints of a lap, m; the last waypoint equals the first.
        durations: (segments,) durations, s.
        derivatives: (segments + 1, 3, axes) derivatives as for `minimum_snap`. The derivatives at the last waypoint
            apply between two laps.
    """
    given = derivatives[-1]
    unknown = np.isnan(given).any(axis=1)
    start = np.where(np.isnan(given), 0.0, given)

    def jump(seam: np.ndarray) -> np.ndarray:
        """Return the (unknown, axes) jumps of the fourth to sixth derivatives at the seam, which must be zero."""
        path = _between(points, durations, derivatives, seam, seam)
        first, last = np.array([0]), np.array([len(durations) - 1])
        return np.concatenate(
            [
                evaluate_at(path, first, np.zeros(1), order) - evaluate_at(path, last, np.ones(1), order)
                for order in _CONTINUOUS_ORDERS[unknown]
            ]
        )

    if not unknown.any():
        return start
    # The jumps are linear functions of the derivatives at the seam, with the same coefficients on all axes. One trial
    # for each unknown derivative gives these coefficients. The mean duration is the unit of time, so the trials have
    # similar magnitudes.
    unit = durations.mean() ** -np.arange(1.0, 4.0)[unknown]
    initial_jump = jump(start)
    responses = []
    for order, size in zip(np.flatnonzero(unknown), unit, strict=True):
        trial = start.copy()
        trial[order] += size
        responses.append((jump(trial) - initial_jump).mean(axis=1))
    start[unknown] += unit[:, np.newaxis] * np.linalg.solve(np.transpose(responses), -initial_jump)
    return start


def _between(
    points: np.ndarray, durations: np.ndarray, derivatives: np.ndarray, start: np.ndarray, end: np.ndarray
) -> PolynomialPath:
    """Return the minimum-snap path with given velocity, acceleration and jerk (3, axes) at its start and its end."""
    given = derivatives.copy()
    given[0], given[-1] = start, end
    return MinimumSnap(points, durations, given).path()
