"""When to pass the waypoints: a trapezoidal speed profile, and a uniform stretch that meets limits exactly."""

import math

import numpy as np
from numpy.polynomial.polynomial import polyder
from numpy.typing import ArrayLike

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import PolynomialPath, evaluate, path_derivative

# Samples of a segment that bracket the peaks of a polynomial of degree 14 at most; at a peak the value depends on the
# square of an error of place, so this many bisections leave only rounding.
_SAMPLES = 48
_BISECTIONS = 24


def trapezoid_times(waypoints: ArrayLike, *, speed: float, acceleration: float) -> np.ndarray:
    """Returns the (segments + 1,) times of a ride along the chords with a trapezoidal speed profile, s.

    The ride starts and ends at rest, and never slows down in between: it is a heuristic for `minimum_snap`, whose
    path then has peaks above these numbers; `stretch_to_limits` brings them down.

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


def peak_norm(path: PolynomialPath, order: int) -> float:
    """Returns the largest norm of the path's derivative of that order, over all time and to rounding error."""
    components = path_derivative(path, order).coefficients
    width = 2 * components.shape[1] - 1
    square = np.zeros((len(components), width))
    for k in range(components.shape[1]):
        for j in range(components.shape[1]):
            square[:, k + j] += np.einsum("na,na->n", components[:, k], components[:, j])

    # Between two samples the square may rise to a peak and fall again: there its slope changes sign.
    grid = np.linspace(0.0, 1.0, _SAMPLES + 1)
    slope = polyder(square, axis=1)
    slopes = slope @ grid ** np.arange(width - 1)[:, np.newaxis]
    segment, sample = np.nonzero((slopes[:, :-1] > 0.0) & (slopes[:, 1:] < 0.0))
    low, high = grid[sample], grid[sample + 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        rising = _evaluate(slope[segment], middle) > 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    # The norm itself from the components: their squares' coefficients have lost some digits.
    start, duration = path.times[:-1], path.durations
    candidates = np.concatenate(
        [(start + duration * grid[:, np.newaxis]).ravel(), start[segment] + duration[segment] * 0.5 * (low + high)]
    )
    return float(np.linalg.norm(evaluate(path, candidates, order), axis=0).max())


def stretch_to_limits(path: PolynomialPath, *, top_speed: float, top_acceleration: float) -> PolynomialPath:
    """Returns the path flown uniformly slower or faster, so that one limit is attained and the other is kept.

    Args:
        path: a path that moves.
        top_speed: limit on the norm of the velocity, m/s.
        top_acceleration: limit on the norm of the acceleration, m/s².

    Raises:
        InputError: a limit is not positive.
    """
    for name, limit in (("top speed", top_speed), ("top acceleration", top_acceleration)):
        if not limit > 0.0:
            raise InputError(f"the {name} is {limit:g}, but must be positive")
    factor = max(peak_norm(path, 1) / top_speed, math.sqrt(peak_norm(path, 2) / top_acceleration))
    return path.stretched(factor)


def _evaluate(coefficients: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Polynomials (n, powers) at one s each."""
    return np.einsum("nk,kn->n", coefficients, s ** np.arange(coefficients.shape[1])[:, np.newaxis])
