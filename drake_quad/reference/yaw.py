"""Yaw over time: constant, through given angles, or along the path.

A profile is a `PolynomialPath` with one axis, in rad, of degree 3, at rest at both ends.
"""

import itertools
import math

import numpy as np
import scipy
from numpy.typing import ArrayLike

from drake_quad.errors import InputError
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path

# Slower than this share of the path's top horizontal speed, the direction of flight is no guide.
_SLOW = 0.02
# Nor is it if the whole path is slower sideways than this share of its top speed.
_DRIFT = 0.1
# Knots on a segment of the profile that follows a path.
_PLACES = np.linspace(0.0, 1.0, 16, endpoint=False)
# ∫₀¹ (d²y/ds²)² ds as a quadratic form in value and slope at the start and at the end.
_BENDING_FORM = np.array(
    [[12.0, 6.0, -12.0, 6.0], [6.0, 4.0, -6.0, 2.0], [-12.0, -6.0, 12.0, -6.0], [6.0, 2.0, -6.0, 4.0]]
)


def constant_yaw(start: float, end: float, yaw: float) -> PolynomialPath:
    """Returns the profile that keeps a yaw in rad from a start to an end in s."""
    coefficients = np.zeros((1, 4, 1))
    coefficients[0, 0] = yaw
    return PolynomialPath(np.array([start, end]), coefficients)


def yaw_through(times: ArrayLike, yaws: ArrayLike) -> PolynomialPath:
    """Returns the profile through angles at given times whose integrated squared yaw acceleration is least.

    From one angle to the next it takes the shorter turn. Where an angle is NaN the yaw is free; before the first and
    after the last that is given it stays there.

    Args:
        times: (waypoints,) increasing, or the same where waypoints are passed at once, s.
        yaws: (waypoints,) rad.

    Raises:
        InputError: no angle is given, or two at one time.
    """
    instants, angles = np.asarray(times, dtype=float), np.asarray(yaws, dtype=float)
    given = np.flatnonzero(np.isfinite(angles))
    if not given.size:
        raise InputError("yaw through the waypoints needs a yaw at one of them at least")
    for i, j in itertools.pairwise(given):
        if instants[i] == instants[j] and not math.isclose(math.cos(angles[i] - angles[j]), 1.0):
            raise InputError(f"waypoints {i} and {j} are passed at once, but have different yaws")
    given = given[np.append(True, np.diff(instants[given]) > 0.0)]
    if instants[0] == instants[-1]:
        raise InputError("a yaw profile needs times that differ")
    knots, turned = instants[given], np.unwrap(angles[given])
    parts = [] if knots[0] == instants[0] else [constant_yaw(instants[0], knots[0], turned[0])]
    if len(given) > 1:
        # The clamped cubic spline is the interpolant of least integrated squared second derivative.
        parts.append(_spline(knots, turned))
    if knots[-1] < instants[-1]:
        parts.append(constant_yaw(knots[-1], instants[-1], turned[-1]))
    starts = [part.times[:-1] for part in parts]
    return PolynomialPath(
        np.concatenate([*starts, parts[-1].times[-1:]]), np.concatenate([part.coefficients for part in parts])
    )


def yaw_along(path: PolynomialPath, *, response: float = 0.5) -> PolynomialPath:
    """Returns the profile that looks where the path goes, as far as that can be done smoothly.

    It minimises ∫ ψ̈² + (ψ - direction)² (v / v_max)² / response⁴ dt, v being the horizontal speed and v_max its
    largest, or a tenth of the largest speed if that is more. Such a spline follows a direction that turns steadily
    exactly, and smooths one that turns faster than the response. Where the path is slow, at stops and where it goes
    straight up or down, it turns from the direction before to the one after by the shorter way. A path that never
    moves sideways has yaw zero.

    Args:
        path: of the position, its first two axes horizontal.
        response: time within which the yaw follows at top speed, s. The default is about that of the shipped yaw loop,
            k_P = 4 1/s².
    """
    segment = np.repeat(np.arange(len(path.coefficients)), len(_PLACES))
    s = np.tile(_PLACES, len(path.coefficients))
    times = np.append(path.times[segment] + s * path.durations[segment], path.times[-1])
    velocity = evaluate(path, times, 1)
    v_x, v_y = velocity[:2]
    # Of a path that goes up and down, what it drifts sideways is no direction.
    top = max(float(np.hypot(v_x, v_y).max()), _DRIFT * float(np.linalg.norm(velocity, axis=0).max()))
    speed = np.hypot(v_x, v_y)
    fast = speed > _SLOW * top
    if not fast.any():
        return constant_yaw(path.times[0], path.times[-1], 0.0)
    direction = np.zeros_like(times)
    direction[fast] = np.unwrap(np.arctan2(v_y[fast], v_x[fast]))
    share = np.where(fast, speed / top, 0.0) ** 2
    return _smoothing_spline(times, direction, share / response**4)


def _smoothing_spline(times: np.ndarray, values: np.ndarray, weights: np.ndarray) -> PolynomialPath:
    """The cubic spline at rest at both ends that minimises ∫ ÿ² + weight (y - value)² dt."""
    dt = np.diff(times)
    # The unknowns are value and slope at the knots, the slope in units of the mean interval.
    unit = dt.mean()
    scale = np.ones((len(dt), 4))
    scale[:, 1::2] = dt[:, np.newaxis] / unit
    form = _BENDING_FORM * scale[:, :, np.newaxis] * scale[:, np.newaxis, :] * dt[:, np.newaxis, np.newaxis] ** -3.0
    bands = np.zeros((4, 2 * len(times)))
    for row in range(4):
        for column in range(row + 1):
            bands[row - column, column : column + 2 * len(dt) : 2] += form[:, row, column]
    share = weights * np.gradient(times)
    bands[0, ::2] += share
    right_side = np.zeros(2 * len(times))
    right_side[::2] = share * values
    # At rest at both ends: their slopes are zero, and bound to nothing.
    for end in (1, 2 * len(times) - 1):
        bands[:, end] = 0.0
        bands[0, end] = 1.0
        for distance in range(1, min(end, 3) + 1):
            bands[distance, end - distance] = 0.0
    knots = scipy.linalg.solveh_banded(bands, right_side, lower=True, check_finite=False).reshape(len(times), 2, 1)
    knots[:, 1] /= unit
    return hermite_path(times, knots)


def _spline(times: np.ndarray, angles: np.ndarray) -> PolynomialPath:
    spline = scipy.interpolate.CubicSpline(times, angles, bc_type="clamped")
    # SciPy's highest power comes first, in seconds since the knot.
    coefficients = spline.c[::-1].T * np.diff(times)[:, np.newaxis] ** np.arange(4)
    return PolynomialPath(times, coefficients[:, :, np.newaxis])
