"""Tests of error messages about functions and operators that a formula cannot apply to rows."""

import math

import numpy as np
import pytest
import scipy

from drake_quad.framework import elementary
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import layout_of
from drake_quad.framework.replacements import REPLACEMENTS, replacement
from drake_quad.signals import Attitude, Row

ROW_LAYOUT = layout_of(Row)
EXPRESSION_NAMESPACE = {**vars(elementary), "math": math}
# Expected results of those replacements that cannot simply be compared with the NumPy function of the same name.
FUNCTIONS = {
    "all": lambda x, y: x > 0.0 and y > 0.0,
    "any": lambda x, y: x > 0.0 or y > 0.0,
    "arctan2": lambda x, y: math.atan2(y, x),
    "clip": lambda x, y: np.clip(x, -0.2, 0.3),
    "copysign": math.copysign,
    "erf": lambda x, y: scipy.special.erf(x),
    "floor_divide": np.floor_divide,
    "heaviside": lambda x, y: np.heaviside(x, 1.0),
    "hypot": math.hypot,
    "logical_and": lambda x, y: x > 0.0 and y > 0.0,
    "logical_not": lambda x, y: not x > 0.0,
    "logical_or": lambda x, y: x > 0.0 or y > 0.0,
    "max": max,
    "maximum": max,
    "min": min,
    "minimum": min,
    "norm": lambda x, y: np.linalg.norm([x, y]),
    "power": np.power,
    "remainder": np.remainder,
    "where": lambda x, y: x if x > 0.0 else y,
}
FUNCTIONS_OF_POSITIVE_NUMBERS = {"log", "log10", "log1p", "power", "sqrt"}


def compiled(formula):
    """Compile a formula of one row, and return the result for 1."""
    result = np.empty(1)
    kernel(formula, (ROW_LAYOUT,), (ROW_LAYOUT,), single_vehicle=True)(1, 0.0, result, np.ones(1))
    return result[0]


def evaluated(name, x, y):
    return eval(REPLACEMENTS[name], EXPRESSION_NAMESPACE, {"x": x, "y": y, "v": [x, y], "low": -0.2, "high": 0.3})


@pytest.mark.parametrize("name", REPLACEMENTS)
def test_a_replacement_agrees_with_the_function_in_python_and_in_machine_code(name):
    function = FUNCTIONS.get(name, lambda x, y: getattr(np, name)(x))
    for x, y in ((0.4, 0.7), (0.25, -0.3), (-0.4, -0.7), (-0.6, 0.25)):
        if x < 0.0 and name in FUNCTIONS_OF_POSITIVE_NUMBERS:
            continue
        expected = function(x, y)
        assert evaluated(name, x, y) == pytest.approx(expected, rel=1e-12)
        result = np.empty(1)
        run = kernel(lambda x, y: evaluated(name, x, y), (ROW_LAYOUT, ROW_LAYOUT), (ROW_LAYOUT,), single_vehicle=True)
        run(1, 0.0, result, np.array([x]), np.array([y]))
        assert result[0] == pytest.approx(float(expected), rel=1e-12)


def test_numpy_functions_without_a_replacement_are_also_refused():
    """NumPy's functions of one number either accept rows, or raise an error with a one-sentence message."""
    functions = [each for each in vars(np).values() if isinstance(each, np.ufunc) and each.nargs == 2]
    assert len(functions) > 30
    for function in functions:
        if function in (np.absolute, np.negative):
            continue
        with pytest.raises(TypeError, match=rf"numpy\.{function.__name__} does not accept a row, the values"):
            compiled(lambda x, function=function: function(x))


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        (lambda x: np.sin(x), r"numpy\.sin .*; use sin_cos\(x\)\[0\] instead"),
        (lambda x: np.sin([x, x])[0], r"numpy\.sin .*; use sin_cos\(x\)\[0\] instead"),
        (lambda x: np.clip(x, 0.0, 1.0), r"numpy\.clip .*; use minimum\(maximum\(x, low\), high\) instead"),
        (lambda x: np.clip(x, -x, x), r"numpy\.clip .*; use minimum\(maximum\(x, low\), high\) instead"),
        (lambda x: np.clip([x, x], 0.0, 1.0)[0], r"numpy\.clip .*; use minimum\(maximum\(x, low\), high\) instead"),
        (lambda x: np.where(x > 0.0, x, 1.0), r"numpy\.where .*; use where\(x > 0\.0, x, y\) instead"),
        (lambda x: np.interp(x, [0.0, 1.0], [0.0, 2.0]), r"numpy\.interp .*; use where\(x > 0\.0, x, y\) instead"),
        (lambda x: np.linalg.norm([x, x]), r"numpy\.linalg\.norm .*; use sqrt\(dot\(v, v\)\) instead"),
        (lambda x: np.maximum(x, 0.0), r"numpy\.maximum .*; use maximum\(x, y\) instead"),
        (lambda x: np.maximum(np.array([x, x]), 0.0)[0], r"cannot branch .*; use where.*, maximum\(x, y\)"),
        (lambda x: np.max([x, 0.0]), r"numpy\.max .*; use maximum\(x, y\) instead"),
        (lambda x: np.sign(x), r"numpy\.sign .*; use where\(x < 0\.0, -1\.0, 1\.0\) instead"),
        (lambda x: np.any(x > 0.0), r"numpy\.any .*; use \(x > 0\.0\) \| \(y > 0\.0\) instead"),
        (lambda x: np.linalg.inv(np.diag([x, x]))[0, 0], "functions of NumPy do not accept rows"),
        (lambda x: np.vstack([x])[0, 0], r"numpy\.vstack does not accept a row"),
        (lambda x: scipy.special.erf(x), r"scipy\.special\.erf .*; use erf\(x\) instead"),
        (lambda x: x if x > 0.0 else -x, r"cannot branch on a row.*; use where\(x > 0\.0, x, y\) instead of `if`"),
        (lambda x: x if x > 0.0 and x < 2.0 else -x, "`&` and `|` instead of `and`"),
        (lambda x: max(x, 0.0), r"maximum\(x, y\) and minimum\(x, y\) instead of max and min"),
        (lambda x: elementary.where(0.0 < x < 1.0, x, 0.0), "cannot branch on a row"),
        (lambda x: elementary.where(~(x > 0.0), x, 0.0), r"`~` .*; use \(x > 0\.0\) == 0\.0 instead"),
        (lambda x: math.sin(x), "cannot be converted to a float; .*elementary instead of those of math"),
        (lambda x: float(x), "cannot be converted to a float"),
        (lambda x: assigned(np.zeros(1), x)[0], "a list instead of an array of floats"),
        (lambda x: np.array([x], dtype=float)[0], "a list instead of an array of floats"),
        (lambda x: round(x), r"round .*; use nearest\(x\) instead"),
        (lambda x: math.floor(x), "math.floor .*; use where"),
        (lambda x: int(x), "cannot be converted to an int"),
        (lambda x: sum(range(x)), "cannot be an index or a number of repetitions"),
        (lambda x: [1.0, 2.0][x], "cannot be an index"),
        (lambda x: x**2, r"`\*\*` .*; use x \* x instead"),
        (lambda x: x**0.5, r"`\*\*` .*; use sqrt\(x\) instead"),
        (lambda x: 2.0**x, r"`\*\*` .*; use exp\(y \* log\(x\)\) instead"),
        (lambda x: x % 2.0, r"`%` .*; use x - y \* where"),
        (lambda x: x // 2.0, r"`//` .*; use where"),
        (lambda x: x[0], "not subscriptable; a Symbol is a row, a number for each vehicle, without elements"),
        (lambda x: x.clip(0.0, 1.0), r"has no attribute 'clip'; use minimum\(maximum\(x, low\), high\)"),
        (lambda x: x.shape[0], "has no attribute 'shape'; a Symbol is a row"),
        (lambda x: elementary.sin(x), r"has no attribute 'sin'; use sin_cos\(x\)\[0\]"),
        (lambda x: Attitude(x, x, x).rol, r"'Attitude' object has no attribute 'rol'; did you mean roll\?"),
        (lambda x: np.array([1.0, 2.0]) * x, r"not an array of shape \(2,\); compute with its elements"),
        (lambda x: np.array([x]), r"not an array of shape \(1,\); compute with its elements"),
        (lambda x: x * [1.0], "expected a number or a row, not list"),
        (lambda x: x * 1j, "expected a number or a row, not complex"),
        (lambda x: elementary.where(x > 0.0, "yes", "no"), "expected a number or a row, not str"),
        (lambda x: len(f"{x:.2f}") * x, "set the environment variable DRAKE_QUAD_INTERPRETED"),
    ],
)  # fmt: skip
def test_the_error_about_a_function_that_does_not_accept_rows_suggests_a_replacement(formula, message):
    with pytest.raises(TypeError, match=rf"^formula <lambda>: .*{message}"):
        compiled(formula)


def assigned(array, value):
    array[0] = value
    return array


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        (lambda x: (np.array([[1.0, 2.0], [3.0, 4.0]]) @ np.array([x, 2.0 * x]))[0], 5.0),
        (lambda x: np.dot([1.0, 2.0], [x, x]), 3.0),
        (lambda x: np.cross([x, 0.0, 0.0], [0.0, 3.0, 0.0])[2], 3.0),
        (lambda x: np.sum([x, x, +x]), 3.0),
        (lambda x: np.array(x), 1.0),
    ],
)
def test_linear_algebra_on_lists_of_rows_is_accepted(formula, expected):
    assert compiled(formula) == expected


def test_an_index_error_in_a_formula_remains_an_index_error():
    with pytest.raises(IndexError, match="^formula <lambda>: list index out of range$"):
        compiled(lambda x: [x][2])
    with pytest.raises(IndexError, match="a row cannot be an index: use where"):
        compiled(lambda x: np.zeros(3)[x])


def test_replacements_are_found_by_all_names_of_a_function():
    assert replacement("arctan2") == replacement("atan2") == "arctan2(y, x)"
    assert replacement("sinc") is None
