"""Yaw over time: constant, through given angles, or along the path.

A profile is a `PolynomialPath` with one axis, in rad, of degree 3, at rest at both ends.
"""

import itertools

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from drake_quad.errors import InputError
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at

# Slower than this share of the path's top horizontal speed, the direction of flight says little, and nothing at rest.
_SLOW = 0.15
# Places on a segment at which the yaw is the direction of flight exactly.
_PLACES = np.linspace(0.0, 1.0, 16, endpoint=False)


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
        if instants[i] == instants[j] and angles[i] != angles[j]:
            raise InputError(f"waypoints {i} and {j} are passed at once, but have different yaws")
    given = given[np.append(True, np.diff(instants[given]) > 0.0)]
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


def yaw_along(path: PolynomialPath) -> PolynomialPath:
    """Returns the profile that looks where the path goes.

    Where the path is slow, at stops and where it goes straight up or down, the yaw turns from the direction before to
    the one after, by the shorter way and with the least acceleration. A path that never moves sideways has yaw zero.

    Args:
        path: of the position, its first two axes horizontal.
    """
    segments = len(path.coefficients)
    segment, s = np.repeat(np.arange(segments), len(_PLACES)), np.tile(_PLACES, segments)
    times = path.times[segment] + s * path.durations[segment]
    v_x, v_y = evaluate_at(path, segment, s, 1)[:, :2].T
    speed = np.hypot(v_x, v_y)
    fast = speed > _SLOW * speed.max()
    start, end = path.times[[0, -1]]
    if not fast.any():
        return constant_yaw(start, end, 0.0)
    knots, angles = times[fast], np.unwrap(np.arctan2(v_y[fast], v_x[fast]))
    if knots[0] > start:
        knots, angles = np.append(start, knots), np.append(angles[0], angles)
    return _spline(np.append(knots, end), np.append(angles, angles[-1]))


def _spline(times: np.ndarray, angles: np.ndarray) -> PolynomialPath:
    spline = CubicSpline(times, angles, bc_type="clamped")
    # SciPy's highest power comes first, in seconds since the knot.
    coefficients = spline.c[::-1].T * np.diff(times)[:, np.newaxis] ** np.arange(4)
    return PolynomialPath(times, coefficients[:, :, np.newaxis])
