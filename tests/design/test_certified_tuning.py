import math

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.design import certified_tuning
from drake_quad.design.certificate import GAP_GOAL, Certificate
from drake_quad.design.certified_tuning import ScaleLimit, tune_certified
from drake_quad.design.tuning import Budget, Knob, TuningResult
from drake_quad.design.uncertain_hover import Failure
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.scenario.hovering import at_rest, symmetric_hover

LAG = "vehicle.rotor_time_constant"
HALF_WIDTH = 0.015  # s
KNOBS = [Knob(("control.position.k_p.0", "control.position.k_p.1"), 0.5, 12.0)]


def late(*overrides):
    """Return a hovering vehicle whose command arrives late, so that a slow rotor makes its loop unstable."""
    lag = f"{LAG}={{uniform: {{min: {0.05 - HALF_WIDTH}, max: {0.05 + HALF_WIDTH}}}}}"
    return load_scenario("hover", [lag, "laboratory.command_link.delay_ticks=8", *overrides])


def critical_scale(*overrides):
    """Return the scale at which the slowest rotor makes the loop unstable, by bisection."""
    low, high = 0.0, 8.0
    for _ in range(14):
        middle = 0.5 * (low + high)
        scenario = late(*overrides, f"{LAG}={0.05 + HALF_WIDTH * middle}")
        stable = np.abs(closed_loop(symmetric_hover(at_rest(scenario))).system.poles()).max() < 1.0
        low, high = (middle, high) if stable else (low, middle)
    return 0.5 * (low + high)


@pytest.mark.slow
def test_the_fraction_of_the_limit_is_that_of_the_critical_scale():
    critical = critical_scale()
    limit = ScaleLimit(late(), critical)
    assert limit.fraction(late()) == pytest.approx(GAP_GOAL, rel=0.01)
    smaller = ScaleLimit(late(), critical / 1.1)
    assert smaller.fraction(late()) == pytest.approx(1.1 * GAP_GOAL, rel=0.02)
    assert smaller.fraction(late("laboratory.command_link.delay_ticks=20")) == 0.0
    assert smaller.fraction(late("laboratory.command_link.delay_ticks=1")) == 1.5


@pytest.mark.slow
def test_the_direction_of_a_failure_becomes_critical():
    critical = critical_scale()
    limit = ScaleLimit(late(), critical)
    limit._directions[:] = -1.0  # fast rotors, which are stable
    assert limit.fraction(late()) == 1.5
    limit.add(Failure(3.2, {LAG: 0.05 + 3.2 * HALF_WIDTH}))
    assert limit.fraction(late()) == pytest.approx(GAP_GOAL, rel=0.01)


class Limit:
    """Replaces `ScaleLimit`: records its requests."""

    def __init__(self, scenario, scale):
        self.failures = []
        Limit.made = self

    def add(self, failure):
        self.failures.append(failure)

    def fraction(self, scenario):
        return 0.75


def certificate(scale):
    return Certificate(scale, Failure(1.05 * scale, {LAG: scale}), Failure(math.inf, {}), None, (), (), (), 0, 0)


@pytest.mark.parametrize(("scales", "best"), [((0.5, 1.3, 9.0), 1.3), ((0.5, 0.9, 0.7, 0.6), 0.9)])
def test_searches_are_repeated_until_a_result_is_certified(monkeypatch, scales, best):
    results, fractions = iter(scales), []

    def tune(scenarios, knobs, limit_fractions, *, budget):
        fractions.append(limit_fractions(scenarios[0]).tolist())
        return TuningResult((2.0,), 0.1, 1.0)

    monkeypatch.setattr(certified_tuning, "ScaleLimit", Limit)
    monkeypatch.setattr(certified_tuning, "tune", tune)
    monkeypatch.setattr(certified_tuning, "certify_hover", lambda scenario: certificate(next(results)))
    found = tune_certified(late(), KNOBS, lambda scenario: np.array([1.25]), 1.2, budget=Budget())
    assert found.certificate.stable_scale == best
    assert found.num_searches == scales.index(best) + 1
    assert fractions[0] == [1.25, 0.75]
    uncertified = [scale for scale in scales if scale < 1.2]
    assert [failure.values[LAG] for failure in Limit.made.failures] == uncertified


def test_an_unstable_loop_keeps_its_single_zero(monkeypatch):
    fractions = []

    def tune(scenarios, knobs, limit_fractions, *, budget):
        fractions.append(limit_fractions(scenarios[0]).tolist())
        return TuningResult((2.0,), 0.1, 0.0)

    monkeypatch.setattr(certified_tuning, "ScaleLimit", Limit)
    monkeypatch.setattr(certified_tuning, "tune", tune)
    monkeypatch.setattr(certified_tuning, "certify_hover", lambda scenario: certificate(2.0))
    tune_certified(late(), KNOBS, lambda scenario: np.zeros(1), 1.2)
    assert fractions == [[0.0]]
