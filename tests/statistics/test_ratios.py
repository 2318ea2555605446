"""Tests of ratios of means: Fieller's definition, the coverage of intervals, and unbounded intervals."""

import math

import numpy as np
import pytest
import scipy

from drake_quad.laboratory.metrics import Metrics
from drake_quad.statistics.ratios import linearized_ratio, ratio_of_means
from drake_quad.studies.statistics import compare


def holds(ratio, values, baseline, confidence=0.95):
    """Return whether Student's interval of the mean of a - R b, computed by SciPy, contains zero."""
    return scipy.stats.ttest_1samp(values - ratio * baseline, 0.0).pvalue >= 1.0 - confidence


@pytest.mark.parametrize("confidence", [0.5, 0.95])
def test_the_interval_contains_the_ratios_that_a_t_test_does_not_reject(confidence):
    rng = np.random.default_rng(0)
    baseline = rng.lognormal(0.0, 0.5, 12)
    values = 0.8 * baseline * rng.lognormal(0.0, 0.3, 12)
    actual = ratio_of_means(values, baseline, confidence)
    assert actual.value == pytest.approx(values.mean() / baseline.mean(), rel=1e-14)
    for end, inside in ((actual.low, 1.0), (actual.high, -1.0)):
        assert holds(end + 1e-6 * inside, values, baseline, confidence)
        assert not holds(end - 1e-6 * inside, values, baseline, confidence)


def test_the_interval_is_student_s_if_the_baseline_is_constant():
    values = np.random.default_rng(1).gamma(3.0, 1.0, 15)
    actual = ratio_of_means(values, np.full(15, 2.0))
    expected = scipy.stats.ttest_1samp(0.5 * values, 0.0).confidence_interval(0.95)
    assert actual[1:] == pytest.approx((expected.low, expected.high), rel=1e-12)


def lognormal_pairs(rng, shape):
    """Return a skewed metric, a correlated baseline, and the true ratio of their means."""
    baseline = rng.lognormal(0.0, 0.5, shape)
    values = 0.8 * baseline * rng.lognormal(0.0, 0.2, shape) + 0.1
    return values, baseline, 0.8 * math.exp(0.02) + 0.1 * math.exp(-0.125)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "allowed"), [(100, 0.007), (20, 0.01)])
def test_the_interval_covers_the_ratio_of_means_of_skewed_metrics(count, allowed):
    """The interval contains the true ratio in 95 % of 4,000 studies, with a binomial standard error of 0.0034.

    For comparison, an interval of the mean of ratios has a coverage of only 72 % with 100 samples.
    """
    rng = np.random.default_rng(2)
    values, baseline, truth = lognormal_pairs(rng, (4000, count))
    actual = np.array([ratio_of_means(*pair) for pair in zip(values, baseline, strict=True)])
    covered = (actual[:, 1] <= truth) & (truth <= actual[:, 2])
    assert np.mean(covered) == pytest.approx(0.95, abs=allowed)


def test_the_interval_depends_neither_on_the_unit_of_the_metrics_nor_on_the_order_of_the_samples():
    values, baseline, _ = lognormal_pairs(np.random.default_rng(3), 30)
    actual = ratio_of_means(values, baseline)
    assert ratio_of_means(1e-3 * values[::-1], 1e-3 * baseline[::-1]) == pytest.approx(actual, rel=1e-12)
    # The confidence interval of the inverse ratio consists of the inverse ends.
    inverse = ratio_of_means(baseline, values)
    assert inverse == pytest.approx((1.0 / actual.value, 1.0 / actual.high, 1.0 / actual.low), rel=1e-12)


def test_the_ratio_of_a_metric_to_itself_is_exactly_one():
    values = np.random.default_rng(4).gamma(2.0, 1.0, 10)
    assert ratio_of_means(values, values) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(("values", "baseline"), [([1.0, math.inf], [1.0, 2.0]), ([1.0, 2.0], [1.0, math.inf])])
def test_infinite_values_such_as_settling_times_have_no_ratio(values, baseline):
    assert all(map(math.isnan, ratio_of_means(np.array(values), np.array(baseline))))


def test_a_ratio_is_unbounded_if_the_baseline_may_be_zero():
    """Student's interval of the baseline contains zero. A significantly large ratio still has a lower end."""
    baseline = np.array([0.0, 0.0, 0.0, 1.0])
    assert scipy.stats.ttest_1samp(baseline, 0.0).confidence_interval(0.95).low < 0.0
    spread = ratio_of_means(np.array([0.0, 1.0, 0.0, 1.0]), baseline)
    assert (spread.value, spread.low, spread.high) == (2.0, 0.0, math.inf)
    large = ratio_of_means(np.array([10.0, 11.0, 9.0, 10.0]), baseline)
    assert (large.value, large.high) == (40.0, math.inf)
    assert 0.0 < large.low < 40.0
    assert holds(large.low * 1.001, np.array([10.0, 11.0, 9.0, 10.0]), baseline)
    assert not holds(large.low * 0.999, np.array([10.0, 11.0, 9.0, 10.0]), baseline)
    assert large.text().endswith(", ∞]")


def test_no_ratio_is_negative():
    """Fieller's set contains negative ratios if the metric is mostly zero. They are removed."""
    actual = ratio_of_means(np.array([0.0, 0.0, 0.0, 1.0]), np.ones(4))
    assert (actual.value, actual.low) == (0.25, 0.0)
    assert math.isfinite(actual.high)


@pytest.mark.parametrize(("values", "baseline"), [([], []), ([1.0], [0.0]), ([0.0, 1.0], [0.0, 0.0])])
def test_a_ratio_is_nan_if_the_baseline_is_empty_or_zero(values, baseline):
    assert np.isnan(ratio_of_means(np.array(values), np.array(baseline))).all()


def test_one_pair_has_a_ratio_and_no_interval():
    actual = ratio_of_means(np.array([3.0]), np.array([2.0]))
    assert actual.value == 1.5
    assert np.isnan(actual[1:]).all()


def test_linearized_ratios_have_the_mean_and_the_standard_error_of_the_ratio():
    """The standard error is compared with the spread of the ratios of many studies."""
    rng = np.random.default_rng(5)
    values, baseline, truth = lognormal_pairs(rng, (2000, 200))
    baseline, truth = 5.0 * baseline, 0.2 * truth
    numbers = linearized_ratio(values[0], baseline[0])
    assert numbers.mean() == pytest.approx(ratio_of_means(values[0], baseline[0]).value, rel=1e-12)
    ratios = values.mean(axis=1) / baseline.mean(axis=1)
    assert ratios.mean() == pytest.approx(truth, rel=3e-3)
    errors = [linearized_ratio(*pair).std(ddof=1) / math.sqrt(200) for pair in zip(values, baseline, strict=True)]
    assert np.mean(errors) == pytest.approx(ratios.std(), rel=0.05)


def test_the_ratio_and_the_difference_of_a_comparison_agree():
    """In this example the mean of the ratios of single samples is above 1, but the ratio of the means is below 1."""
    rng = np.random.default_rng(6)
    baseline = rng.lognormal(0.0, 1.0, 60)
    value = 0.5 * rng.permutation(baseline) + 0.3
    assert np.mean(value / baseline) > 1.0
    metrics, baseline_metrics = (
        Metrics(*[each] * (len(Metrics._fields) - 1), np.full(60, math.inf)) for each in (value, baseline)
    )
    actual = compare(metrics, baseline_metrics)
    assert actual.ratio == ratio_of_means(value, baseline)
    assert (actual.ratio.value < 1.0) == (actual.difference.value < 0.0)
    assert (actual.ratio.high < 1.0) == (actual.difference.high < 0.0)
