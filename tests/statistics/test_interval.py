"""Tests of intervals: their arithmetic, and their printed form, which contains the exact interval."""

import itertools
import math
import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drake_quad.statistics.interval import Interval, plus_minus, spread_text

EXAMPLE = Interval(value=0.2, low=0.1, high=0.4)  # estimate with an asymmetric interval
NUMBER_PATTERN = r"[+-]?[\d.]+(?:e[+-]\d+)?"


def test_negation_and_shifts_change_the_value_and_both_ends_of_an_interval():
    assert -EXAMPLE == (-0.2, -0.4, -0.1)
    assert EXAMPLE.plus(-1.0) == pytest.approx((-0.8, -0.9, -0.6))
    # The estimate is a ratio, and this is the corresponding reduction, 1 - ratio.
    assert -EXAMPLE.plus(-1.0) == pytest.approx((0.8, 0.6, 0.9))
    assert EXAMPLE.without_interval().percent() == "20.0 %"


@pytest.mark.parametrize(("level", "expected"), [(0.05, True), (0.1, None), (0.3, None), (0.4, None), (0.5, False)])
def test_a_comparison_with_a_level_within_the_interval_is_undecided(level, expected):
    assert EXAMPLE.is_above(level) is expected


def test_comparisons_on_the_unbounded_side_of_an_interval_are_undecided():
    assert Interval(1.0, math.nan, math.nan).is_above(0.0) is None
    assert Interval(1.0, 0.5, math.inf).is_above(0.0) is True
    assert Interval(1.0, -math.inf, 2.0).is_above(0.0) is None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (EXAMPLE.text(), "0.20 [0.10, 0.40]"),
        (EXAMPLE.text(unit="cm", size=0.01), "20 cm [10, 40]"),
        (EXAMPLE.metres(), "0.20 m [0.10, 0.40]"),
        ((-EXAMPLE).millimetres(), "-200 mm [-400, -100]"),
        (Interval(0.0035, -0.001, 0.008).millimetres(), "+3.5 mm [-1.0, +8.0]"),
        # Crash probability if none, one or all of 100,000 flights crash.
        (Interval(0.0, 0.0, 3.689e-5).percent(), "0 % [0, 0.0037]"),
        (Interval(1e-5, 2.53e-7, 5.57e-5).percent(), "0.00100 % [0.00002, 0.00557]"),
        (Interval(1.0, 0.9999631, 1.0).percent(), "100.0000 % [99.9963, 100.0000]"),
        (Interval(0.97, 0.93, 0.99).percent(), "97.0 % [93.0, 99.0]"),
        # An end that differs from 100 %, or for a ratio from 1, is not rounded to this level.
        (Interval(0.75, 0.19412, 0.99369).percent(), "75.0 % [19.4, 99.4]"),
        (Interval(0.96, 0.923, 0.9981).percent(), "96.0 % [92.3, 99.9]"),
        (Interval(1.06, 1.0003, 1.13).ratio(), "1.0600 [1.0003, 1.1300]"),
        (Interval(-0.9516, -0.9533, -0.95002).text(), "-0.9516 [-0.9533, -0.9500]"),
        (Interval(3.47131e-5, 3.469e-5, 3.4733e-5).text(unit="N s²"), "3.4713e-05 N s² [3.4690e-05, 3.4733e-05]"),
        (Interval(1.002e9, 0.99e9, 1.1e9).text(), "1.002e+09 [0.990e+09, 1.100e+09]"),
        (Interval(1234567.0, 1234000.0, 1235000.0).text(), "1234567 [1234000, 1235000]"),
        # An estimate that rounds to zero is printed without a sign.
        (Interval(-0.001, -1.2, 1.3).text(), "0.0 [-1.2, 1.3]"),
        # The mean of equal values differs from them by a rounding error.
        (Interval(0.1, 0.1 - 1e-17, 0.1 + 2e-17).text(), "0.100 [0.100, 0.100]"),
        (Interval(0.0, -1e-20, 1.0).text(), "0 [0, 1.0]"),
        (Interval(1.0, 1.0, 1.0).percent(), "100 % [100, 100]"),
        # An end that would be rounded to zero or to 100 % gets additional digits.
        (Interval(0.05, 0.0004, 0.1).text(), "0.0500 [0.0004, 0.1000]"),
        (Interval(0.95, 0.9, 0.9996).percent(), "95.00 % [90.00, 99.96]"),
        # Some estimates have no interval, and some have an unbounded interval.
        (Interval(0.5, math.nan, math.nan).percent(), "50.0 %"),
        (Interval(123456.0, math.nan, math.nan).text(), "123456"),
        (Interval(0.5, 0.0, math.inf).percent(), "50 % [0, ∞]"),
        (Interval(0.5, -math.inf, math.inf).text(), "0.500 [-∞, ∞]"),
        (Interval(0.5, -math.inf, 0.7).text(), "0.50 [-∞, 0.70]"),
        (Interval(math.nan, 0.0, 1.0).text(), "–"),
        # A flight with a crash has an infinite error.
        (Interval(math.inf, math.inf, math.inf).text(infinities=("-∞", "crash")), "crash"),
        (Interval(math.inf, -math.inf, math.inf).text(infinities=("-∞", "crash")), "crash"),
        (Interval(0.5, -math.inf, 0.6).text(infinities=("crash", "∞")), "0.50 [crash, 0.60]"),
        (Interval(math.inf, 0.5, math.inf).text(infinities=("-∞", "crash")), "crash [0.500, crash]"),
        (Interval(0.5, 0.4, math.inf).text(infinities=("-∞", "crash")), "0.50 [0.40, crash]"),
        (plus_minus(5.4321, 0.0351), "5.432 ± 0.036"),
        (plus_minus(3.47131e-5, 2.1e-8), "3.4713e-05 ± 0.0021e-05"),
        (plus_minus(123.4, 31.2), "123 ± 32"),
        (plus_minus(5.4321, 0.0), "5.43 ± 0"),
        (plus_minus(5.4321, math.inf), "5.43 ± ∞"),
        (spread_text(0.00441), "± 0.0045"),
        (spread_text(441.0), "± 441"),
        (spread_text(math.inf), "± ∞"),
    ],
    # The names of the tests must not depend on the results. Otherwise, the mutation test does not find them.
    ids=itertools.count(),
)
def test_intervals_are_printed_with_the_right_digits(text, expected):
    assert text == expected


sizes = st.tuples(st.floats(1.0, 10.0), st.integers(-9, 9)).map(lambda parts: parts[0] * 10.0 ** parts[1])
gaps = st.one_of(st.just(0.0), st.floats(1.0, 10.0).flatmap(lambda f: st.integers(-5, 2).map(lambda k: f * 10.0**k)))


@pytest.mark.long
@settings(max_examples=400)
@given(sizes, st.sampled_from((-1.0, 0.0, 1.0)), gaps, gaps, st.sampled_from((1.0, 0.01, 1e-3)))
@example(1e-3, 0.0, 0.0, 1e-3, 0.01)
@example(0.95163, -1.0, 1.7e-3, 1.6e-3, 1.0)
def test_the_printed_interval_contains_the_exact_one_and_its_ends_differ_from_the_estimate(
    size, sign, below, above, unit
):
    """The estimate, and the distances of both ends from the estimate, are random."""
    value = sign * size
    exact = Interval(value, value - below * size, value + above * size)
    text = exact.text(size=unit)
    printed, low, high = (float(number) * unit for number in re.findall(NUMBER_PATTERN, text))
    largest = max(map(abs, exact))
    rounding = 1e-10 * largest
    assert low <= exact.low + rounding or not below
    assert high >= exact.high - rounding or not above
    assert low <= printed <= high
    assert (low < printed) == (exact.low < exact.value)
    assert (printed < high) == (exact.value < exact.high)
    # Rounding moves an end by less than one unit of the last digit, and the estimate by at most half a unit. This unit
    # is at most a twentieth of the width of the interval. If one end equals the estimate, the unit is at most a tenth.
    assert high - low <= (1.1 if min(below, above) else 1.15) * (exact.high - exact.low) + rounding


@pytest.mark.slow
@settings(max_examples=200)
@given(sizes, sizes)
def test_a_spread_is_rounded_up_by_less_than_a_tenth(value, spread):
    texts = [plus_minus(value, spread), spread_text(spread)]
    for text in texts if spread > 1e-8 * value else texts[1:]:
        *_, printed = map(float, re.findall(NUMBER_PATTERN, text))
        assert spread * (1.0 - 1e-10) <= printed < 1.1 * spread * (1.0 + 1e-10)
