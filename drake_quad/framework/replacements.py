"""Replacements for functions and operators that a formula cannot apply to rows, and error messages that name them.

A row is a quantity that has one value for each vehicle of a fleet.
"""

import re
import sys
from pathlib import Path

import numpy as np

from drake_quad.errors import did_you_mean

# Hint for authors of formulas, which ends several error messages.
ROW_OPERATIONS_HINT = (
    "compute with rows by arithmetic, comparisons and the functions of drake_quad.framework.elementary"
)

REPLACEMENTS = {
    "absolute": "abs(x)",
    "all": "(x > 0.0) & (y > 0.0)",
    "any": "(x > 0.0) | (y > 0.0)",
    "arccos": "0.5 * math.pi - arcsin(x)",
    "arcsin": "arcsin(x)",
    "arctan": "arctan(x)",
    "arctan2": "arctan2(y, x)",
    "ceil": "where(nearest(x) < x, nearest(x) + 1.0, nearest(x))",
    "clip": "minimum(maximum(x, low), high)",
    "copysign": "where(y < 0.0, -abs(x), abs(x))",
    "cos": "cos(x)",
    "cosh": "0.5 * (exp(x) + exp(-x))",
    "deg2rad": "x * (math.pi / 180.0)",
    "erf": "erf(x)",
    "exp": "exp(x)",
    "expm1": "exp(x) - 1.0",
    "floor": "where(nearest(x) > x, nearest(x) - 1.0, nearest(x))",
    "floor_divide": "where(nearest(x / y) > x / y, nearest(x / y) - 1.0, nearest(x / y))",
    "heaviside": "where(x < 0.0, 0.0, 1.0)",
    "hypot": "sqrt(x * x + y * y)",
    "isfinite": "x - x == 0.0",
    "isnan": "x != x",
    "log": "log(x)",
    "log10": "log(x) / math.log(10.0)",
    "log1p": "log1p(x)",
    "logical_and": "(x > 0.0) & (y > 0.0)",
    "logical_not": "(x > 0.0) == 0.0",
    "logical_or": "(x > 0.0) | (y > 0.0)",
    "max": "maximum(x, y)",
    "maximum": "maximum(x, y)",
    "min": "minimum(x, y)",
    "minimum": "minimum(x, y)",
    "norm": "sqrt(dot(v, v))",
    "power": "exp(y * log(x))",
    "rad2deg": "x * (180.0 / math.pi)",
    "reciprocal": "1.0 / x",
    "remainder": "x - y * where(nearest(x / y) > x / y, nearest(x / y) - 1.0, nearest(x / y))",
    "rint": "nearest(x)",
    "round": "nearest(x)",
    "sign": "where(x < 0.0, -1.0, 1.0)",
    "sin": "sin_cos(x)[0]",
    "sinh": "0.5 * (exp(x) - exp(-x))",
    "sqrt": "sqrt(x)",
    "square": "x * x",
    "tan": "sin_cos(x)[0] / cos(x)",
    "tanh": "tanh(x)",
    "where": "where(x > 0.0, x, y)",
    "zeros_like": "0.0 * x",
}
"""Expressions that a formula may use instead of NumPy's functions, by the names of these functions.

The names in the expressions are rows, `math`, and the functions of `drake_quad.framework.elementary`; v is a list of
rows.
"""

# Further functions of NumPy and `math`, each with the key of `REPLACEMENTS` whose expression also replaces it. Most of
# these functions are aliases of the key.
_KEYS_OF_OTHER_FUNCTIONS = {
    "abs": "absolute",
    "acos": "arccos",
    "amax": "max",
    "amin": "min",
    "around": "round",
    "asin": "arcsin",
    "atan": "arctan",
    "atan2": "arctan2",
    "degrees": "rad2deg",
    "fabs": "absolute",
    "float_power": "power",
    "fmax": "maximum",
    "fmin": "minimum",
    "interp": "where",
    "invert": "logical_not",
    "mod": "remainder",
    "piecewise": "where",
    "pow": "power",
    "radians": "deg2rad",
    "select": "where",
}
_NUMPY_FOLDER = str(Path(np.__file__).parent)


def replacement(name: str) -> str | None:
    """Return the expression that a formula may use instead of a function of NumPy or `math`; None if there is none."""
    return REPLACEMENTS.get(_KEYS_OF_OTHER_FUNCTIONS.get(name, name))


def names_and_replacements() -> list[tuple[list[str], str]]:
    """Return the names of the functions that have the same replacement, and this replacement."""
    names: dict[str, list[str]] = {}
    for name in sorted([*REPLACEMENTS, *_KEYS_OF_OTHER_FUNCTIONS]):
        names.setdefault(REPLACEMENTS[_KEYS_OF_OTHER_FUNCTIONS.get(name, name)], []).append(name)
    return [(each, expression) for expression, each in names.items()]


def unsupported_operation(function: str, expression: str | None) -> TypeError:
    """Return the TypeError for a function or operator that a formula cannot apply to rows.

    Args:
        function: description of the function or operator, such as `numpy.sin`.
        expression: expression that a formula may use instead; None if there is none.
    """
    hint = (
        f"use {expression} instead, with the functions of drake_quad.framework.elementary"
        if expression
        else ROW_OPERATIONS_HINT
    )
    return TypeError(f"{function} does not accept a row, the values of a quantity for all vehicles; {hint}")


def numpy_function_error(name: str) -> TypeError:
    """Return the TypeError for a function of NumPy or `scipy.special` that a formula cannot apply to rows."""
    modules = {"numpy": np, "numpy.linalg": np.linalg}
    module = next((module for module, contents in modules.items() if hasattr(contents, name)), "scipy.special")
    return unsupported_operation(f"{module}.{name}", replacement(name))


def power_error(exponent: object) -> TypeError:
    """Return the TypeError for the operator `**`, which a formula cannot apply to rows."""
    known = {2: "x * x", 3: "x * x * x", 0.5: "sqrt(x)"}
    return unsupported_operation(
        "`**`", known.get(exponent, replacement("power")) if isinstance(exponent, int | float) else None
    )


def explain_formula_error(error: Exception) -> str:
    """Return the message of an error in a formula, reworded for an author who does not know symbols."""
    message = str(error)
    if function := re.search(r"type Symbol which has no callable (\w+) method", message):
        return str(numpy_function_error(function[1]))
    if isinstance(error, AttributeError):
        fields = getattr(type(error.obj), "_fields", ())
        expression, question = replacement(error.name or ""), did_you_mean(error.name, fields)
        if question or expression:
            return f"{message}; {question or f'use {expression} of drake_quad.framework.elementary'}"
    if "valid indices" in message:
        return f"{message}; a row cannot be an index: use where(condition, x, y) of drake_quad.framework.elementary"
    if "dtype('O')" in message:  # the type of an array of symbols
        return f"{message}; functions of NumPy do not accept rows: {ROW_OPERATIONS_HINT}"
    if "Symbol" in message:
        explanation = "a Symbol is a row, a number for each vehicle, without elements or methods"
        return f"{message}; {explanation}: {ROW_OPERATIONS_HINT}"
    return message


def calling_numpy_function() -> str | None:
    """Return the name of the NumPy function that called the caller of this function.

    Returns:
        Name of NumPy's outermost function in Python, such as `clip` if NumPy's `clip` calls its `maximum`; None if no
        Python function of NumPy called the caller.
    """
    frame, name = sys._getframe(2), None
    while frame is not None and frame.f_code.co_filename.startswith(_NUMPY_FOLDER):
        frame, name = frame.f_back, frame.f_code.co_name  # type: ignore[assignment]
    return name
