"""Tests of the execution of formulas, and of the argument `CurrentTick`, from which a formula gets the tick number."""

from typing import NamedTuple

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd

from drake_quad.framework.elementary import lazy_where, maximum, sqrt, where
from drake_quad.framework.formulas import TIME, CurrentTick, Tick, at_time, interpret, kernel, pack_rows
from drake_quad.framework.records import ABSENT, ROW, layout_of
from drake_quad.framework.symbols import operation
from drake_quad.signals import Row

TICK_PERIODS = [0.02, 0.01, 0.1, 1.0 / 3.0, 7.0, 1e-4]  # s


@pytest.mark.parametrize("period", TICK_PERIODS)
def test_a_tick_number_is_twice_the_pair_number_plus_one_for_the_second_tick_of_a_pair(period):
    """A time that differs from the time of a tick by less than half a period has the number of this tick."""
    ticks = CurrentTick(period)
    for number in [*range(9), 1001, 123_456]:
        for time in (number * period, (number + 0.3) * period, (number - 0.3) * period):
            pair, second = ticks.at(time)
            assert 2.0 * float(pair) + float(second) == number
    pairs, seconds = ticks.at(period * np.arange(7.0))
    np.testing.assert_array_equal(pairs, [0, 0, 1, 1, 2, 2, 3])
    np.testing.assert_array_equal(seconds, [False, True] * 3 + [False])


def test_ticks_have_no_derivatives():
    tick = CurrentTick(0.02).at(AutoDiffXd(0.06, [1.0]))
    assert tick == Tick(1.0, True)


def test_placeholders_are_replaced_by_the_tick_and_the_time():
    assert at_time(CurrentTick(0.5), 1.5) == Tick(1.0, True)
    assert at_time(TIME, 1.5) == 1.5
    assert at_time("x", 1.5) == "x"


@pytest.mark.parametrize(("one", "other"), [(0.0, -0.0), (-0.0, 0.0)])
def test_machine_code_distinguishes_zero_from_minus_zero(one, other):
    def scaled(x, zero):
        return x * zero

    for zero in (one, other):
        actual = np.empty(9)
        kernel(scaled, (ROW, zero), (ROW,), single_vehicle=False)(9, 0.0, actual, np.ones(9))
        np.testing.assert_array_equal(np.signbit(actual), np.signbit(zero))


def counted(x, tick, by):
    return x + 10.0 * tick.pair + where(tick.second, by, 0.0)


@pytest.mark.parametrize("n", [1, 11])
def test_formulas_get_the_same_tick_number_in_machine_code_and_in_python(n):
    arguments, x = (ROW, CurrentTick(0.02), 0.5), np.arange(float(n))
    run = kernel(counted, arguments, (ROW,), single_vehicle=n == 1)
    for number in (0, 1, 2, 3, 50, 51):
        actual = np.empty(n)
        run(n, 0.02 * number, actual, x)
        np.testing.assert_array_equal(actual, x + 10.0 * (number // 2) + 0.5 * (number % 2))
        layout = layout_of(tuple[float])
        (interpreted,) = interpret(
            lambda x, *rest: (counted(x[0], *rest),), (layout, *arguments[1:]), [x], [layout], n, 0.02 * number
        )
        np.testing.assert_array_equal(interpreted, actual)


class Parts(NamedTuple):
    one: Row
    nothing: Tick | None
    two: Row


def test_absent_results_are_omitted():
    def parts(x):
        return Parts(x, None, 2.0 * x)

    actual = interpret(parts, (ROW,), [np.array([1.0, 3.0])], (ROW, ABSENT, ROW), 2, 0.0)
    np.testing.assert_array_equal(actual, [[1.0, 3.0], [2.0, 6.0]])


def test_an_operation_without_symbols_cannot_be_recorded():
    with pytest.raises(TypeError, match="none of the operands is a symbol"):
        operation("add", 1.0, 2.0)


@pytest.mark.parametrize("n", [1, 3])
def test_rows_are_packed_one_after_another(n):
    """A row contains one number, or one number per vehicle. Rows of other sizes are refused."""
    row = np.arange(1.0, n + 1.0)
    np.testing.assert_array_equal(
        pack_rows([2.0, row, np.array(5.0), True], n), [*[2.0] * n, *row, *[5.0] * n, *[1.0] * n]
    )
    assert pack_rows([1.0, AutoDiffXd(2.0, [1.0])], n).dtype == object
    with pytest.raises(ValueError, match=r"size 1|shape \(2,\)"):
        pack_rows([np.zeros(2)], n)


def test_the_function_where_keeps_fields_that_are_none():
    assert where(np.array([True, False]), Parts(1.0, None, 2.0), Parts(3.0, None, 4.0)).nothing is None


@pytest.mark.parametrize("n", [1, 11])
@pytest.mark.parametrize(
    "formula",
    [
        lambda x: 0.1 * (x > 0.0) + x,
        lambda x: 1.0 - (x > 0.0),
        lambda x: np.float64(2.0) * (x > 0.0),
        lambda x: (x > 0.0) * (x < 2.0),
        lambda x: (x > 0.0) & (x < 2.0),
        lambda x: (x > 0.0) == (x < 2.0),
        lambda x: x <= (x > 0.0),
        lambda x: sqrt(0.0 + (x > 0.0)),
        lambda x: maximum(x, x > 0.0),
        lambda x: where(x > 0.0, x < 2.0, x),
        lambda x: where(x > 0.0, x < 2.0, False),
        lambda x: where(x > 0.0, True, False),
        lambda x: where(x, 1.0, 2.0),
        lambda x: lazy_where(x, lambda y: y > 0.0, (x,), 3.0),
        lambda x: x > 0.0,
        lambda x: True,
    ],
)
def test_comparisons_can_be_used_as_numbers_in_machine_code_and_in_python(formula, n):
    x = np.linspace(-1.0, 3.0, n) if n > 1 else np.array([0.5])
    actual = np.full(n, np.nan)
    kernel(formula, (ROW,), (ROW,), single_vehicle=n == 1)(n, 0.0, actual, x)
    (expected,) = interpret(formula, (ROW,), [x], (ROW,), n, 0.0)
    np.testing.assert_array_equal(actual, np.asarray(expected, dtype=float))


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        (lambda x: (x > 0.0) + (x < 2.0), r"comparisons cannot be added.*use where\(comparison, 1.0, 0.0\)"),
        (lambda x: -(x > 0.0), r"comparisons cannot be added.*use where\(comparison, 1.0, 0.0\)"),
        (lambda x: x & (x > 0.0), "must be comparisons, not numbers"),
        (lambda x: (x > 0.0) | x, "must be comparisons, not numbers"),
    ],
)
def test_ambiguous_operations_on_comparisons_are_refused(formula, message):
    with pytest.raises(TypeError, match=message):
        kernel(formula, (ROW,), (ROW,), single_vehicle=True)
