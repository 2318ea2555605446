"""Tests of the robustness of requirements."""

import math
import sys
import typing
from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad.laboratory.derived_signals import RowSelector
from drake_quad.laboratory.requirements import Bound, Combination, always, eventually, holds_until, robustness
from drake_quad.signals import Wind

PERIOD = 0.25  # s
TIME = PERIOD * np.arange(40)  # s
WINDOW = (TIME >= 2.0) & (TIME <= 6.0)  # mask of the ticks in the time window of the requirement


def random_walks(seed):
    """Return random walks, one for each of the three components of a wind."""
    return Wind(*np.cumsum(np.random.default_rng(seed).normal(size=(3, len(TIME))), axis=1))


def below(row, bound):
    return Bound(RowSelector(row), ("wind",), -math.inf, bound)


def above(row, bound):
    return Bound(RowSelector(row), ("wind",), bound, math.inf)


def robustness_of(accumulator, wind):
    """Return the robustness of a requirement on the wind after all ticks in `TIME`."""
    sums = accumulator.initial
    for i, time in enumerate(TIME):
        values = {"time": time, "wind": Wind(*(row[i] for row in wind))}
        sums = accumulator.add(sums, *[values[name] for name in accumulator.arguments], **dict(accumulator.constants))
    return float(robustness(sums, float(len(TIME)), PERIOD))


@pytest.mark.parametrize("seed", range(3))
def test_always_is_the_smallest_margin_and_eventually_the_largest_in_the_window(seed):
    wind = random_walks(seed)
    margin = np.minimum(1.0 - wind.x, wind.y + 2.0)
    conjunction = Combination("all", (below("x", 1.0), above("y", -2.0)))
    assert robustness_of(always(conjunction, 2.0, 6.0), wind) == margin[WINDOW].min()
    assert robustness_of(eventually(conjunction, 2.0, 6.0), wind) == margin[WINDOW].max()
    disjunction = Combination("any", (below("x", 1.0), above("y", -2.0)))
    assert robustness_of(always(disjunction, 0.0, math.inf), wind) == np.maximum(1.0 - wind.x, wind.y + 2.0).min()
    assert robustness_of(always(Bound(RowSelector("z"), ("wind",), -1.0, 3.0), 0.0, math.inf), wind) == min(
        (3.0 - wind.z).min(), (wind.z + 1.0).min()
    )


def test_a_requirement_without_a_tick_in_its_window_has_no_robustness():
    for accumulator in (always(below("x", 1.0), 50.0, 60.0), eventually(below("x", 1.0), 50.0, 60.0)):
        assert math.isnan(robustness_of(accumulator, random_walks(0)))


@pytest.fixture
def rtamt(monkeypatch):
    """Return the library rtamt. Its parser imports `typing.io`, which Python 3.13 lacks, so a stub replaces it."""
    monkeypatch.setitem(sys.modules, "typing.io", SimpleNamespace(TextIO=typing.TextIO))
    return pytest.importorskip("rtamt")


@pytest.mark.parametrize("seed", range(20))
def test_robustness_agrees_with_the_library_rtamt(seed, rtamt):
    wind = random_walks(seed)
    x = below("x", 1.0)
    cases = {
        "always[2:6](x <= 1)": always(x, 2.0, 6.0),
        "eventually[2:6](x <= 1)": eventually(x, 2.0, 6.0),
        "(x <= 1) until[2:6] (y >= 1)": holds_until(x, above("y", 1.0), 2.0, 6.0),
        "always[2:6]((x <= 1) and (y >= 1))": always(Combination("all", (x, above("y", 1.0))), 2.0, 6.0),
        "eventually[2:6]((x <= 1) or (y >= 1))": eventually(Combination("any", (x, above("y", 1.0))), 2.0, 6.0),
    }
    for formula, accumulator in cases.items():
        specification = rtamt.StlDiscreteTimeSpecification()
        specification.declare_var("x", "float")
        specification.declare_var("y", "float")
        specification.set_sampling_period(250, "ms", 0.1)
        specification.spec = formula
        specification.parse()
        ((_, expected), *_) = specification.evaluate({"time": [*TIME], "x": [*wind.x], "y": [*wind.y]})
        assert robustness_of(accumulator, wind) == pytest.approx(expected, abs=1e-12), formula
