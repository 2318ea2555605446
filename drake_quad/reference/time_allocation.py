"""Heuristic waypoint times: trapezoidal speed profile, stops at every waypoint, and scaling to the limits."""

import math

import numpy as np

from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.polynomial_path import PolynomialPath, peak_norm

# Peak speed (order 1) and peak acceleration (order 2) of the minimum-snap path from rest to rest over one metre in one
# second. The speed peaks at the middle, and the acceleration at s = (5 - √5) / 10.
_REST_TO_REST_PEAKS = {1: 35.0 / 16.0, 2: 84.0 * math.sqrt(5.0) / 25.0}


def trapezoid_times(waypoints: np.ndarray, *, speed: float, acceleration: float) -> np.ndarray:
    """Return the waypoint times, (segments + 1,) in s, of a trapezoidal speed profile along the polyline.

    The profile starts and ends at rest and does not slow down at waypoints in between. It is a heuristic: a
    `minimum_snap` path with these times has larger peaks of speed and acceleration than the profile. `stretch_factor`
    returns the factor on the durations that reduces these peaks to the limits.

    Args:
        waypoints: (segments + 1, axes) points to pass, m; successive points must differ.
        speed: largest speed of the profile, m/s.
        acceleration: acceleration at both ends of the profile, m/s².
    """
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
    total = distance[-1]
    # On a short route the speed profile is a triangle, since braking must begin before the top speed is reached.
    top = min(speed, math.sqrt(acceleration * total))
    ramp = top**2 / (2.0 * acceleration)
    duration = total / top + top / acceleration
    remaining = np.clip(total - distance, 0.0, None)
    speeding_up = np.sqrt(2.0 * distance / acceleration)
    cruising = top / (2.0 * acceleration) + distance / top
    slowing_down = duration - np.sqrt(2.0 * remaining / acceleration)
    return np.select([distance <= ramp, remaining <= ramp], [speeding_up, slowing_down], cruising)


def rest_to_rest_durations(waypoints: np.ndarray, limits: PathLimits) -> np.ndarray:
    """Return the shortest segment durations, (segments,) in s, for a flight within limits that stops at every waypoint.

    Args:
        waypoints: (segments + 1, axes) points to pass, m; successive points must differ.
        limits: limits on speed and acceleration, at least one of them finite.
    """
    distance = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    demands = [
        (_REST_TO_REST_PEAKS[order] * distance / limit) ** (1.0 / order) for order, limit in limits.by_order.items()
    ]
    return np.asarray(np.max(demands, axis=0))


def stretch_factor(path: PolynomialPath, limits: PathLimits) -> float:
    """Return the smallest factor on all durations with which a path satisfies its speed and acceleration limits.

    The factor is less than 1 for a path that stays below its limits.
    """
    return max((peak_norm(path, order) / limit) ** (1.0 / order) for order, limit in limits.by_order.items())
