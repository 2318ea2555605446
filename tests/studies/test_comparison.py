"""Tests of comparisons of controllers on the same samples."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.laboratory.metrics import Metrics
from drake_quad.studies import comparison
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import compare


def metrics(rmse, crash_time):
    return Metrics(*[np.array(rmse)] * (len(Metrics._fields) - 1), np.array(crash_time))


def test_the_ratio_of_means_is_over_samples_without_a_crash():
    ours = metrics([1.0, 3.0, 5.0, 7.0, 9.0], [math.inf, 2.0, math.inf, 2.0, math.inf])
    baseline = metrics([2.0, 2.0, 2.0, 2.0, 0.0], [math.inf, math.inf, 3.0, 3.0, math.inf])
    result, reverse = compare(ours, baseline), compare(baseline, ours)
    assert (result.num_pairs, result.ratio.value) == (2, 5.0)
    assert (reverse.num_pairs, reverse.ratio.value) == (2, 0.2)


@pytest.mark.parametrize(
    ("only_first", "only_second", "significance"), [(0, 5, 0.0625), (5, 0, 0.0625), (1, 1, 1.0), (0, 0, 1.0)]
)
def test_the_significance_of_crashes_follows_from_the_sign_test(only_first, only_second, significance):
    """By McNemar's exact test, five crashes of only one controller have the p-value 2 / 2⁵."""
    times = np.full((2, 8), math.inf)
    times[0, :only_first] = times[1, 8 - only_second :] = 1.0
    result = compare(*(metrics(np.ones(8), each) for each in times))
    assert (result.crashed, result.baseline_crashed) == (only_first, only_second)
    assert result.crash_significance == pytest.approx(significance)


@pytest.mark.slow
def test_samples_fly_in_the_given_order():
    scenario, reports = load_scenario("diagrams/laboratory.yaml:low_wind", ["duration=0.2"]), []
    result = fly_samples(scenario, [5, 2], progress=lambda *each: reports.append(each))
    for sample, rmse in zip((5, 2), result.rmse, strict=True):
        assert simulate(scenario, sample=sample).metrics.rmse == pytest.approx(rmse, rel=1e-9)
    assert reports[-1] == (pytest.approx(0.2), pytest.approx(0.2))


def test_samples_fly_in_one_fleet_that_is_compiled_by_default(monkeypatch):
    fleets = []

    def fleet(_, plan, num_samples, *, compiled):
        assert plan == "plan"
        fleets.append((num_samples, compiled))
        return "fleet"

    monkeypatch.setattr(comparison, "StudyFleet", fleet)
    monkeypatch.setattr(comparison, "Batch", SimpleNamespace(draw=lambda _, samples: [*samples]))
    monkeypatch.setattr(comparison, "fly_with_metrics", lambda _, batch, progress: batch)
    monkeypatch.setattr(comparison, "plan_route", lambda _: "plan")
    assert fly_samples(None, [5, 2, 7]) == fly_samples(None, [5, 2, 7], compiled=False) == [5, 2, 7]
    assert fleets == [(3, True), (3, False)]
