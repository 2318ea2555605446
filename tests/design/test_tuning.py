"""Tests that the search finds the best gains of a grid search and meets the limit."""

import itertools

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.design.tuning import (
    Budget,
    LoopLimit,
    TuningParameter,
    tolerated_delay,
    tune,
    with_extra_latency,
    with_parameter_values,
)
from drake_quad.linear.link_margins import link_margins
from drake_quad.scenario.batch import median_scenario
from drake_quad.studies.comparison import fly_samples

# A tuning parameter has the paths of the fields that it sets, and the smallest and the largest value to try.
K_P_PARAMETER = TuningParameter(("control.position.k_p.0", "control.position.k_p.1"), 0.5, 12.0)
K_D_PARAMETER = TuningParameter(("control.position.k_d.0", "control.position.k_d.1"), 0.5, 8.0)  # 1/s, gains on X and Y


def k_p_limit(max_k_p):
    """Return a function that replaces `LoopLimit.margin_ratios`, so that the limit is `max_k_p`.

    The function returns the ratio of `max_k_p` to k_P in the scenario.
    """
    return lambda scenario: np.array([max_k_p / scenario.control.position.k_p[0]])


@pytest.fixture(scope="module")
def laboratory(diagrams):
    return load_scenario(diagrams / "laboratory.yaml:low_wind", ["duration=2", "control.position.k_p=[9, 9, 6.14]"])


@pytest.mark.long
def test_the_best_gains_within_the_limit_are_found(laboratory, diagrams):
    budget = Budget(rounds=4, candidates=32, samples=2, limit_evaluations=4, local_search_steps=20)
    result = tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], k_p_limit(2.0), budget=budget)
    assert result.min_margin_ratio >= 1.0
    metrics = fly_samples(with_parameter_values(laboratory, [K_P_PARAMETER, K_D_PARAMETER], result.values), range(2))
    assert result.error == pytest.approx(float(metrics.rmse.mean()), rel=1e-9)
    grid = itertools.product((1.0, 2.0), (1.5, 3.0))
    gains = [f"control.position.{name}=[{{0}}, {{0}}, 6.14]" for name in ("k_p", "k_d")]
    for pair in grid:
        overrides = ["duration=2", *(text.format(gain) for text, gain in zip(gains, pair, strict=True))]
        other = fly_samples(load_scenario(diagrams / "laboratory.yaml:low_wind", overrides), range(2))
        assert result.error < 1.02 * float(other.rmse.mean())


@pytest.mark.long
def test_the_closest_candidate_is_returned_if_none_is_within_the_limit(laboratory):
    result = tune(
        [laboratory],
        [K_P_PARAMETER],
        k_p_limit(0.25),
        budget=Budget(rounds=3, candidates=16, samples=1, limit_evaluations=4, local_search_steps=10),
    )
    assert result.values[0] == pytest.approx(0.5, rel=0.1)
    assert result.min_margin_ratio == pytest.approx(0.25 / result.values[0])


@pytest.mark.long
def test_the_smallest_margin_ratio_is_that_of_the_worst_loop(laboratory, diagrams):
    scenario = load_scenario(diagrams / "laboratory.yaml:nominal")
    margins_by_signal = link_margins(scenario)
    peak = max(margins.sensitivity for margins in margins_by_signal.values())
    delay = min(margins.delay for margins in margins_by_signal.values())
    assert LoopLimit(0.8 * peak, 1e-3).margin_ratios(scenario).min() == pytest.approx(0.8, rel=5e-3)
    assert LoopLimit(50.0, 1.6 * delay).margin_ratios(scenario).min() == pytest.approx(1.0 / 1.6, rel=5e-3)
    stiff = load_scenario(diagrams / "laboratory.yaml:nominal", ["control.attitude.k_p=[900, 900, 5]"])
    assert LoopLimit().margin_ratios(stiff).max() == 0.0


@pytest.mark.slow
def test_limits_apply_to_the_medians_of_distributions():
    scenario = load_scenario("robustness", layers=["controllers/designed/robustness:pid"])
    ratios = LoopLimit().margin_ratios(scenario)
    assert ratios == pytest.approx(LoopLimit().margin_ratios(median_scenario(scenario)))
    assert ratios.min() == pytest.approx(1.0, abs=0.01)  # the design meets the limits exactly


@pytest.mark.long
def test_a_search_that_starts_from_earlier_gains_is_at_least_as_good(laboratory):
    budget = Budget(rounds=1, candidates=4, samples=1, limit_evaluations=1, local_search_steps=4)
    alone = tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], k_p_limit(12.0), budget=budget)
    thorough = tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], k_p_limit(12.0), budget=Budget(3, 32, 1, 4, 30))
    again = tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], k_p_limit(12.0), budget=budget, before=thorough.values)
    assert again.error <= thorough.error + 1e-9 < alone.error


@pytest.mark.long
def test_without_a_limit_the_vertical_axis_is_tuned_separately_to_the_least_error(laboratory):
    height = TuningParameter(("control.position.k_p.2",), 0.5, 30.0)
    budget = Budget(rounds=3, candidates=16, samples=1, local_search_steps=10)
    result = tune([laboratory, laboratory], [height, K_P_PARAMETER], None, budget=budget)
    assert height.vertical
    assert not K_P_PARAMETER.vertical
    assert result.min_margin_ratio == np.inf
    metrics = fly_samples(with_parameter_values(laboratory, [height, K_P_PARAMETER], result.values), range(1))
    assert result.error == pytest.approx(float(metrics.rmse.mean()), rel=1e-9)
    for number in ((0.6, result.values[1]), (result.values[0], 0.6)):
        other = fly_samples(with_parameter_values(laboratory, [height, K_P_PARAMETER], number), range(1))
        assert result.error < float(other.rmse.mean())


def test_extra_latency_is_added_to_the_latency_of_the_scenario(diagrams):
    """The extra latency is rounded to whole frames of 10 ms, and is also added to a random latency."""
    for name, expected in (("laboratory.yaml:nominal", 3.0), ("robustness.yaml", (3.0, 4.0))):
        extra_latency = with_extra_latency(
            load_scenario(diagrams / name), 0.03
        ).laboratory.motion_capture.latency_frames
        assert getattr(extra_latency, "choice", extra_latency) == expected


@pytest.fixture(scope="module")
def fragile_scenario(diagrams):
    """Return a scenario that counts a position error of 0.1 m as a crash. Its delay margin is 53 ms."""
    layers = [diagrams / "controllers" / "designed" / "priced.yaml:indi@3"]
    overrides = ["duration=3", "crash.position_error=0.1"]
    return load_scenario(diagrams / "laboratory.yaml:low_wind", overrides, layers=layers)


@pytest.mark.long
def test_the_tolerated_delay_is_the_largest_without_a_crash_in_training(fragile_scenario):
    def crashes(extra_latency):
        return fly_samples(with_extra_latency(fragile_scenario, extra_latency), range(2)).crashed.any()

    tolerated = tolerated_delay([fragile_scenario], 0.09, budget=Budget(samples=2))
    assert 0.0 < tolerated < 0.09
    assert crashes(tolerated + 0.01)
    assert not crashes(tolerated)
    assert tolerated_delay([fragile_scenario], tolerated - 0.01, budget=Budget(samples=2)) == pytest.approx(
        tolerated - 0.01
    )


@pytest.mark.long
def test_crashes_with_extra_latency_add_to_the_error(fragile_scenario):
    """A crash at time t of T adds 2 - t / T metres to the error of the flights without latency."""
    parameter, budget = (
        TuningParameter(("control.position.k_p.0",), 3.3, 3.301),
        Budget(rounds=1, candidates=4, samples=2, local_search_steps=1),
    )
    error_without, error_with = (
        tune([fragile_scenario], [parameter], None, budget=budget, extra_latency=extra_latency).error
        for extra_latency in (0.0, 0.09)
    )
    metrics = fly_samples(
        with_parameter_values(with_extra_latency(fragile_scenario, 0.09), [parameter], [3.3]), range(2)
    )
    assert metrics.crashed.all()
    assert error_without < 0.1
    assert error_with - error_without == pytest.approx(float((2.0 - metrics.crash_time / 3.0).mean()), rel=1e-3)
