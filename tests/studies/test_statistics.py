"""Tests of the coverage of intervals, and comparisons with other programs."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy

from drake_quad import InputError, load_scenario
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.draws import DesignedDraws
from drake_quad.statistics.estimates import (
    mean_interval,
    proportion_interval,
    quantile_interval,
    rank_correlation,
    running_mean,
)
from drake_quad.statistics.ratios import ratio_of_means
from drake_quad.studies.statistics import (
    compare,
    compare_studies,
    crash_probability,
    influences,
    metric_mean,
    values_with_crashes,
    values_without_crashes,
    worst_samples,
)
from drake_quad.studies.study import Study
from drake_quad.studies.summary import crash_text, metric_table


def study(rmse, crash_time=None, samples=None, **parameters):
    rmse = np.asarray(rmse, dtype=float)
    crash_time = np.full(len(rmse), math.inf) if crash_time is None else np.asarray(crash_time)
    metrics = Metrics(*[rmse] * (len(Metrics._fields) - 1), crash_time)
    samples = np.arange(len(rmse)) if samples is None else np.asarray(samples)
    return Study(load_scenario("diagrams/figure_eight.yaml"), 10.0, samples, parameters, metrics)


def coverage(interval, truth, draw, repetitions=600):
    rng = np.random.default_rng(1)
    result = [interval(draw(rng)) for _ in range(repetitions)]
    return np.mean([low <= truth <= high for _, low, high in result])


def test_the_interval_of_a_mean_agrees_with_scipy_and_has_its_nominal_coverage():
    values = np.random.default_rng(0).normal(2.0, 3.0, 25)
    expected = scipy.stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert mean_interval(values) == pytest.approx((values.mean(), expected.low, expected.high))
    fraction = coverage(mean_interval, 2.0, lambda rng: rng.normal(2.0, 3.0, 8))
    assert fraction == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize("probability", [0.05, 0.5, 0.95])
def test_the_interval_of_a_quantile_agrees_with_scipy_and_has_its_nominal_coverage(probability):
    values = np.random.default_rng(0).exponential(size=150)
    expected = scipy.stats.quantile_test(values, p=probability).confidence_interval(0.95)
    result = quantile_interval(values, probability)
    assert (result.low, result.high) == pytest.approx((expected.low, expected.high))
    assert result.value == np.quantile(values, probability, method="inverted_cdf")
    truth = -math.log(1.0 - probability)
    fraction = coverage(
        lambda values: quantile_interval(values, probability), truth, lambda rng: rng.exponential(size=120)
    )
    assert fraction > 0.93


def test_too_few_values_do_not_bound_a_quantile():
    assert quantile_interval(np.arange(10.0), 0.95) == (9.0, 7.0, math.inf)
    assert quantile_interval(np.arange(10.0), 0.05) == (0.0, -math.inf, 2.0)


def test_a_crash_is_worse_than_any_error():
    crashed = [math.inf] * 95 + [3.0] * 5
    metrics = study(np.arange(100.0), crashed).metrics
    assert quantile_interval(values_with_crashes(metrics, "rmse"), 0.9).value == 89.0
    assert quantile_interval(values_with_crashes(metrics, "rmse"), 0.99).value == math.inf
    np.testing.assert_array_equal(values_without_crashes(metrics, "rmse"), np.arange(95.0))
    assert crash_probability(metrics).value == 0.05


def test_the_interval_of_a_fraction_is_exact():
    """If no event occurs in n trials, the upper end is 1 - (α / 2)^(1 / n)."""
    assert proportion_interval(0, 100) == pytest.approx((0.0, 0.0, 1.0 - 0.025**0.01))
    result = proportion_interval(7, 50)
    assert scipy.stats.binom.sf(6, 50, result.low) == pytest.approx(0.025)
    assert scipy.stats.binom.cdf(7, 50, result.high) == pytest.approx(0.025)
    assert proportion_interval(0, 0)[1:] == (0.0, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("r", [-0.6, 0.0, 0.95])
def test_the_interval_of_a_rank_correlation_has_its_nominal_coverage(r):
    """The rank correlation of normal variables with correlation r is 6 / π asin(r / 2)."""
    draw = lambda rng: rng.multivariate_normal([0.0, 0.0], [[1.0, r], [r, 1.0]], 60)  # noqa: E731
    fraction = coverage(lambda xy: rank_correlation(*xy.T), 6.0 / math.pi * math.asin(0.5 * r), draw)
    assert fraction == pytest.approx(0.95, abs=0.03)


def test_the_interval_of_a_rank_correlation_is_bonett_and_wright_s():
    """The squared differences of ten ranks add up to 20, so ρ = 1 - 6 · 20 / 990 = 0.8788."""
    y = np.array([2.0, 1.0, 5.0, 4.0, 3.0, 8.0, 6.0, 7.0, 9.0, 10.0])
    x = np.arange(1.0, 11.0)
    rho = 1.0 - 6.0 * np.sum((x - y) ** 2) / 990.0
    half_width = 1.959964 * math.sqrt((1.0 + rho**2 / 2.0) / 7.0)
    result = rank_correlation(np.exp(x), y)
    assert result == pytest.approx(
        (rho, math.tanh(math.atanh(rho) - half_width), math.tanh(math.atanh(rho) + half_width))
    )
    assert math.isnan(rank_correlation(np.ones(10), np.arange(10.0)).value)
    for sign in (1.0, -1.0):
        result = rank_correlation(np.arange(10.0), sign * np.exp(np.arange(10.0)))
        assert result == pytest.approx((sign, sign, sign), abs=1e-10)


def test_the_running_mean_is_the_mean_of_the_first_values():
    values = 1e6 + np.random.default_rng(2).normal(size=50)
    mean, low, high = running_mean(values)
    for count in (2, 17, 50):
        expected = mean_interval(values[:count])
        assert (mean[count - 1], low[count - 1], high[count - 1]) == pytest.approx(expected, rel=1e-12)


def test_the_most_influential_parameter_comes_first():
    rng = np.random.default_rng(3)
    mass, lag = rng.uniform(size=(2, 400))
    rmse = 1.0 + mass**2 + 0.1 * lag
    result = influences(study(rmse, mass=mass, lag=lag))
    assert [each.path for each in result] == ["mass", "lag"]
    assert result[0].correlation.value > 0.9
    order = np.argsort(mass)
    assert result[0].low.value == pytest.approx(rmse[order[:40]].mean())
    assert result[0].high.value == pytest.approx(rmse[order[-40:]].mean())
    crashes = study(np.ones(400), np.where(lag > 0.8, 2.0, math.inf), mass=mass, lag=lag)
    result = influences(crashes, "crashed")
    assert result[0].path == "lag"
    assert (result[0].low.value, result[0].high.value) == (0.0, 1.0)
    assert result[0].low.high < 0.1


def test_negative_and_positive_influences_count_equally():
    """A constant parameter has no correlation and comes last."""
    rng = np.random.default_rng(6)
    gain, mass, lag = rng.uniform(size=(3, 400))
    result = influences(study(2.0 - gain + 0.3 * mass - 0.1 * lag, lag=lag, fixed=np.ones(400), mass=mass, gain=gain))
    assert [each.path for each in result] == ["gain", "mass", "lag", "fixed"]
    assert result[0].correlation.value < -0.9


def test_a_parameter_is_influential_if_its_small_and_large_values_have_the_same_effect():
    """A centre of mass on either side of the middle increases the error. Its rank correlation is nearly zero."""
    rng = np.random.default_rng(2)
    offset, mass, lag = rng.uniform(-1.0, 1.0, size=(3, 400))
    first, second, third = influences(study(1.0 + offset**2 + 0.2 * mass, lag=lag, mass=mass, offset=offset))
    assert (first.path, second.path, third.path) == ("offset", "mass", "lag")
    assert abs(first.correlation.value) < 0.2
    assert first.strongest == first.distance
    assert first.distance.value > 0.8
    assert second.strongest == second.correlation


def test_a_comparison_of_controllers_is_paired_by_sample():
    """The spread between samples, which is ten times the spread of the differences, cancels."""
    rng = np.random.default_rng(4)
    common = rng.normal(10.0, 1.0, 200)
    baseline = study(common)
    better = study((common - 0.3 + rng.normal(0.0, 0.1, 200))[::-1], samples=np.arange(200)[::-1])
    result = compare_studies(better, baseline)
    assert result.difference.low < -0.3 < result.difference.high
    assert result.difference.high - result.difference.low < 0.04
    assert result.ratio.value == pytest.approx(0.97, abs=0.005)
    assert result.better.value > 0.98
    assert result.num_pairs == 200


def test_a_comparison_counts_crashes_separately():
    nan, inf = math.nan, math.inf
    ours = study([1.0, 2.0, 3.0, 4.0, nan], [inf, 3.0, inf, 2.0, inf])
    baseline = study([2.0, 2.0, 2.0, 2.0, 2.0], [inf, inf, 1.0, inf, inf])
    result = compare_studies(ours, baseline)
    assert (result.num_pairs, result.crashed, result.baseline_crashed) == (1, 2, 1)
    assert result.crash_significance == scipy.stats.binomtest(2, 3).pvalue
    assert compare_studies(baseline, baseline).crash_significance == 1.0


def test_the_worst_samples_are_early_crashes_then_large_errors():
    result = study([5.0, 1.0, 9.0, 7.0, 2.0], [math.inf, 8.0, math.inf, math.inf, 3.0], samples=[10, 11, 12, 13, 14])
    assert worst_samples(result, 4) == [14, 11, 12, 13]


def test_the_mean_of_values_with_an_infinite_value_is_infinite_and_has_no_interval():
    with np.errstate(all="raise"):
        values = np.array([3.0, 5.0, math.inf, 4.0, math.inf])
        np.testing.assert_array_equal(mean_interval(values), [math.inf, math.nan, math.nan])
        np.testing.assert_array_equal(mean_interval(-values), [-math.inf, math.nan, math.nan])
        assert np.isnan(mean_interval(np.array([math.inf, -math.inf]))).all()
        for some, expected in zip(running_mean(values), running_mean(values[:2]), strict=True):
            np.testing.assert_allclose(some[:2], expected)
            assert np.isnan(some[2:]).all()
        scenario = load_scenario("figure_eight", {"metrics.additional": {"settled": {"kind": "settling_time"}}})
        metrics, other_metrics = (
            scenario.metrics_type(*[each] * (len(scenario.metrics_type._fields) - 1), np.full(5, math.inf))
            for each in (values, np.array([2.0, 6.0, math.inf, 1.0, 1.0]))
        )
        comparison = compare(metrics, other_metrics, "settled")
    assert math.isnan(comparison.difference.value)
    assert comparison.better == proportion_interval(1, 5)


def test_few_values_have_no_interval():
    nan = math.nan
    np.testing.assert_array_equal(mean_interval(np.array([])), [nan, nan, nan])
    np.testing.assert_array_equal(mean_interval(np.array([3.0])), [3.0, nan, nan])
    assert mean_interval(np.array([3.0, 5.0]))[1:] == pytest.approx([4.0 - 12.706205, 4.0 + 12.706205])
    np.testing.assert_array_equal(quantile_interval(np.array([]), 0.5), [nan, nan, nan])
    assert quantile_interval(np.array([4.0, 2.0]), 0.0).value == 2.0
    np.testing.assert_array_equal(proportion_interval(0, 0), [nan, 0.0, 1.0])
    for count in (0, 3):
        np.testing.assert_array_equal(rank_correlation(np.arange(count), np.arange(count)), [nan, nan, nan])
    assert rank_correlation(np.arange(4.0), np.array([1.0, 0.0, 2.0, 3.0])).value == pytest.approx(0.8)
    np.testing.assert_array_equal(rank_correlation(np.arange(5.0), np.ones(5)), [nan, nan, nan])
    assert all(len(each) == 0 for each in running_mean(np.array([])))
    mean, low, high = running_mean(np.array([3.0, 5.0]))
    np.testing.assert_array_equal(mean, [3.0, 4.0])
    assert np.isnan([low[0], high[0]]).all()


def test_intervals_have_the_given_confidence():
    values = np.random.default_rng(5).normal(size=40)
    expected = scipy.stats.ttest_1samp(values, 0.0).confidence_interval(0.8)
    assert mean_interval(values, 0.8)[1:] == pytest.approx((expected.low, expected.high))
    assert [ends[-1] for ends in running_mean(values, 0.8)[1:]] == pytest.approx((expected.low, expected.high))
    expected = scipy.stats.quantile_test(values, p=0.5).confidence_interval(0.8)
    assert quantile_interval(values, 0.5, 0.8)[1:] == pytest.approx((expected.low, expected.high))
    assert proportion_interval(0, 100, 0.8).high == pytest.approx(1.0 - 0.1**0.01)
    low, high = rank_correlation(np.arange(40), values, 0.8)[1:]
    rho = scipy.stats.spearmanr(np.arange(40), values).statistic
    half_width = 1.2815515655 * math.sqrt((1.0 + 0.5 * rho**2) / 37.0)
    assert (math.atanh(low), math.atanh(high)) == pytest.approx(
        (math.atanh(rho) - half_width, math.atanh(rho) + half_width)
    )


def test_influences_exclude_crashed_flights():
    """Without the crashed flight and the flight with an RMSE of NaN, the mass is the most influential parameter."""
    mass = np.arange(20.0)
    rmse = 1.0 + mass
    rmse[[4, 7]] = -50.0, math.nan
    crash_time = np.where(mass == 4.0, 2.0, math.inf)
    flown = study(rmse, crash_time, mass=mass, lag=np.cos(mass))
    first, second = influences(flown)
    assert (first.path, second.path) == ("mass", "lag")
    assert first.correlation.value == pytest.approx(1.0)
    assert (first.low.value, first.high.value) == (1.5, 19.5)
    assert influences(study([1.0, 2.0], [1.0, 1.0], mass=np.ones(2))) == []
    crashes = influences(flown, "crashed")
    assert [each.low for each in crashes if each.path == "mass"] == [proportion_interval(0, 2)]


def test_the_ratio_of_means_exists_even_if_a_baseline_value_is_zero():
    result = compare_studies(study([1.0, 1.0, 3.0, 2.0]), study([0.0, 2.0, 2.0, 2.0]))
    assert result.ratio.value == pytest.approx(7.0 / 6.0)
    assert (result.num_pairs, result.difference.value, result.better.value) == (4, 0.25, 0.25)
    assert result.crash_significance == 1.0


def test_samples_without_a_metric_come_last_among_the_worst_samples():
    result = study([math.nan, 1.0, 9.0], samples=[4, 5, 6])
    assert worst_samples(result) == [6, 5, 4]
    assert worst_samples(study(np.arange(8.0))) == [7, 6, 5, 4, 3]


def test_the_statistics_of_sobol_draws_follow_from_their_replicates():
    """Each replicate contains five equal samples, so the statistics are those of one sample per replicate."""
    rng = np.random.default_rng(3)
    rmse, baseline, crashed = rng.gamma(3.0, 0.02, 20), rng.gamma(3.0, 0.02, 20), rng.random(20) < 0.3

    def repeated(values, crash_time=None):
        result = study(np.repeat(values, 5), crash_time)
        return replace(
            result, scenario=result.scenario.model_copy(update={"draws": DesignedDraws(kind="sobol", size=4)})
        )

    first, second = (replace(repeated(each), samples=np.arange(100) // 5 * 4) for each in (rmse, baseline))
    assert metric_mean(first.metrics, "rmse", first.replicates) == pytest.approx(mean_interval(rmse))
    result = compare(first.metrics, second.metrics, "rmse", first.replicates)
    assert result.ratio == pytest.approx(ratio_of_means(rmse, baseline))
    assert result.difference == pytest.approx(mean_interval(rmse - baseline))
    assert result.better == pytest.approx(proportion_interval(int(np.sum(rmse < baseline)), 20), abs=0.06)
    crashing = replace(repeated(rmse, np.where(np.repeat(crashed, 5), 1.0, math.inf)), samples=first.samples)
    expected = proportion_interval(int(crashed.sum()), 20)
    assert crash_probability(crashing.metrics, crashing.replicates) == pytest.approx(expected, abs=0.06)
    (row,) = [row for row in metric_table(crashing).rows if row[0] == "RMSE"]
    assert row[1] == mean_interval(rmse[~crashed]).text(size=0.01)
    assert crash_text(crashing).endswith(crash_probability(crashing.metrics, crashing.replicates).percent())


def test_studies_with_different_draws_are_not_compared():
    first = study(np.arange(4.0))
    draws = DesignedDraws(kind="latin_hypercube", size=2)
    second = replace(first, scenario=first.scenario.model_copy(update={"draws": draws}))
    with pytest.raises(InputError, match="have different draws, so their samples cannot be compared in pairs"):
        compare_studies(second, first)
