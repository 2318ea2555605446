"""Yaw profiles: constant, through given angles, or along the path.

A profile is a `PolynomialPath` of degree 3 with one axis, in rad, that is at rest at both ends.
"""

import itertools
import math

import numpy as np
import scipy
from numpy.typing import ArrayLike

from drake_quad.errors import InputError
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path

# Horizontal speed below which the direction of flight is ignored, relative to v_max in `yaw_along_path`.
_MIN_RELATIVE_SPEED = 0.02
# Smallest v_max in `yaw_along_path`, relative to the largest speed. This limit matters for vertical paths, on which the
# direction of small horizontal motion is not meaningful.
_MIN_RELATIVE_V_MAX = 0.1
# Positions of the yaw knots within a path segment, in unit time.
_KNOT_POSITIONS = np.linspace(0.0, 1.0, 16, endpoint=False)
# Matrix of the quadratic form ∫₀¹ (d²y/ds²)² ds. Its vector consists of value and derivative at the start, then value
# and derivative at the end.
_BENDING_FORM = np.array(
    [[12.0, 6.0, -12.0, 6.0], [6.0, 4.0, -6.0, 2.0], [-12.0, -6.0, 12.0, -6.0], [6.0, 2.0, -6.0, 4.0]]
)


def constant_yaw(start: float, end: float, yaw: float) -> PolynomialPath:
    """Return a profile with a constant yaw (rad) between a start and an end time (s)."""
    coefficients = np.zeros((1, 4, 1))
    coefficients[0, 0] = yaw
    return PolynomialPath(np.array([start, end]), coefficients)


def yaw_through(times: ArrayLike, yaws: ArrayLike) -> PolynomialPath:
    """Return the profile through given angles with the smallest integrated squared yaw acceleration.

    The profile takes the shorter rotation from one angle to the next. It is constant before the first and after the
    last given angle.

    Args:
        times: (waypoints,) waypoint times, s, which must not decrease. Waypoints that are passed simultaneously have
            equal times.
        yaws: (waypoints,) angles, rad; NaN for a waypoint at which the yaw is free.

    Raises:
        InputError: if no angle is given, or different angles are given at one time.
    """
    instants, angles = np.asarray(times, dtype=float), np.asarray(yaws, dtype=float)
    given = np.flatnonzero(np.isfinite(angles))
    if not given.size:
        raise InputError("no waypoint has a yaw; give at least one waypoint a yaw")
    for i, j in itertools.pairwise(given):
        if instants[i] == instants[j] and not math.isclose(math.cos(angles[i] - angles[j]), 1.0):
            raise InputError(f"waypoints {i} and {j} are passed at the same time, but have different yaws")
    given = given[np.append(True, np.diff(instants[given]) > 0.0)]
    if instants[0] == instants[-1]:
        raise InputError("all waypoint times are equal; a yaw profile needs different times")
    knots, unwrapped = instants[given], np.unwrap(angles[given])
    parts = [] if knots[0] == instants[0] else [constant_yaw(instants[0], knots[0], unwrapped[0])]
    if len(given) > 1:
        # The clamped cubic spline is the interpolant with the smallest integrated squared second derivative.
        parts.append(_clamped_spline(knots, unwrapped))
    if knots[-1] < instants[-1]:
        parts.append(constant_yaw(knots[-1], instants[-1], unwrapped[-1]))
    starts = [part.times[:-1] for part in parts]
    return PolynomialPath(
        np.concatenate([*starts, parts[-1].times[-1:]]), np.concatenate([part.coefficients for part in parts])
    )


def yaw_along_path(path: PolynomialPath, *, response: float = 0.5) -> PolynomialPath:
    """Return a smooth profile that points in the direction of flight.

    The profile minimises ∫ ψ̈² + (ψ - direction)² (v / v_max)² / response⁴ dt. Here v is the horizontal speed, and
    v_max is the larger of the largest horizontal speed and a tenth of the largest speed. If the direction turns at a
    constant rate, the spline follows it exactly. A turn that is faster than the response is smoothed. If the path stops
    or is vertical, the yaw takes the shorter rotation from the direction before to the direction after. A path without
    horizontal motion has yaw zero.

    Args:
        path: path of the position, whose first two axes are horizontal.
        response: time within which the yaw follows the direction at the largest speed, s. The default is about the
            response time of the default yaw loop, with k_P = 4 1/s².
    """
    segment = np.repeat(np.arange(len(path.coefficients)), len(_KNOT_POSITIONS))
    s = np.tile(_KNOT_POSITIONS, len(path.coefficients))
    times = np.append(path.times[segment] + s * path.durations[segment], path.times[-1])
    velocity = evaluate(path, times, 1)
    v_x, v_y = velocity[:2]
    # On a vertical path, the lower limit prevents the yaw from following small horizontal motion.
    v_max = max(float(np.hypot(v_x, v_y).max()), _MIN_RELATIVE_V_MAX * float(np.linalg.norm(velocity, axis=0).max()))
    speed = np.hypot(v_x, v_y)
    has_direction = speed > _MIN_RELATIVE_SPEED * v_max
    if not has_direction.any():
        return constant_yaw(path.times[0], path.times[-1], 0.0)
    direction = np.zeros_like(times)
    direction[has_direction] = np.unwrap(np.arctan2(v_y[has_direction], v_x[has_direction]))
    fraction = np.where(has_direction, speed / v_max, 0.0) ** 2
    return _smoothing_spline(times, direction, fraction / response**4)


def _smoothing_spline(times: np.ndarray, values: np.ndarray, weights: np.ndarray) -> PolynomialPath:
    """Return the cubic spline that minimises ∫ ÿ² + weight (y - value)² dt and is at rest at both ends.

    Args:
        times: (knots,) times, s.
        values: (knots,) values to approximate.
        weights: (knots,) weights, 1/s⁴.
    """
    dt = np.diff(times)
    # The unknowns are value and derivative at the knots, with the mean interval as the unit of time.
    unit = dt.mean()
    scale = np.ones((len(dt), 4))
    scale[:, 1::2] = dt[:, np.newaxis] / unit
    form = _BENDING_FORM * scale[:, :, np.newaxis] * scale[:, np.newaxis, :] * dt[:, np.newaxis, np.newaxis] ** -3.0
    bands = np.zeros((4, 2 * len(times)))
    for row in range(4):
        for column in range(row + 1):
            bands[row - column, column : column + 2 * len(dt) : 2] += form[:, row, column]
    fraction = weights * np.gradient(times)
    bands[0, ::2] += fraction
    right_side = np.zeros(2 * len(times))
    right_side[::2] = fraction * values
    # The derivatives at both ends are zero, so their rows are decoupled from the other unknowns.
    for end in (1, 2 * len(times) - 1):
        bands[:, end] = 0.0
        bands[0, end] = 1.0
        for distance in range(1, min(end, 3) + 1):
            bands[distance, end - distance] = 0.0
    knots = scipy.linalg.solveh_banded(bands, right_side, lower=True, check_finite=False).reshape(len(times), 2, 1)
    knots[:, 1] /= unit
    return hermite_path(times, knots)


def _clamped_spline(times: np.ndarray, angles: np.ndarray) -> PolynomialPath:
    """Return the cubic spline through angles (rad) at given times (s) with zero derivative at both ends."""
    spline = scipy.interpolate.CubicSpline(times, angles, bc_type="clamped")
    # SciPy's coefficients start with the highest power. They are for the time in seconds since the knot.
    coefficients = spline.c[::-1].T * np.diff(times)[:, np.newaxis] ** np.arange(4)
    return PolynomialPath(times, coefficients[:, :, np.newaxis])
