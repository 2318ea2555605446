"""Functions that act alike on Python floats, NumPy arrays, AutoDiffXd and Expression.

A formula of this project is written once, on rows: scalars for one vehicle, arrays for a fleet. NumPy alone would
do but for two reasons: on a Python float it takes several times as long as `math`, and its maximum and minimum
refuse an Expression.
"""

import math
from typing import Any

import numpy as np
from pydrake import symbolic

# One number a vehicle: a float, AutoDiffXd or Expression for one vehicle, an array of them for a fleet.
Row = Any
# Several rows: a sequence of them for one vehicle, a (rows, N) array for a fleet.
Rows = Any

_TRUTH = (bool, np.bool)


def cos(x: Row) -> Row:
    """Cosine of an angle in radians."""
    return math.cos(x) if x.__class__ is float else np.cos(x)


def sin_cos(x: Row) -> tuple[Row, Row]:
    """Sine and cosine of an angle in radians."""
    return (math.sin(x), math.cos(x)) if x.__class__ is float else (np.sin(x), np.cos(x))


def sqrt(x: Row) -> Row:
    """Square root; NaN, not an error, for a negative float that came from a diverged vehicle."""
    if x.__class__ is float:
        return math.sqrt(x) if x >= 0.0 else math.nan
    return np.sqrt(x)


def arctan(x: Row) -> Row:
    """Inverse tangent, rad."""
    return math.atan(x) if x.__class__ is float else np.arctan(x)


def arcsin(x: Row) -> Row:
    """Inverse sine, rad; NaN, not an error, for a float outside [-1, 1]."""
    if x.__class__ is float:
        return math.asin(x) if -1.0 <= x <= 1.0 else math.nan
    return np.arcsin(x)


def arctan2(y: Row, x: Row) -> Row:
    """Angle of the point (x, y), rad. Not for Expression."""
    return math.atan2(y, x) if x.__class__ is float and y.__class__ is float else np.arctan2(y, x)


def exp(x: Row) -> Row:
    """Exponential."""
    return math.exp(x) if x.__class__ is float else np.exp(x)


def log(x: Row) -> Row:
    """Natural logarithm."""
    return math.log(x) if x.__class__ is float else np.log(x)


def log_of_1_plus(x: Row) -> Row:
    """Natural logarithm of 1 + x, accurate for small x, which must not be negative."""
    if x.__class__ is float or (isinstance(x, np.ndarray) and x.dtype == float):
        return np.log1p(x)
    rounded = 1.0 + x
    # What was lost in the sum is lost in the difference, too.
    return x if rounded == 1.0 else log(rounded) * (x / (rounded - 1.0))


def maximum(x: Row, y: Row) -> Row:
    """The larger of the two; y where x is NaN."""
    if x.__class__ is float and y.__class__ is float:
        return x if x > y else y
    return _maximum_of_objects(x, y) if _is_symbolic(x) or _is_symbolic(y) else _of_one_type(np.fmax(x, y))


def minimum(x: Row, y: Row) -> Row:
    """The smaller of the two; y where x is NaN."""
    if x.__class__ is float and y.__class__ is float:
        return x if x < y else y
    return _minimum_of_objects(x, y) if _is_symbolic(x) or _is_symbolic(y) else _of_one_type(np.fmin(x, y))


def where(mask: Row, x: Row, y: Row) -> Row:
    """X, one row or several, for the vehicles for which the mask is true, y for the others. Not for Expression."""
    if isinstance(mask, _TRUTH):
        return x if mask else y
    if isinstance(x, tuple):
        return tuple([where(mask, row, other) for row, other in zip(x, y, strict=True)])
    return _of_one_type(np.where(mask, x, y))


def is_zero(x: Row) -> bool:
    """Whether a row is the number zero, so that what it stands for can be left out.

    An array is not, whatever it holds: another batch of samples may hold something else.
    """
    return x.__class__ is float and x == 0.0


def wrapped(angle: Row) -> Row:
    """The same angle in [-π, π], rad. Not for Expression."""
    if angle.__class__ is float:
        return math.remainder(angle, math.tau) if math.isfinite(angle) else math.nan
    return angle - math.tau * np.rint(plain(angle) / math.tau)


def plain(x: Row) -> Row:
    """The values of a row, without their derivatives. Not for Expression."""
    if isinstance(x, np.ndarray):
        return np.array([value.value() for value in x]) if x.dtype == object else x
    return x if x.__class__ is float else x.value()


def _of_one_type(x: Row) -> Row:
    """The same without floats among objects: NumPy's functions take no mixture."""
    if not (isinstance(x, np.ndarray) and x.dtype == object):
        return x
    kind = next((element.__class__ for element in x.flat if element.__class__ is not float), float)
    alike = [kind(element) if element.__class__ is float else element for element in x.flat]
    return np.array(alike).reshape(x.shape)


def _is_symbolic(x: Row) -> bool:
    if isinstance(x, np.ndarray):
        return x.dtype == object and x.size > 0 and isinstance(x.flat[0], symbolic.Expression)
    return isinstance(x, symbolic.Expression)


_maximum_of_objects = np.frompyfunc(symbolic.max, 2, 1)
_minimum_of_objects = np.frompyfunc(symbolic.min, 2, 1)
