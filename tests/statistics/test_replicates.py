"""Tests of estimates from samples in independent replicates."""

import math

import numpy as np
import pytest
import scipy

from drake_quad.statistics.estimates import (
    bounded_mean_interval,
    mean_interval,
    proportion_interval,
    quantile_interval,
    running_mean,
)
from drake_quad.statistics.ratios import ratio_of_means
from drake_quad.statistics.replicates import INDEPENDENT, MIN_REPLICATES, Replicates


def test_the_mean_has_student_s_interval_over_the_means_of_the_replicates():
    values = np.random.default_rng(0).exponential(size=(20, 7))
    result = Replicates(np.repeat(np.arange(20), 7)).mean(values.ravel())
    expected = scipy.stats.ttest_1samp(values.mean(axis=1), 0.0).confidence_interval(0.95)
    assert result == pytest.approx((values.mean(), expected.low, expected.high))


def test_a_mean_over_replicates_of_different_sizes_is_the_mean_of_the_values():
    """The variance of the mean of independent values does not depend on how they are divided into replicates."""
    rng = np.random.default_rng(1)
    members = np.sort(rng.integers(400, size=4000))
    values = rng.normal(3.0, 1.0, 4000)
    result, plain = Replicates(members).mean(values), mean_interval(values)
    assert result.value == pytest.approx(plain.value)
    assert result.high - result.low == pytest.approx(plain.high - plain.low, rel=0.1)


def test_without_replicates_all_intervals_are_those_of_independent_samples():
    values = np.random.default_rng(2).random(50)
    assert INDEPENDENT.take(slice(9)).mean(values) == mean_interval(values)
    assert INDEPENDENT.proportion(values > 0.8) == proportion_interval(int(np.sum(values > 0.8)), 50)
    assert INDEPENDENT.quantile(values, 0.3) == quantile_interval(values, 0.3)
    assert INDEPENDENT.ratio(values, values + 1.0) == ratio_of_means(values, values + 1.0)
    np.testing.assert_array_equal(INDEPENDENT.running_mean(values)[1:], running_mean(values))


def test_equal_samples_of_a_replicate_count_once():
    """A proportion from 40 replicates, each of ten equal samples, is at least as uncertain as one from 40 samples."""
    occurs = np.random.default_rng(3).random(40) < 0.3
    replicates = Replicates(np.repeat(np.arange(40), 10))
    assert replicates.effective_number(np.repeat(occurs, 10)) == pytest.approx(37, abs=2)
    result, expected = replicates.proportion(np.repeat(occurs, 10)), proportion_interval(int(occurs.sum()), 40)
    assert result == pytest.approx(expected, abs=0.01)
    values = np.random.default_rng(4).normal(size=40)
    median, plain = replicates.quantile(np.repeat(values, 10), 0.5), quantile_interval(values, 0.5)
    assert median.value == plain.value
    assert median.low <= plain.low <= plain.high <= median.high


def test_the_interval_of_a_proportion_is_never_narrower_than_for_independent_samples():
    balanced = np.tile([True, False], 160)
    replicates = Replicates(np.repeat(np.arange(16), 20))
    assert replicates.effective_number(balanced) == 320
    assert replicates.proportion(balanced) == proportion_interval(160, 320)
    for occurs in (np.zeros(320, dtype=bool), np.ones(320, dtype=bool)):
        assert replicates.proportion(occurs) == proportion_interval(int(occurs.sum()), 320)


def test_one_replicate_gives_no_interval():
    replicates = Replicates(np.zeros(10, dtype=int))
    assert all(math.isnan(end) for end in replicates.mean(np.arange(10.0))[1:])
    assert replicates.proportion(np.arange(10) < 3).high > 0.9


def test_a_fraction_has_an_interval_within_0_and_1():
    values = np.random.default_rng(5).beta(0.2, 8.0, 64)
    result = Replicates(np.repeat(np.arange(16), 4)).fraction(values)
    assert result.value == pytest.approx(values.mean())
    assert 0.0 < result.low < result.value < result.high < 1.0


def test_a_ratio_of_samples_is_the_ratio_of_the_sums_over_replicates():
    rng = np.random.default_rng(6)
    values, baseline = rng.random((16, 5)), rng.random((16, 5))
    result = Replicates(np.repeat(np.arange(16), 5)).ratio(values.ravel(), baseline.ravel())
    assert result == pytest.approx(ratio_of_means(values.mean(axis=1), baseline.mean(axis=1)))


def test_the_running_mean_ends_with_the_mean_over_all_replicates():
    values = np.random.default_rng(7).random(200)
    replicates = Replicates(np.repeat(np.arange(20), 10))
    count, *means = replicates.running_mean(values)
    assert (count[0], count[-1]) == (1, 200)
    assert [each[-1] for each in means] == pytest.approx(replicates.mean(values))


def test_the_fraction_of_independent_samples_has_the_bounded_interval():
    values = np.random.default_rng(0).beta(0.5, 3.0, size=30)
    assert INDEPENDENT.fraction(values, 0.9) == bounded_mean_interval(values, 0.9)


def test_the_smallest_number_of_replicates_has_a_factor_close_to_that_of_the_normal_distribution():
    assert scipy.stats.t.ppf(0.975, MIN_REPLICATES - 1) == pytest.approx(2.13, abs=0.005)
