"""Tests that machine code computes the same results as Python."""

import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drake_quad.framework import elementary, kernels
from drake_quad.framework.formulas import TIME, kernel
from drake_quad.framework.instructions import Rows, Store, function
from drake_quad.framework.machine_code import LANES
from drake_quad.framework.records import ROW, layout_of
from drake_quad.framework.symbols import Listing
from drake_quad.signals import Row


def run_on_arrays(formula: Callable[..., Row], sources: list[np.ndarray]) -> np.ndarray:
    """Run the machine code of a formula on arrays (n,), and return the result."""
    result = np.empty_like(sources[0])
    kernel(formula, (ROW,) * len(sources), (ROW,), single_vehicle=False)(result.size, 0.0, result, *sources)
    return result


def machine(formula: Callable[..., Row], *arguments: float) -> float:
    """Run the machine code of a formula on numbers, and return the result."""
    return float(run_on_arrays(formula, [np.array([argument]) for argument in arguments])[0])


def sine(x):
    return elementary.sin_cos(x)[0]


def there_and_back(x):
    return elementary.from_uint64(elementary.to_uint64(x))


def lower_half(x, y):
    return elementary.from_uint64((elementary.to_uint64(x) + elementary.to_uint64(y)) & np.uint64(2**26 - 1))


def small_arctan(x):
    return elementary.arctan(x, small=True)


def small_arcsin(x):
    return elementary.arcsin(x, small=True)


def numbers_in(*intervals):
    """Return numbers in intervals (low, high): the ends, uniform numbers, and numbers of all orders of magnitude."""
    random, numbers = np.random.default_rng(0), []
    for low, high in intervals:
        sizes = 10.0 ** random.uniform(-300.0, math.log10(max(abs(low), abs(high))), 1000)
        candidates = np.concatenate([[low, high, 0.0, 1.0, -1.0], random.uniform(low, high, 1000), sizes, -sizes])
        numbers.append(candidates[(low <= candidates) & (candidates <= high)])
    return np.concatenate(numbers)


# Ranges (lowest, highest) of arguments.
WIDE_RANGES = (-700.0, 700.0), (-4.0, 4.0), (-1e-8, 1e-8)
POSITIVE_RANGES = (1e-300, 1e300), (0.5, 2.0)
# Function, reference implementation, and ranges of arguments.
FUNCTIONS_AND_RANGES = [
    (sine, math.sin, [(-1e6, 1e6), (-4.0, 4.0)]),
    (elementary.cos, math.cos, [(-1e6, 1e6), (-4.0, 4.0)]),
    (elementary.exp, math.exp, WIDE_RANGES),
    (elementary.tanh, math.tanh, [*WIDE_RANGES, (-0.7, 0.7)]),
    (elementary.erf, math.erf, [*WIDE_RANGES, (-7.0, 7.0), (-1.1, 1.1)]),
    (elementary.log, math.log, POSITIVE_RANGES),
    (elementary.log1p, math.log1p, [*POSITIVE_RANGES, (1e-300, 1e-8)]),
    (elementary.arctan, math.atan, [*WIDE_RANGES, (-1e30, 1e30)]),
    (elementary.arcsin, math.asin, [(-1.0, 1.0)]),
    (small_arctan, math.atan, [(-0.125, 0.125)]),
    (small_arcsin, math.asin, [(-0.5, 0.5)]),
    (elementary.sqrt, math.sqrt, POSITIVE_RANGES),
]


@pytest.mark.parametrize(
    ("function", "expected", "intervals"), FUNCTIONS_AND_RANGES, ids=lambda each: getattr(each, "__name__", "")
)
def test_a_function_is_within_two_units_in_the_last_place(function, expected, intervals):
    x = numbers_in(*intervals)
    desired = np.array([expected(number) for number in x.tolist()])
    error = np.abs(run_on_arrays(function, [x]) - desired)
    # Near a zero of the sine, the rounding error of the angle determines the accuracy.
    accurate = (error <= 2.0 * np.spacing(np.abs(desired))) | (error < 1e-16 * np.abs(x))
    assert accurate.all(), x[~accurate]


def test_functions_of_two_arguments_are_accurate():
    x = numbers_in(*WIDE_RANGES)
    y = np.random.default_rng(1).permutation(x)
    angle = np.array([*map(math.atan2, y.tolist(), x.tolist())])
    error = np.abs(run_on_arrays(elementary.arctan2, [y, x]) - angle)
    assert (error <= 2.0 * np.spacing(np.abs(angle))).all()
    np.testing.assert_array_equal(run_on_arrays(elementary.maximum, [x, y]), np.maximum(x, y))
    np.testing.assert_array_equal(run_on_arrays(elementary.minimum, [x, y]), np.minimum(x, y))
    wrapped = run_on_arrays(elementary.wrap_angle, [x])
    np.testing.assert_allclose([math.remainder(each, math.tau) for each in (wrapped - x).tolist()], 0.0, atol=2e-13)
    assert np.abs(wrapped).max() <= math.pi + 1e-15
    np.testing.assert_array_equal(run_on_arrays(elementary.nearest, [x]), np.rint(x))


INTEGERS = st.integers(0, 2**52 - 1) | st.integers(0, 9)  # whole numbers that a float represents exactly


@settings(max_examples=50)
@given(INTEGERS, INTEGERS)
def test_words_have_the_arithmetic_of_64_bit_integers(x, y):
    """Sums, products, shifts and bitwise operations of 64-bit words are computed modulo 2**64."""
    assert machine(there_and_back, float(x)) == x
    assert machine(lower_half, float(x), float(y)) == (x + y) % 2**26


def test_functions_of_nan_infinity_and_zero_have_defined_results():
    inf, nan = math.inf, math.nan
    for x in (inf, -inf, nan, 2e6):
        assert math.isnan(machine(sine, x))
        assert math.isnan(machine(elementary.cos, x))
    for x in (1.1, -2.0, nan):
        assert math.isnan(machine(elementary.arcsin, x))
    assert machine(elementary.exp, inf) == inf
    assert machine(elementary.exp, -inf) == 0.0
    assert machine(elementary.exp, 800.0) == inf
    assert math.isnan(machine(elementary.exp, nan))
    assert machine(elementary.tanh, inf) == 1.0
    assert machine(elementary.tanh, -inf) == -1.0
    assert machine(elementary.erf, inf) == 1.0
    assert machine(elementary.erf, -inf) == -1.0
    assert math.isnan(machine(elementary.erf, nan))
    assert math.isnan(machine(elementary.tanh, nan))
    assert machine(elementary.log, 0.0) == -inf
    # Subnormal numbers count as zero.
    assert machine(elementary.log, 2.0**-1022) == math.log(2.0**-1022)
    assert machine(elementary.log, 0.9 * 2.0**-1022) == machine(elementary.log, 5e-324) == -inf
    assert machine(elementary.log, inf) == inf
    assert math.isnan(machine(elementary.log, -1.0))
    assert machine(elementary.arctan, inf) == math.pi / 2
    assert math.isnan(machine(elementary.sqrt, -1.0))
    # The second argument replaces a first argument of NaN. Zeros have signs.
    assert machine(elementary.maximum, nan, 1.0) == machine(elementary.minimum, nan, 1.0) == 1.0
    assert math.isnan(machine(elementary.maximum, 1.0, nan))
    for y in (0.0, -0.0):
        for x in (0.0, -0.0, 1.0, -1.0):
            assert machine(elementary.arctan2, y, x) == math.atan2(y, x)
            assert math.copysign(1.0, machine(elementary.arctan2, y, x)) == math.copysign(1.0, math.atan2(y, x))


# Hypothesis strategy for variables and numbers as Python text.
LEAF_EXPRESSIONS = st.sampled_from(["x", "y"]) | st.floats(-10.0, 10.0).map(lambda number: repr(round(number, 3)))
UNARY_EXPRESSIONS = (
    "-({})",
    "abs({})",
    "sin_cos({})[0]",
    "cos({})",
    "arctan({})",
    "exp(minimum({}, 3.0))",
    "sqrt(abs({}))",
)
# NumPy does not specify the sign of a zero that `maximum` and `minimum` return, and arctan2 depends on it. Adding 0.0
# makes every zero positive.
BINARY_EXPRESSIONS = (
    "({} + {})",
    "({} - {})",
    "({} * {})",
    "({} / (1.0 + abs({})))",
    "maximum({}, {})",
    "minimum({}, {})",
    "arctan2({} + 0.0, {})",
    "where({0} > {1}, {0}, 2.0 * {1})",
    "where(({0} <= {1}) & ({0} != 1.0) | ({1} >= 2.0), {1}, {0})",
    "lazy_where({0} > {1}, lambda a, b: sqrt(abs(a)) - a * b, ({0}, {1}), {1})",
)


def expressions_of(inside):
    """Return a Hypothesis strategy for expressions that contain given expressions."""
    one = st.tuples(st.sampled_from(UNARY_EXPRESSIONS), inside).map(lambda pair: pair[0].format(pair[1]))
    two = st.tuples(st.sampled_from(BINARY_EXPRESSIONS), inside, inside).map(
        lambda triple: triple[0].format(*triple[1:])
    )
    return one | two


@pytest.mark.long
@settings(max_examples=60)
@given(st.recursive(LEAF_EXPRESSIONS, expressions_of, max_leaves=12), st.integers(0, 2**32 - 1))
@example("arctan2(maximum(0.0, -0.0 / (1.0 + abs(x))) + 0.0, x)", 1)
def test_random_expressions_agree_with_numpy(text, seed):
    formula = eval(f"lambda x, y: {text}", vars(elementary).copy())
    x, y = np.random.default_rng(seed).uniform(-5.0, 5.0, (2, LANES + 3))
    expected = np.broadcast_to(formula(x, y), x.shape)
    actual = run_on_arrays(formula, [x, y])
    # One element may differ, because rounding errors can change the result of a comparison.
    assert np.isclose(actual, expected, rtol=1e-9, atol=1e-9).sum() >= len(x) - 1


class Position(NamedTuple):
    x: Row
    y: Row


class Pose(NamedTuple):
    place: Position
    angle: tuple[Row]


def scaled_rotation(place: Position, angle: tuple[Row], scale: tuple[Row], time: Row, offset: float) -> Pose:
    (by,), (factor,) = angle, scale
    s, c = elementary.sin_cos(by)
    rotated = Position(factor * (c * place.x - s * place.y) + offset, factor * (s * place.x + c * place.y))
    return Pose(rotated, (by + time,))


@pytest.mark.parametrize("n", [1, 2, LANES - 1, LANES, LANES + 1, 3 * LANES + 5])
def test_results_of_a_single_vehicle_and_in_a_fleet_are_bitwise_equal(n):
    rng = np.random.default_rng(n)
    position, angle, scale = rng.normal(size=2 * n), rng.normal(size=n), rng.normal(size=n)
    one = layout_of(tuple[Row])
    arguments = (layout_of(Position), one, one, TIME, 0.25)
    fleet = kernel(scaled_rotation, arguments, (layout_of(Position), one), single_vehicle=n == 1)
    single = kernel(scaled_rotation, arguments, (layout_of(Position), one), single_vehicle=True)
    fleet_position, fleet_angle = np.empty(2 * n), np.empty(n)
    fleet(n, 3.0, fleet_position, fleet_angle, position, angle, scale)
    for i in range(n):
        single_position, single_angle = np.empty(2), np.empty(1)
        single(1, 3.0, single_position, single_angle, position[i::n].copy(), angle[i::n].copy(), scale[i::n].copy())
        np.testing.assert_array_equal(single_position, fleet_position[i::n])
        np.testing.assert_array_equal(single_angle, fleet_angle[i::n])
    expected = scaled_rotation(Position(*position.reshape(2, n)), (angle,), (scale,), 3.0, 0.25)
    np.testing.assert_allclose(fleet_position.reshape(2, n), expected.place, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("n", [1, LANES + 3])
def test_an_output_array_may_also_be_an_input(n):
    values = np.arange(2.0 * n)
    swap = kernel(
        lambda position: Position(position.y, position.x),
        (layout_of(Position),),
        (layout_of(Position),),
        single_vehicle=n == 1,
    )
    swap(n, 0.0, values, values)
    np.testing.assert_array_equal(values, [*range(n, 2 * n), *range(n)])


def test_array_elements_beyond_the_last_vehicle_are_not_written():
    n = LANES + 3
    values = np.arange(float(2 * LANES))
    run = kernel(lambda x: x + 1.0, (ROW,), (ROW,), single_vehicle=False)
    run(n, 0.0, values, values)
    np.testing.assert_array_equal(values, [*np.arange(1.0, n + 1.0), *np.arange(n, 2.0 * LANES)])


def test_a_product_is_rounded_before_it_is_added():
    x, y, z = 1.0 + 2.0**-30, 1.0 - 2.0**-30, -1.0
    assert machine(lambda x, y, z: x * y + z, x, y, z) == x * y + z == 0.0


def test_numpy_scalars_can_be_operands_of_rows():
    """Like a Python number, a NumPy scalar may be on either side of an operator."""
    two = np.float64(2.0)
    x = 3.0
    formulas = [
        lambda x: two + x,
        lambda x: two - x,
        lambda x: x - two,
        lambda x: two * x,
        lambda x: two / x,
        lambda x: np.negative(x),
        lambda x: np.abs(x) - np.add(x, two),
        lambda x: elementary.where(two < x, 1.0, 0.0),
        lambda x: elementary.where(two >= x, 1.0, 0.0),
        lambda x: elementary.where((two != x) & (x == np.float64(3.0)), 1.0, 0.0),
    ]
    for formula in formulas:
        assert machine(formula, x) == formula(x)


class Polar(NamedTuple):
    length: Row
    slope: Row


def polar(x: Row, y: Row) -> Polar:
    return Polar(elementary.sqrt(x * x + y * y), y / x)


def seldom_polar(x: Row, y: Row, bound: Row) -> Polar:
    return elementary.lazy_where(x > bound, polar, (x, y), Polar(y, -1.0))


def nested(x: Row, y: Row, bound: Row) -> Row:
    """Use a branch twice with different arguments, once inside another branch, and compute with the results."""

    def inside(x: Row, y: Row) -> Row:
        length, slope = elementary.lazy_where(y > 0.0, polar, (x, y), (x, 0.5))
        return length + elementary.lazy_where(slope > 1.0, lambda y: elementary.sqrt(abs(y)), (y,), 2.0)

    first = elementary.lazy_where(x > bound, inside, (x, y), x)
    return first / (3.0 + abs(elementary.lazy_where(first < y, inside, (y, first), 0.25)))


# Masks of no vehicles, of all vehicles, and of every seventh vehicle.
VEHICLE_MASKS = [np.zeros(3 * LANES + 5, bool), np.ones(3 * LANES + 5, bool), np.arange(3 * LANES + 5) % 7 == 3]


@pytest.mark.parametrize("needed", VEHICLE_MASKS, ids=("none", "all", "some"))
@pytest.mark.parametrize("n", [1, LANES - 1, LANES, 3 * LANES + 5])
@pytest.mark.parametrize("single_vehicle", [True, False])
def test_lazy_where_and_where_are_bitwise_equal(needed, n, single_vehicle):
    rng = np.random.default_rng(n)
    x, y = rng.uniform(0.5, 2.0, (2, n))
    bound = np.where(needed[:n], x - 0.1, x + 0.1)
    expected = elementary.where(x > bound, polar(x, y), Polar(y, -1.0))
    np.testing.assert_array_equal(seldom_polar(x, y, bound), expected)
    run = kernel(seldom_polar, (ROW, ROW, ROW), (layout_of(Polar),), single_vehicle=single_vehicle)
    if not single_vehicle:
        actual = np.full((2, n), np.nan)
        run(n, 0.0, actual, x, y, bound)
        np.testing.assert_array_equal(actual, expected)
    for i in range(n):
        single, one = np.full(2, np.nan), [np.array([row[i]]) for row in (x, y, bound)]
        run(1, 0.0, single, *one)
        np.testing.assert_array_equal(single, np.array(expected)[:, i])
        assert seldom_polar(*(float(row[0]) for row in one)) == tuple(np.array(expected)[:, i].tolist())


@pytest.mark.parametrize("n", [1, LANES, 3 * LANES + 5])
def test_branches_can_be_nested(n):
    rng = np.random.default_rng(n)
    rows = [*rng.normal(size=(3, n))]
    expected = nested(*rows)
    np.testing.assert_array_equal(run_on_arrays(nested, rows), expected)
    np.testing.assert_array_equal([nested(*each) for each in np.transpose(rows).tolist()], expected)


def test_lazy_where_can_return_several_rows():
    def formula(x: Row, y: Row) -> Row:
        mask = x > 0.0
        return elementary.lazy_where(mask, polar, (x, y), Polar(y, x)).slope - (
            2.0 * elementary.lazy_where(mask, polar, (y, x), Polar(x, y)).slope
        )

    rows = [*np.random.default_rng(2).normal(size=(2, 2 * LANES))]
    np.testing.assert_array_equal(run_on_arrays(formula, rows), formula(*rows))


def test_the_same_branch_can_be_selected_twice_with_different_other_rows():
    """The other rows of the second selection depend on the first one, so they follow the call of the branch."""

    def formula(x: Row, y: Row) -> Row:
        first = elementary.lazy_where(x > 0.0, polar, (x, y), Polar(y, x))
        second = elementary.lazy_where(x > 0.0, polar, (x, y), Polar(first.length + 1.0, first.slope - y))
        return elementary.where(y > 0.0, first.length, second.length) + second.slope

    for sign in (-1.0, 1.0):
        rows = [*np.random.default_rng(3).normal(size=(2, 2 * LANES))]
        rows[0] = sign * abs(rows[0])
        rows[0][:LANES] *= np.where(np.arange(LANES) % 3, 1.0, -1.0)
        np.testing.assert_array_equal(run_on_arrays(formula, rows), formula(*rows))


def test_selecting_the_results_of_a_branch_takes_no_time_if_no_vehicle_needs_it():
    listing = Listing()
    x, y = listing.row(0, 0), listing.row(0, 1)
    result = elementary.lazy_where(x > 0.0, polar, (x, y), Polar(y, -1.0))
    stores = [Store(Rows("%rows", LANES), row, symbol) for row, symbol in enumerate(result)]
    code = function(
        "@f(ptr %rows)", listing, stores, {0: Rows("%rows", LANES)}, shared="", lanes=LANES, overlapping=False
    )
    before, inside, after = re.split(r"\n  (?:needed|beyond)_\d+:\n", code.split("define internal void @f(")[1])
    assert [" = select " in part for part in (before, inside, after)] == [False, True, False]
    assert after.count(" = phi ") == 2


def test_branches_accept_and_return_booleans_and_64_bit_words():
    def inside(word: Any, truth: bool, x: Row) -> tuple[Any, bool]:
        return word + elementary.to_uint64(abs(x)), truth & (x > 2.0)

    def formula(x: Row, y: Row) -> Row:
        word, truth = elementary.to_uint64(x), y > 1.0
        sums, both = elementary.lazy_where(x > 1.0, inside, (word, truth, y), (word, truth))
        return elementary.where(both, elementary.from_uint64(sums), -1.0)

    x, y = np.random.default_rng(1).integers(0, 5, (2, 4 * LANES)).astype(float)
    expected = np.where(y > np.where(x > 1.0, 2.0, 1.0), np.where(x > 1.0, x + y, x), -1.0)
    np.testing.assert_array_equal(run_on_arrays(formula, [x, y]), expected)
    np.testing.assert_array_equal(formula(x, y), expected)


def test_the_function_where_returns_the_row_itself_if_both_alternatives_are_the_same_row():
    listing = Listing()
    x = listing.row(0, 0)
    assert elementary.where(x > 0.0, x, listing.row(0, 0)).line == x.line
    assert elementary.where(x > 0.0, x, listing.row(0, 1)).line != x.line
    assert [operation.name for operation in listing.operations].count("select") == 1


def test_equal_branches_share_one_separate_function():
    listing = Listing()
    x, y, bound = (listing.row(0, index) for index in range(3))
    results = [*seldom_polar(x, y, bound), *seldom_polar(y, x, bound)]
    assert {operation.name for operation in listing.operations} == {"row", "constant", "greater", "branch", "select"}
    text = kernels._module(listing, results, [3], [4], LANES)
    # Both calls of the branch share one function of the machine code.
    assert text.count("fdiv") == text.count("define internal void @block_0(") == 1
    assert text.count("call void @block_0(") == 2


def test_a_constant_mask_needs_no_branch():
    listing = Listing()
    x = listing.row(0, 0)
    taken = []

    def doubled(x: Row, factor: Row) -> Row:
        taken.append(factor)
        return x * factor

    assert elementary.lazy_where(False, doubled, (x, 2.0), 7.0) == 7.0
    assert taken == []
    assert elementary.lazy_where(True, doubled, (x, 2.0), 7.0).line == doubled(x, 2.0).line
    assert "branch" not in {operation.name for operation in listing.operations}
    elementary.lazy_where(x > 0.0, doubled, (x, 2.0), 7.0)
    assert taken == [2.0, 2.0, 2.0]
    # A formula with a constant result needs no function.
    results = [elementary.lazy_where(x > 0.0, lambda: 3.0, (), x)]
    assert machine(lambda x: elementary.lazy_where(x > 0.0, lambda: 3.0, (), x), 1.0) == 3.0
    assert results[0].listing is listing


def test_a_branch_that_uses_rows_that_are_not_arguments_is_refused():
    def summed(x: Row, y: Row) -> Row:
        return elementary.lazy_where(x > 0.0, lambda x: x + y, (x,), 0.0)

    def passed(x: Row, y: Row) -> Row:
        return elementary.lazy_where(x > 0.0, lambda x: y, (x,), 0.0)

    for formula in (summed, passed):
        with pytest.raises(TypeError, match="uses a row that is not one of its arguments"):
            machine(formula, 1.0, 2.0)


def test_a_formula_with_results_of_another_layout_is_refused():
    def placed(x: Row) -> Position:
        return Position(x, x)

    with pytest.raises(TypeError, match="formula placed: expected Pose, not Position"):
        kernel(placed, (ROW,), (layout_of(Pose),), single_vehicle=True)
    with pytest.raises(TypeError, match="formula placed: expected a number or a row, not Position"):
        kernel(placed, (ROW,), (ROW,), single_vehicle=True)
    with pytest.raises(TypeError, match="formula placed: expected 3 results"):
        kernel(placed, (ROW,), (ROW, ROW, ROW), single_vehicle=True)


# Program that prints the result of a compiled formula, and the number of modules that it compiled.
CACHING_PROGRAM = """
import numpy as np
from drake_quad.framework import machine_code
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import ROW
import user_formula

compiled = []
compile_text = machine_code._compile
machine_code._compile = lambda text: (compiled.append(text), compile_text(text))[1]
result = np.empty(1)
kernel(user_formula.doubled_drag, (ROW,), (ROW,), single_vehicle=True)(1, 0.0, result, np.array([3.0]))
print(float(result[0]), len(compiled))
"""


def run(folder, cache):
    environment = {
        **os.environ,
        "DRAKE_QUAD_CACHE": str(cache),
        "PYTHONPATH": f"{folder}{os.pathsep}{os.pathsep.join(sys.path)}",
    }
    done = subprocess.run(
        [sys.executable, "-B", "-c", CACHING_PROGRAM],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
    )
    value, compiled = done.stdout.split()
    return float(value), int(compiled)


@pytest.mark.long
def test_machine_code_is_cached_and_recompiled_when_a_module_that_it_uses_changes(tmp_path):
    cache = tmp_path / "cache"
    (tmp_path / "user_drag.py").write_text("def drag(x):\n    return 0.5 * x\n")
    # The formula uses the module through an attribute and a closure, so its own source text does not change.
    (tmp_path / "user_formula.py").write_text(
        "import user_drag\n\ndef twice(f):\n    return lambda x: 2.0 * f(x)\n\n"
        "doubled_drag = twice(lambda x: user_drag.drag(x))\n"
    )
    assert run(tmp_path, cache) == (3.0, 1)
    assert run(tmp_path, cache) == (3.0, 0)
    (tmp_path / "user_drag.py").write_text("def drag(x):\n    return 0.75 * x\n")
    assert run(tmp_path, cache) == (4.5, 1)
    assert len([*cache.iterdir()]) == 2


@pytest.mark.long
def test_damaged_machine_code_is_recompiled(tmp_path):
    (tmp_path / "user_formula.py").write_text("def doubled_drag(x):\n    return 2.0 * x\n")
    cache = tmp_path / "cache"
    assert run(tmp_path, cache) == (6.0, 1)
    (file,) = cache.iterdir()
    content = file.read_bytes()
    for damaged in (b"", content[: len(content) // 2], bytes([content[0] ^ 1]) + content[1:]):
        file.write_bytes(damaged)
        assert run(tmp_path, cache) == (6.0, 1)
    assert file.read_bytes() == content


@pytest.mark.long
def test_every_process_compiles_if_there_is_no_cache_folder(tmp_path):
    (tmp_path / "user_formula.py").write_text("def doubled_drag(x):\n    return 2.0 * x\n")
    (tmp_path / "file").write_text("")
    for cache in ("", tmp_path / "file" / "cache"):
        assert run(tmp_path, cache) == (6.0, 1)
