"""When to pass the waypoints, by rule: riding along the chords, or stopping everywhere; and a stretch to the limits."""

import math

import numpy as np

from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.polynomial_path import PolynomialPath, peak_norm

# Peaks of speed and acceleration of the minimum-snap path from rest to rest over one metre in one second: 35/16 at the
# middle, and 84 √5 / 25 at s = (5 - √5) / 10.
_REST_TO_REST_PEAKS = {1: 35.0 / 16.0, 2: 84.0 * math.sqrt(5.0) / 25.0}


def trapezoid_times(waypoints: np.ndarray, *, speed: float, acceleration: float) -> np.ndarray:
    """Returns the (segments + 1,) times of a ride along the chords with a trapezoidal speed profile, s.

    The ride starts and ends at rest, and never slows down in between: it is a heuristic for `minimum_snap`, whose
    path then has peaks above these numbers; `stretch_factor` says what brings them down.

    Args:
        waypoints: (segments + 1, axes) points to pass, no two neighbours equal, m.
        speed: top of the trapezoid, m/s.
        acceleration: its slope at both ends, m/s².
    """
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
    total = distance[-1]
    # Below this length the profile is a triangle: the ride brakes before it has reached the speed.
    top = min(speed, math.sqrt(acceleration * total))
    ramp = top**2 / (2.0 * acceleration)
    duration = total / top + top / acceleration
    to_go = np.clip(total - distance, 0.0, None)
    speeding_up = np.sqrt(2.0 * distance / acceleration)
    cruising = top / (2.0 * acceleration) + distance / top
    slowing_down = duration - np.sqrt(2.0 * to_go / acceleration)
    return np.select([distance <= ramp, to_go <= ramp], [speeding_up, slowing_down], cruising)


def rest_to_rest_durations(waypoints: np.ndarray, limits: PathLimits) -> np.ndarray:
    """Returns the (segments,) durations with which a flight that stops at every waypoint just keeps to the limits, s.

    Args:
        waypoints: (segments + 1, axes) points to pass, no two neighbours equal, m.
        limits: one at least.
    """
    distance = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    demands = [
        (_REST_TO_REST_PEAKS[order] * distance / limit) ** (1.0 / order) for order, limit in limits.by_order.items()
    ]
    return np.asarray(np.max(demands, axis=0))


def stretch_factor(path: PolynomialPath, limits: PathLimits) -> float:
    """Returns how many times slower a path is to be flown so that one limit is attained and the other is kept.

    It is less than one for a path that stays below the limits.
    """
    return max((peak_norm(path, order) / limit) ** (1.0 / order) for order, limit in limits.by_order.items())
