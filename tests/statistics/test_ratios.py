"""Tests of ratios of means: Fieller's definition, coverage, and unbounded intervals."""

import math

import numpy as np
import pytest
import scipy

from drake_quad.laboratory.metrics import Metrics
from drake_quad.statistics.ratios import linearized_ratio, ratio_of_means
from drake_quad.studies.statistics import compare


def holds(ratio, values, baseline, confidence=0.95):
    """Return True if Student's interval (by SciPy) of the mean of a - R b contains zero."""
    return scipy.stats.ttest_1samp(values - ratio * baseline, 0.0).pvalue >= 1.0 - confidence


@pytest.mark.parametrize("confidence", [0.5, 0.95])
def test_the_interval_contains_the_ratios_that_a_t_test_does_not_reject(confidence):
    rng = np.random.default_rng(0)
    baseline = rng.lognormal(0.0, 0.5, 12)
    values = 0.8 * baseline * rng.lognormal(0.0, 0.3, 12)
    found = ratio_of_means(values, baseline, confidence)
    assert found.value == pytest.approx(values.mean() / baseline.mean(), rel=1e-14)
    for end, inside in ((found.low, 1.0), (found.high, -1.0)):
        assert holds(end + 1e-6 * inside, values, baseline, confidence)
        assert not holds(end - 1e-6 * inside, values, baseline, confidence)


def test_the_interval_is_student_s_if_the_baseline_is_constant():
    values = np.random.default_rng(1).gamma(3.0, 1.0, 15)
    found = ratio_of_means(values, np.full(15, 2.0))
    expected = scipy.stats.ttest_1samp(0.5 * values, 0.0).confidence_interval(0.95)
    assert found[1:] == pytest.approx((expected.low, expected.high), rel=1e-12)


def lognormal_pairs(rng, shape):
    """Return a metric and its baseline, skewed and correlated, and the true ratio of their means."""
    baseline = rng.lognormal(0.0, 0.5, shape)
    values = 0.8 * baseline * rng.lognormal(0.0, 0.2, shape) + 0.1
    return values, baseline, 0.8 * math.exp(0.02) + 0.1 * math.exp(-0.125)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "allowed"), [(100, 0.007), (20, 0.01)])
def test_the_interval_covers_the_ratio_of_means_of_skewed_metrics(count, allowed):
    """The interval covers 95 % of 4,000 studies, with a binomial error of 0.0034.

    An interval of the mean of ratios covers only 72 % at 100 samples.
    """
    rng = np.random.default_rng(2)
    values, baseline, truth = lognormal_pairs(rng, (4000, count))
    found = np.array([ratio_of_means(*pair) for pair in zip(values, baseline, strict=True)])
    covered = (found[:, 1] <= truth) & (truth <= found[:, 2])
    assert np.mean(covered) == pytest.approx(0.95, abs=allowed)


def test_the_interval_does_not_depend_on_the_unit_or_on_the_order():
    values, baseline, _ = lognormal_pairs(np.random.default_rng(3), 30)
    found = ratio_of_means(values, baseline)
    assert ratio_of_means(1e-3 * values[::-1], 1e-3 * baseline[::-1]) == pytest.approx(found, rel=1e-12)
    # The interval of the inverse ratio consists of the inverses.
    inverse = ratio_of_means(baseline, values)
    assert inverse == pytest.approx((1.0 / found.value, 1.0 / found.high, 1.0 / found.low), rel=1e-12)


def test_the_ratio_of_a_metric_to_itself_is_exactly_one():
    values = np.random.default_rng(4).gamma(2.0, 1.0, 10)
    assert ratio_of_means(values, values) == (1.0, 1.0, 1.0)


def test_a_baseline_near_zero_leaves_the_ratio_unbounded():
    """Student's interval of the baseline contains zero. A large ratio has a lower end but no upper end."""
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


def test_ratios_are_not_negative():
    """Fieller's set has negative ratios if the metric is mostly zero, and these are cut off."""
    found = ratio_of_means(np.array([0.0, 0.0, 0.0, 1.0]), np.ones(4))
    assert (found.value, found.low) == (0.25, 0.0)
    assert math.isfinite(found.high)


@pytest.mark.parametrize(("values", "baseline"), [([], []), ([1.0], [0.0]), ([0.0, 1.0], [0.0, 0.0])])
def test_without_a_baseline_there_is_no_ratio(values, baseline):
    assert np.isnan(ratio_of_means(np.array(values), np.array(baseline))).all()


def test_one_pair_has_a_ratio_and_no_interval():
    found = ratio_of_means(np.array([3.0]), np.array([2.0]))
    assert found.value == 1.5
    assert np.isnan(found[1:]).all()


def test_linearized_ratios_have_the_mean_and_the_error_of_the_ratio():
    """The error is the spread of the ratios of many studies."""
    rng = np.random.default_rng(5)
    values, baseline, truth = lognormal_pairs(rng, (2000, 200))
    baseline, truth = 5.0 * baseline, 0.2 * truth
    numbers = linearized_ratio(values[0], baseline[0])
    assert numbers.mean() == pytest.approx(ratio_of_means(values[0], baseline[0]).value, rel=1e-12)
    ratios = values.mean(axis=1) / baseline.mean(axis=1)
    assert ratios.mean() == pytest.approx(truth, rel=3e-3)
    errors = [linearized_ratio(*pair).std(ddof=1) / math.sqrt(200) for pair in zip(values, baseline, strict=True)]
    assert np.mean(errors) == pytest.approx(ratios.std(), rel=0.05)


def test_ratio_and_difference_of_a_comparison_agree():
    """The mean of the ratios of single samples is above 1 here, although the metric has the smaller mean."""
    rng = np.random.default_rng(6)
    baseline = rng.lognormal(0.0, 1.0, 60)
    value = 0.5 * rng.permutation(baseline) + 0.3
    assert np.mean(value / baseline) > 1.0
    metrics, other = (
        Metrics(*[each] * (len(Metrics._fields) - 1), np.full(60, math.inf)) for each in (value, baseline)
    )
    found = compare(metrics, other)
    assert found.ratio == ratio_of_means(value, baseline)
    assert (found.ratio.value < 1.0) == (found.difference.value < 0.0)
    assert (found.ratio.high < 1.0) == (found.difference.high < 0.0)
