"""Elementary functions of Python floats, NumPy arrays, AutoDiffXd, Expression and symbols.

Each formula of this package is written once, for rows. A row contains one number per vehicle. It is a float for one
vehicle, and an array for a fleet. The numbers are AutoDiffXd where Drake differentiates, and Expression where it
computes symbolically. While a formula is compiled to machine code, a row is a `Symbol`.

NumPy's functions are not sufficient. For a Python float, they are several times slower than the functions of `math`.
`np.maximum` and `np.minimum` reject an Expression, and no NumPy function accepts a symbol.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import scipy
from pydrake import symbolic
from pydrake.autodiffutils import AutoDiffXd

from drake_quad.framework import approximations
from drake_quad.framework.symbols import Matrix, Symbol, add_branch, are_same, layer
from drake_quad.signals import Row

_Rows = TypeVar("_Rows")
_BOOLEAN_TYPES = (bool, np.bool)


def cos(x: Row) -> Row:
    """Return the cosine of an angle, rad."""
    return sin_cos(x)[1] if x.__class__ is not float else math.cos(x)


def sin_cos(x: Row) -> tuple[Row, Row]:
    """Return sine and cosine of an angle, rad."""
    if x.__class__ is float:
        return math.sin(x), math.cos(x)
    if x.__class__ is Symbol:
        return untyped(approximations.sin_cos(x))
    return np.sin(x), np.cos(x)


def sqrt(x: Row) -> Row:
    """Return the square root; NaN for a negative number, which can occur for a diverged vehicle."""
    if x.__class__ is float:
        return math.sqrt(x) if x >= 0.0 else math.nan
    if x.__class__ is Symbol:
        return untyped(approximations.sqrt(x))
    with np.errstate(invalid="ignore", divide="ignore"):
        return _without_nan_derivatives(np.sqrt(x), x)


def arctan(x: Row, *, small: bool = False) -> Row:
    """Return the inverse tangent, rad; `small` selects faster machine code for |x| up to 1/8."""
    if x.__class__ is float:
        return math.atan(x)
    return untyped(approximations.arctan(x, small=small)) if x.__class__ is Symbol else np.arctan(x)


def arcsin(x: Row, *, small: bool = False) -> Row:
    """Return the inverse sine, rad, NaN outside [-1, 1]; `small` selects faster machine code for |x| up to 1/2."""
    if x.__class__ is float:
        return math.asin(x) if -1.0 <= x <= 1.0 else math.nan
    return untyped(approximations.arcsin(x, small=small)) if x.__class__ is Symbol else np.arcsin(x)


def arctan2(y: Row, x: Row) -> Row:
    """Return the angle of the point (x, y), rad; rows of Expression are not supported."""
    if x.__class__ is float and y.__class__ is float:
        return math.atan2(y, x)
    if x.__class__ is Symbol or y.__class__ is Symbol:
        return untyped(approximations.arctan2(y, x))
    return np.arctan2(y, x)


def exp(x: Row) -> Row:
    """Return the exponential of x."""
    if x.__class__ is float:
        return math.exp(x)
    return untyped(approximations.exp(x)) if x.__class__ is Symbol else np.exp(x)


def tanh(x: Row) -> Row:
    """Return the hyperbolic tangent of x."""
    if x.__class__ is float:
        return math.tanh(x)
    return untyped(approximations.tanh(x)) if x.__class__ is Symbol else np.tanh(x)


def erf(x: Row) -> Row:
    """Return the error function of x; rows of Expression are not supported."""
    if x.__class__ is float:
        return math.erf(x)
    if x.__class__ is Symbol:
        return untyped(approximations.erf(x))
    if isinstance(x, np.ndarray) and x.dtype == float:
        return untyped(scipy.special.erf(x))
    return untyped(_erf_of_objects(x))


def log(x: Row, *, normal: bool = False) -> Row:
    """Return the natural logarithm of x; `normal` selects faster machine code for finite x of at least 1e-307."""
    if x.__class__ is float:
        return math.log(x)
    return untyped(approximations.log(x, normal=normal)) if x.__class__ is Symbol else np.log(x)


def log1p(x: Row) -> Row:
    """Return the natural logarithm of 1 + x for x >= 0; it is accurate for small x."""
    if x.__class__ is Symbol:
        return untyped(approximations.log1p(x))
    if x.__class__ is float or (isinstance(x, np.ndarray) and x.dtype == float):
        return np.log1p(x)
    if isinstance(x, np.ndarray):
        return _of_one_type(_log1p_of_objects(x))
    rounded = 1.0 + x
    # The factor x / (rounded - 1) corrects the rounding error of the sum 1 + x.
    return x if rounded == 1.0 else log(rounded) * (x / (rounded - 1.0))


def maximum(x: Row, y: Row) -> Row:
    """Return the larger of x and y, or y where one of them is NaN."""
    if x.__class__ is float and y.__class__ is float:
        return x if x > y else y
    if x.__class__ is Symbol or y.__class__ is Symbol:
        return where(x > y, x, y)
    if _is_symbolic(x) or _is_symbolic(y):
        return _maximum_of_objects(x, y)
    return _of_one_type(np.where(np.greater(x, y), x, y)[()])


def minimum(x: Row, y: Row) -> Row:
    """Return the smaller of x and y, or y where one of them is NaN."""
    if x.__class__ is float and y.__class__ is float:
        return x if x < y else y
    if x.__class__ is Symbol or y.__class__ is Symbol:
        return where(x < y, x, y)
    if _is_symbolic(x) or _is_symbolic(y):
        return _minimum_of_objects(x, y)
    return _of_one_type(np.where(np.less(x, y), x, y)[()])


def where(mask: bool, x: _Rows, y: _Rows) -> _Rows:
    """Return x for vehicles whose mask is true, and y for all other vehicles.

    x and y are rows, or records of the same type; a field that is None remains None. Rows of Expression are not
    supported.
    """
    if isinstance(mask, _BOOLEAN_TYPES):
        return x if mask else y
    if isinstance(x, tuple):
        rows = [where(mask, row, other) for row, other in zip(x, untyped(y), strict=True)]
        return untyped(x._make(rows) if hasattr(x, "_make") else tuple(rows))
    if x is None:
        return x
    if mask.__class__ is Symbol:
        return untyped(x if are_same(x, y) else approximations.select(mask, x, y))
    return untyped(_of_one_type(np.where(mask, x, y)))


def lazy_where(mask: bool, formula: Callable[..., _Rows], arguments: Sequence[Row], otherwise: _Rows) -> _Rows:
    """Return `where(mask, formula(*arguments), otherwise)`, but evaluate the formula only where it is needed.

    Use this function for expensive formulas that few vehicles need. Python evaluates the formula only for vehicles for
    which the mask is true. Machine code evaluates it for all vehicles in a vector register if at least one of them
    needs it. Rows of Expression are not supported.

    Args:
        mask: Boolean for each vehicle, true if the vehicle needs the formula.
        formula: function of rows that returns a row or a tuple of rows. All rows that it uses must be arguments.
        arguments: arguments of the formula.
        otherwise: result for vehicles for which the mask is false.

    Raises:
        TypeError: if the formula is compiled and uses rows that are not arguments.
    """
    if isinstance(mask, _BOOLEAN_TYPES):
        return formula(*arguments) if mask else otherwise
    if mask.__class__ is Symbol:
        return where(mask, add_branch(untyped(mask), formula, arguments), otherwise)
    needed: Any = np.asarray(mask, dtype=bool)
    if not needed.any():
        return where(mask, otherwise, otherwise)
    return _replace_masked(
        needed, formula(*[x[needed] if isinstance(x, np.ndarray) else x for x in arguments]), otherwise
    )


def identity(x: _Rows) -> _Rows:
    """Return x unchanged."""
    return x


def total(rows: Sequence[Row]) -> Row:
    """Return the sum of one or more rows, without adding zero first as Python's `sum` does."""
    first, *others = rows
    return sum(others, start=first)


def dot(first: Sequence[Row], second: Sequence[Row]) -> Row:
    """Return the dot product of two sequences of rows."""
    return total([x * y for x, y in zip(first, second, strict=True)])


def dense(matrix: Matrix, rows: Sequence[Row], activation: Callable[[Row], Row]) -> list[Row]:
    """Return the outputs of a dense network layer: the activation function of matrix product plus biases.

    The columns are added in order. Machine code loops over the columns, so that its size does not depend on the size of
    the matrix.

    Args:
        matrix: constant weights and biases.
        rows: inputs of the layer, one for each column of the matrix.
        activation: activation function of a row.
    """
    symbol = next((row for row in rows if row.__class__ is Symbol), None)
    if symbol is not None:
        return untyped(layer(matrix, rows, activation))
    outputs = []
    for bias, weights in matrix.biases_and_weights():
        total: Row = bias
        for weight, row in zip(weights, rows, strict=True):
            total = total + weight * row
        outputs.append(activation(total))
    return outputs


def _replace_masked(mask: np.ndarray, new: Any, old: Any) -> Any:
    """Return `old` with the values of the masked vehicles replaced by `new`.

    Args:
        mask: (N,) True for a vehicle whose value is replaced.
        new: value, row or tuple of rows, with one column for each masked vehicle.
        old: value, row or tuple of rows, with one column for each of the N vehicles.
    """
    if isinstance(old, tuple):
        rows = [_replace_masked(mask, new_row, old_row) for new_row, old_row in zip(new, old, strict=True)]
        return old._make(rows) if hasattr(old, "_make") else tuple(rows)
    replaced = np.empty(mask.shape, dtype=np.result_type(np.asarray(new), np.asarray(old)))
    replaced[...] = old
    replaced[mask] = new
    return _of_one_type(replaced)


def wrap_angle(angle: Row) -> Row:
    """Wrap an angle to [-π, π], rad; rows of Expression are not supported."""
    if angle.__class__ is float:
        return math.remainder(angle, math.tau) if math.isfinite(angle) else math.nan
    if angle.__class__ is Symbol:
        return untyped(approximations.wrap_angle(angle))
    return angle - math.tau * np.rint(without_derivatives(angle) / math.tau)


def nearest(x: Row) -> Row:
    """Round to the nearest whole number, without derivatives; rows of Expression are not supported."""
    return untyped(approximations.nearest(x)) if x.__class__ is Symbol else np.rint(without_derivatives(x))


def to_uint64(x: Row) -> Any:
    """Convert whole numbers from 0 to 2**52 - 1 to uint64; the result is an array or a symbol, even for one vehicle."""
    if x.__class__ is Symbol:
        return approximations.to_uint64(untyped(x))
    return np.atleast_1d(np.asarray(without_derivatives(x), dtype=float)).astype(np.uint64)


def from_uint64(word: Any) -> Row:
    """Convert a uint64 below 2**52 to a float."""
    return untyped(approximations.from_uint64(word) if word.__class__ is Symbol else word.astype(float))


def without_derivatives(x: Row) -> Row:
    """Return the values of a row without their derivatives; rows of Expression are not supported."""
    if isinstance(x, np.ndarray):
        return np.array([value.value() for value in x]) if x.dtype == object else x
    return x if isinstance(x, float | Symbol) else untyped(x).value()


def untyped(x: Any) -> Any:
    """Return x with the type `Any`, so that a type checker does not treat a row as a float."""
    return x


def _of_one_type(x: Any) -> Any:
    """Convert the floats in an array of objects to the type of the other objects, since NumPy rejects mixed types."""
    if not (isinstance(x, np.ndarray) and x.dtype == object):
        return x
    kind = next((element.__class__ for element in x.flat if element.__class__ is not float), float)
    elements = [kind(element) if element.__class__ is float else element for element in x.flat]
    return np.array(elements).reshape(x.shape)


def _is_symbolic(x: Any) -> bool:
    if isinstance(x, np.ndarray):
        return x.dtype == object and x.size > 0 and isinstance(x.flat[0], symbolic.Expression)
    return isinstance(x, symbolic.Expression)


def _without_nan_derivatives(root: Any, x: Any) -> Any:
    """Return the square root of x, with derivatives of 0 where x and its derivatives are 0.

    An example is the length of a vector that remains zero. Some versions of Drake compute ∞ * 0 in this case, which is
    NaN, and others return 0.
    """
    if isinstance(root, np.ndarray) and root.dtype == object:
        return np.array([_without_nan_derivatives(*each) for each in zip(root, x, strict=True)])
    if isinstance(root, AutoDiffXd) and x.value() == 0.0:
        return AutoDiffXd(0.0, np.where(x.derivatives() == 0.0, 0.0, root.derivatives()))
    return root


def _erf_of_object(x: Any) -> Any:
    """Return the error function of a number or an AutoDiffXd; its derivative is 2/√π exp(-x²)."""
    if not isinstance(x, AutoDiffXd):
        return math.erf(x)
    derivative = 2.0 / math.sqrt(math.pi) * math.exp(-(x.value() ** 2))
    return AutoDiffXd(math.erf(x.value()), derivative * x.derivatives())


_erf_of_objects = np.frompyfunc(_erf_of_object, 1, 1)
_log1p_of_objects = np.frompyfunc(log1p, 1, 1)
_maximum_of_objects = np.frompyfunc(symbolic.max, 2, 1)
_minimum_of_objects = np.frompyfunc(symbolic.min, 2, 1)
