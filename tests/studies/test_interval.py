import math

import pytest

from drake_quad.studies.interval import Interval

SOME = Interval(0.2, 0.1, 0.4)


def test_arithmetic_turns_and_moves_the_ends_with_the_value():
    assert -SOME == (-0.2, -0.4, -0.1)
    assert SOME.plus(-1.0) == pytest.approx((-0.8, -0.9, -0.6))
    # By what share something shrinks to a ratio.
    assert -SOME.plus(-1.0) == pytest.approx((0.8, 0.6, 0.9))


@pytest.mark.parametrize(("level", "expected"), [(0.05, True), (0.1, None), (0.3, None), (0.4, None), (0.5, False)])
def test_a_level_within_the_interval_leaves_the_question_open(level, expected):
    assert SOME.is_above(level) is expected


def test_nothing_is_above_or_below_what_is_not_bounded():
    assert Interval(1.0, math.nan, math.nan).is_above(0.0) is None
    assert Interval(1.0, 0.5, math.inf).is_above(0.0) is True
    assert Interval(1.0, -math.inf, 2.0).is_above(0.0) is None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (SOME.text(".2f"), "0.20 [0.10, 0.40]"),
        (SOME.text(".1f", unit="cm", size=0.01), "20.0 cm [10.0, 40.0]"),
        (SOME.percent(), "20.0 % [10.0, 40.0]"),
        (Interval(0.12345, 0.1231, 0.1239).percent(), "12.35 % [12.31, 12.39]"),
        (Interval(0.5, math.nan, math.nan).percent(), "50.0 %"),
        (Interval(0.5, -math.inf, math.inf).text(".1f"), "0.5"),
        (Interval(0.5, -math.inf, 0.7).text(".1f"), "0.5 [–, 0.7]"),
        (Interval(0.5, -math.inf, math.inf).text(".1f", infinite="crash"), "0.5"),
        (Interval(math.inf, math.inf, math.inf).text(".1f", infinite="crash"), "crash"),
        (Interval(math.inf, 0.5, math.inf).text(".1f", infinite="crash"), "crash [0.5, crash]"),
        (Interval(math.nan, 0.0, 1.0).text(".0f"), "–"),
        (SOME.ratio(), "0.20 [0.10, 0.40]"),
        (SOME.metres(), "0.200 m [0.100, 0.400]"),
        ((-SOME).millimetres(), "-200.0 mm [-400.0, -100.0]"),
    ],
)
def test_words(text, expected):
    assert text == expected
