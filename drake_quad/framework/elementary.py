"""Functions that act alike on Python floats, NumPy arrays, AutoDiffXd, Expression and symbols.

A formula of this project is written once, on rows: one number a vehicle. A row is a float for one vehicle and an array
for a fleet, an AutoDiffXd or Expression where Drake differentiates or simplifies, and a `Symbol` where machine code is
made. NumPy alone would not do: on a Python float it takes several times as long as `math`, its maximum and minimum
refuse an Expression, and it knows no symbols.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import scipy
from pydrake import symbolic
from pydrake.autodiffutils import AutoDiffXd

from drake_quad.framework import approximations
from drake_quad.framework.symbols import Matrix, Symbol, are_same, branched, layer
from drake_quad.signals import Row

_Rows = TypeVar("_Rows")
_TRUTH = (bool, np.bool)


def cos(x: Row) -> Row:
    """Cosine of an angle in radians."""
    return sin_cos(x)[1] if x.__class__ is not float else math.cos(x)


def sin_cos(x: Row) -> tuple[Row, Row]:
    """Sine and cosine of an angle in radians."""
    if x.__class__ is float:
        return math.sin(x), math.cos(x)
    if x.__class__ is Symbol:
        return untyped(approximations.sin_cos(x))
    return np.sin(x), np.cos(x)


def sqrt(x: Row) -> Row:
    """Square root; NaN, not an error, for a negative float that came from a diverged vehicle."""
    if x.__class__ is float:
        return math.sqrt(x) if x >= 0.0 else math.nan
    return untyped(approximations.sqrt(x)) if x.__class__ is Symbol else np.sqrt(x)


def arctan(x: Row, *, small: bool = False) -> Row:
    """Return the inverse tangent, rad; it is quicker if |x| is known to be at most 1/8: small."""
    if x.__class__ is float:
        return math.atan(x)
    return untyped(approximations.arctan(x, small=small)) if x.__class__ is Symbol else np.arctan(x)


def arcsin(x: Row, *, small: bool = False) -> Row:
    """Return the inverse sine, rad; it is quicker if |x| is known to be at most 1/2: small.

    It is NaN, not an error, for a float outside [-1, 1].
    """
    if x.__class__ is float:
        return math.asin(x) if -1.0 <= x <= 1.0 else math.nan
    return untyped(approximations.arcsin(x, small=small)) if x.__class__ is Symbol else np.arcsin(x)


def arctan2(y: Row, x: Row) -> Row:
    """Angle of the point (x, y), rad. Not for Expression."""
    if x.__class__ is float and y.__class__ is float:
        return math.atan2(y, x)
    if x.__class__ is Symbol or y.__class__ is Symbol:
        return untyped(approximations.arctan2(y, x))
    return np.arctan2(y, x)


def exp(x: Row) -> Row:
    """Exponential."""
    if x.__class__ is float:
        return math.exp(x)
    return untyped(approximations.exp(x)) if x.__class__ is Symbol else np.exp(x)


def tanh(x: Row) -> Row:
    """Hyperbolic tangent."""
    if x.__class__ is float:
        return math.tanh(x)
    return untyped(approximations.tanh(x)) if x.__class__ is Symbol else np.tanh(x)


def erf(x: Row) -> Row:
    """Return the error function of x, which may be of any type but Expression."""
    if x.__class__ is float:
        return math.erf(x)
    if x.__class__ is Symbol:
        return untyped(approximations.erf(x))
    if isinstance(x, np.ndarray) and x.dtype == float:
        return untyped(scipy.special.erf(x))
    return untyped(_erf_of_objects(x))


def log(x: Row, *, normal: bool = False) -> Row:
    """Natural logarithm; it is quicker where it is known that x is positive, finite and not below 1e-307: normal."""
    if x.__class__ is float:
        return math.log(x)
    return untyped(approximations.log(x, normal=normal)) if x.__class__ is Symbol else np.log(x)


def log_of_1_plus(x: Row) -> Row:
    """Natural logarithm of 1 + x, accurate for small x, which must not be negative."""
    if x.__class__ is Symbol:
        return untyped(approximations.log_of_1_plus(x))
    if x.__class__ is float or (isinstance(x, np.ndarray) and x.dtype == float):
        return np.log1p(x)
    if isinstance(x, np.ndarray):
        return _of_one_type(_log_of_1_plus_of_objects(x))
    rounded = 1.0 + x
    # What was lost in the sum is lost in the difference, too.
    return x if rounded == 1.0 else log(rounded) * (x / (rounded - 1.0))


def maximum(x: Row, y: Row) -> Row:
    """The larger of the two; y where x is NaN."""
    if x.__class__ is float and y.__class__ is float:
        return x if x > y else y
    if x.__class__ is Symbol or y.__class__ is Symbol:
        return where(x > y, x, y)
    return _maximum_of_objects(x, y) if _is_symbolic(x) or _is_symbolic(y) else _of_one_type(np.fmax(x, y))


def minimum(x: Row, y: Row) -> Row:
    """The smaller of the two; y where x is NaN."""
    if x.__class__ is float and y.__class__ is float:
        return x if x < y else y
    if x.__class__ is Symbol or y.__class__ is Symbol:
        return where(x < y, x, y)
    return _minimum_of_objects(x, y) if _is_symbolic(x) or _is_symbolic(y) else _of_one_type(np.fmin(x, y))


def where(mask: bool, x: _Rows, y: _Rows) -> _Rows:
    """X, a row or a record, for the vehicles for which the mask is true, y for the others. Not for Expression.

    A part of a record that is None stays None.
    """
    if isinstance(mask, _TRUTH):
        return x if mask else y
    if isinstance(x, tuple):
        rows = [where(mask, row, other) for row, other in zip(x, untyped(y), strict=True)]
        return untyped(x._make(rows) if hasattr(x, "_make") else tuple(rows))
    if x is None:
        return x
    if mask.__class__ is Symbol:
        return untyped(x if are_same(x, y) else approximations.select(mask, x, y))
    return untyped(_of_one_type(np.where(mask, x, y)))


def where_needed(mask: bool, formula: Callable[..., _Rows], arguments: Sequence[Row], otherwise: _Rows) -> _Rows:
    """The same as `where(mask, formula(*arguments), otherwise)`, for a formula that costs much and is seldom needed.

    It is computed for the vehicles for which the mask is true and not at all if there are none; by machine code, for
    those beside them in a vector, too. Not for Expression.

    Args:
        mask: for which vehicles it is needed.
        formula: a function of rows that returns a row or a tuple of rows; the rows that it takes are its arguments.
        arguments: rows.
        otherwise: what the others get.

    Raises:
        TypeError: machine code is made, and the formula takes rows that are not among its arguments.
    """
    if isinstance(mask, _TRUTH):
        return formula(*arguments) if mask else otherwise
    if mask.__class__ is Symbol:
        return where(mask, branched(untyped(mask), formula, arguments), otherwise)
    needed: Any = np.asarray(mask, dtype=bool)
    if not needed.any():
        return where(mask, otherwise, otherwise)
    return _placed(needed, formula(*[x[needed] if isinstance(x, np.ndarray) else x for x in arguments]), otherwise)


def identity(x: _Rows) -> _Rows:
    """Return x."""
    return x


def total(rows: Sequence[Row]) -> Row:
    """Return the sum of at least one row; there is no zero to begin with, which would be one more operation."""
    first, *others = rows
    return sum(others, start=first)


def dot(first: Sequence[Row], second: Sequence[Row]) -> Row:
    """Return the sum of the products of the rows of two sequences."""
    return total([x * y for x, y in zip(first, second, strict=True)])


def dense(matrix: Matrix, rows: Sequence[Row], activation: Callable[[Row], Row]) -> list[Row]:
    """A layer of a network: for each row of a matrix, the activation of its bias plus its product with the rows.

    Sums are taken in the order of the columns. As machine code it is a loop, however large the matrix is.

    Args:
        matrix: of constants.
        rows: one a column.
        activation: a function of a row.
    """
    symbol = next((row for row in rows if row.__class__ is Symbol), None)
    if symbol is not None:
        return untyped(layer(matrix, rows, activation))
    found = []
    for bias, weights in matrix.biases_and_weights():
        total: Row = bias
        for weight, row in zip(weights, rows, strict=True):
            total = total + weight * row
        found.append(activation(total))
    return found


def _placed(mask: np.ndarray, some: Any, others: Any) -> Any:
    """Rows of the vehicles for which a mask is true among those of the others."""
    if isinstance(others, tuple):
        rows = [_placed(mask, row, other) for row, other in zip(some, others, strict=True)]
        return others._make(rows) if hasattr(others, "_make") else tuple(rows)
    placed = np.empty(mask.shape, dtype=np.result_type(np.asarray(some), np.asarray(others)))
    placed[...] = others
    placed[mask] = some
    return _of_one_type(placed)


def wrapped(angle: Row) -> Row:
    """The same angle in [-π, π], rad. Not for Expression."""
    if angle.__class__ is float:
        return math.remainder(angle, math.tau) if math.isfinite(angle) else math.nan
    if angle.__class__ is Symbol:
        return untyped(approximations.wrapped(angle))
    return angle - math.tau * np.rint(plain(angle) / math.tau)


def nearest(x: Row) -> Row:
    """The nearest whole number, without derivatives. Not for Expression."""
    return untyped(approximations.nearest(x)) if x.__class__ is Symbol else np.rint(plain(x))


def word_of(x: Row) -> Any:
    """The 64 bits of a whole number from 0 on, below 2**52, uint64: a symbol, or an array even for one vehicle."""
    if x.__class__ is Symbol:
        return approximations.word_of(untyped(x))
    return np.atleast_1d(np.asarray(plain(x), dtype=float)).astype(np.uint64)


def float_of(word: Any) -> Row:
    """The number that 64 bits below 2**52 are."""
    return untyped(approximations.float_of(word) if word.__class__ is Symbol else word.astype(float))


def plain(x: Row) -> Row:
    """The values of a row, without their derivatives. Not for Expression."""
    if isinstance(x, np.ndarray):
        return np.array([value.value() for value in x]) if x.dtype == object else x
    return x if isinstance(x, float | Symbol) else untyped(x).value()


def untyped(x: Any) -> Any:
    """The same; a type checker, for which a row is a float, shall not ask what it is here."""
    return x


def _of_one_type(x: Any) -> Any:
    """The same without floats among objects: NumPy's functions take no mixture."""
    if not (isinstance(x, np.ndarray) and x.dtype == object):
        return x
    kind = next((element.__class__ for element in x.flat if element.__class__ is not float), float)
    alike = [kind(element) if element.__class__ is float else element for element in x.flat]
    return np.array(alike).reshape(x.shape)


def _is_symbolic(x: Any) -> bool:
    if isinstance(x, np.ndarray):
        return x.dtype == object and x.size > 0 and isinstance(x.flat[0], symbolic.Expression)
    return isinstance(x, symbolic.Expression)


def _erf_of_object(x: Any) -> Any:
    """Return the error function of a number or an AutoDiffXd; its derivative is 2/√π exp(-x²)."""
    if not isinstance(x, AutoDiffXd):
        return math.erf(x)
    slope = 2.0 / math.sqrt(math.pi) * math.exp(-(x.value() ** 2))
    return AutoDiffXd(math.erf(x.value()), slope * x.derivatives())


_erf_of_objects = np.frompyfunc(_erf_of_object, 1, 1)
_log_of_1_plus_of_objects = np.frompyfunc(log_of_1_plus, 1, 1)
_maximum_of_objects = np.frompyfunc(symbolic.max, 2, 1)
_minimum_of_objects = np.frompyfunc(symbolic.min, 2, 1)
