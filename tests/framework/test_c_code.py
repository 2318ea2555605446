"""Tests of the C code of single formulas."""

import ctypes
import shutil
import subprocess
from fractions import Fraction

import numpy as np
import pytest

from drake_quad.framework import elementary
from drake_quad.framework.c_code import (
    DOUBLE,
    EXPRESSIONS,
    MULTIPLY_ADD_FUNCTION,
    SINGLE,
    WORD_FUNCTIONS,
    Body,
    Functions,
    constant_text,
    function_text,
    identifier,
    wrapped,
)
from drake_quad.framework.instructions import INSTRUCTIONS
from drake_quad.framework.symbols import Listing
from drake_quad.framework.variable_names import collect_names

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def expression_of(formula, num_rows, precision=DOUBLE):
    """Return statements and the expression of the result of a formula."""
    listing = Listing(calls_functions=True)
    with collect_names(listing) as names:
        result = formula(*[listing.row(0, index) for index in range(num_rows)])
    body = Body(listing, [result], row=lambda _, index: "xyz"[index], functions=Functions(precision), names=names)
    return body.lines, body.results[0].text


def compiled(text, folder):
    (folder / "code.c").write_text(f"#include <math.h>\n#include <stdint.h>\n#include <string.h>\n{text}")
    command = ["cc", "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC", "-o", "code.so", "code.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "code.so"))


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        (lambda x, y, z: x + y + z, "x + y + z"),
        (lambda x, y, z: x + (y + z), "x + (y + z)"),
        (lambda x, y, z: x - (y - z), "x - (y - z)"),
        (lambda x, y, z: x * y + z, "x * y + z"),
        (lambda x, y, z: x * (y + z), "x * (y + z)"),
        (lambda x, y, z: x / (y * z), "x / (y * z)"),
        (lambda x, y, z: -(x + y) * z, "-(x + y) * z"),
        (lambda x, y, z: x * -2.0 + y * z, "x * -2.0 + y * z"),
        (lambda x, y, z: -(y * -1.0) + x * z, "-(y * -1.0) + x * z"),
        (lambda x, y, z: 1.0 * x + y * 1.0 + 0.0 * z, "x + y + 0.0 * z"),
        (lambda x, y, z: elementary.where(x > y, y, z), "x > y ? y : z"),
        (lambda x, y, z: elementary.sqrt(abs(x)) + y * z, "sqrt(fabs(x)) + y * z"),
    ],
)
def test_parentheses_keep_the_order_of_operations(formula, text):
    assert expression_of(formula, 3) == ([], text)


def test_variables_in_c_have_the_names_of_the_local_variables_of_the_formula():
    def formula(x, y, z):
        error = x - y
        return error * z

    assert expression_of(formula, 3) == (["const double error = x - y;"], "error * z")


def test_single_precision_uses_the_functions_of_the_c_library():
    lines, text = expression_of(lambda x: elementary.exp(x) + 0.1, 1, SINGLE)
    assert (lines, text) == ([], "expf(x) + 0.1f")


def test_every_operation_of_the_machine_code_has_an_expression():
    assert EXPRESSIONS.keys() == INSTRUCTIONS.keys()


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, 0.1, 1e300, 5e-324, -(2.0**-1074), 1 / 3, np.pi, 6755399441055744.0])
def test_the_text_of_a_constant_is_read_as_the_same_number(value):
    text = constant_text(value, DOUBLE)
    assert np.float64(text).tobytes() == np.float64(value).tobytes()


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, 0.1, -1 / 3, np.pi, 6755399441055744.0])
def test_a_constant_in_single_precision_is_the_nearest_number(value):
    text = constant_text(value, SINGLE)
    assert text.endswith("f")
    assert np.float32(text[:-1]).tobytes() == np.float32(value).tobytes()


@pytest.mark.parametrize(
    ("value", "text"), [(1e-100, "1.1754944e-38f"), (-1e-300, "-1.1754944e-38f"), (-1e300, "-3.4028235e+38f")]
)
def test_constants_do_not_become_zero_or_infinite_in_single_precision(value, text):
    assert constant_text(value, SINGLE) == text


def test_infinite_constants_and_nan_are_written_as_macros_of_c():
    texts = [constant_text(value, DOUBLE) for value in (np.inf, -np.inf, np.nan)]
    assert texts == ["INFINITY", "-INFINITY", "NAN"]


@pytest.mark.parametrize(
    ("name", "valid"), [("k_p", "k_p"), ("double", "double_"), ("φ_r", "__r"), ("2d", "_2d"), ("sin", "sin_")]
)
def test_identifiers_are_valid_in_c(name, valid):
    assert identifier(name) == valid


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["sin_cos", "exp", "tanh", "erf", "log", "log1p", "arctan", "arctan2", "arcsin", "wrap_angle"]
)
def test_elementary_functions_are_bitwise_equal_to_the_machine_code(name, tmp_path):
    from drake_quad.framework.formulas import kernel
    from drake_quad.framework.records import ROW

    function = getattr(elementary, name)
    num_rows = 2 if name == "arctan2" else 1

    def formula(*rows):
        result = function(*rows)
        return result[0] + 2.0 * result[1] if isinstance(result, tuple) else result

    listing = Listing(calls_functions=True)
    functions = Functions(DOUBLE)
    result = formula(*[listing.row(0, index) for index in range(num_rows)])
    body = Body(listing, [result], row=lambda _, index: f"x[{index}][k]", functions=functions)
    lines = ["for (int k = 0; k < n; ++k) {", *body.lines, f"out[k] = {body.results[0].text};", "}"]
    run = function_text("void run(int n, double x[][n], double *out)", lines)
    text = "#include <stdbool.h>\n" + WORD_FUNCTIONS + MULTIPLY_ADD_FUNCTION + "\n".join([*functions.texts, run])
    library = compiled(text, tmp_path)
    rng = np.random.default_rng(2)
    count = 4000
    rows = rng.normal(size=(num_rows, count)) * 10.0 ** rng.uniform(-8.0, 2.5, count)
    rows[:, :8] = [0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0, 0.5]
    actual, expected = np.empty(count), np.empty(count)
    library.run(count, rows.ctypes.data_as(ctypes.c_void_p), actual.ctypes.data_as(ctypes.c_void_p))
    machine_code = kernel(formula, (ROW,) * num_rows, (ROW,), single_vehicle=False)
    machine_code(count, 0.0, expected, *np.ascontiguousarray(rows))
    same = (actual.view(np.uint64) == expected.view(np.uint64)) | (np.isnan(actual) & np.isnan(expected))
    assert same.all(), rows[:, ~same]


@needs_compiler
@pytest.mark.slow
def test_multiply_add_rounds_once_even_without_a_processor_instruction_for_it(tmp_path):
    run = """
    void run(int n, const double *x, const double *y, const double *z, double *out) {
        for (int k = 0; k < n; ++k) out[k] = multiply_add(x[k], y[k], z[k]);
    }"""
    library = compiled(f"#define _NEWLIB_VERSION 1\n{WORD_FUNCTIONS}{MULTIPLY_ADD_FUNCTION}{run}", tmp_path)
    rng = np.random.default_rng(4)
    count = 3000
    x, y, z = rng.normal(size=(3, count)) * 2.0 ** rng.integers(-40, 40, (3, count))
    third = count // 3
    z[:third] = -x[:third] * y[:third]  # `multiply_add` then returns the rounding error of the product
    x[third : 2 * third] = rng.integers(
        -(2**27), 2**27, third
    )  # products with few digits, which cause ties in rounding
    y[third : 2 * third] = rng.integers(-(2**27), 2**27, third)
    z[third : 2 * third] = rng.integers(-(2**53), 2**53, third) * 2.0 ** rng.integers(-60, 60, third)
    actual = np.empty(count)
    library.run(count, *(each.ctypes.data_as(ctypes.c_void_p) for each in (x, y, z, actual)))
    expected = [float(Fraction(a) * Fraction(b) + Fraction(c)) for a, b, c in zip(x, y, z)]
    np.testing.assert_array_equal(actual, expected)


def test_long_lines_of_c_code_are_broken_where_an_expression_ends():
    terms = [f"variable_{number}" for number in range(40)]
    lines = wrapped(f"    x = {' + '.join(terms)};")
    assert len(lines) > 4
    assert max(map(len, lines)) <= 118
    assert " ".join(line.strip() for line in lines) == f"x = {' + '.join(terms)};"
    assert {line[:8] for line in lines[1:]} == {" " * 8}
    name = f"    {'a' * 200};"
    assert wrapped(name) == [name]
