"""Tests that functions of `drake_quad.statistics.estimates`, such as quantiles and ranks, agree with `scipy.stats`."""

import math

import numpy as np
import pytest
import scipy

from drake_quad.statistics.estimates import (
    _binomial_quantile,
    _ranks,
    partial_rank_correlation,
    rank_correlation,
    two_sided_sign_test,
)


@pytest.mark.parametrize("total", [1, 2, 3, 32, 1000, 20_000])
@pytest.mark.parametrize("probability", [0.01, 0.5, 0.95])
def test_quantiles_of_binomial_distributions_agree_with_scipy(total, probability):
    # These probabilities lie between the steps of the distribution function, where rounding errors have no effect.
    middle = round(total * probability)
    steps = scipy.stats.binom.cdf(np.arange(max(middle - 20, 0), min(middle + 20, total)), total, probability)
    for fraction in (0.005, 0.025, 0.5, 0.975, 0.995, *0.5 * (steps[1:] + steps[:-1])):
        assert _binomial_quantile(fraction, total, probability) == scipy.stats.binom.ppf(fraction, total, probability)


@pytest.mark.parametrize("total", [1, 2, 3, 10])
def test_a_count_is_the_quantile_of_its_cumulative_probability(total):
    """The tested probability is one half, for which the cumulative probabilities have no rounding errors."""
    fractions = np.cumsum([math.comb(total, count) for count in range(total)]) / 2.0**total
    assert [_binomial_quantile(fraction, total, 0.5) for fraction in fractions] == [*range(total)]


def test_equal_values_get_the_mean_of_their_ranks():
    assert _ranks(np.array([3.0, 1.0, 3.0, 2.0, 3.0])).tolist() == [4.0, 1.0, 4.0, 2.0, 4.0]
    values = np.random.default_rng(0).integers(0, 9, 100).astype(float)
    np.testing.assert_array_equal(_ranks(values), scipy.stats.rankdata(values))


def test_the_sign_test_agrees_with_scipy():
    assert two_sided_sign_test(0, 0) == 1.0
    for total in range(1, 25):
        for count in range(total + 1):
            expected = scipy.stats.binomtest(count, total).pvalue
            assert two_sided_sign_test(count, total) == pytest.approx(expected, rel=1e-12)


def test_infinite_values_have_ranks_and_a_constant_has_no_rank_correlation():
    """Settling times are infinite for vehicles that do not settle."""
    x = np.arange(6.0)
    some = np.array([1.0, 2.0, 3.0, 4.0, math.inf, math.inf])
    assert rank_correlation(x, some) == rank_correlation(x, np.minimum(some, 5.0))
    assert math.isnan(rank_correlation(x, np.full(6, math.inf)).value)
    assert math.isnan(partial_rank_correlation(x, np.full(6, math.inf), np.array([x[::-1] ** 2])).value)


@pytest.mark.parametrize("num_samples", [12, 400])
def test_a_variable_that_the_others_determine_has_no_partial_correlation(num_samples):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, num_samples))
    assert math.isnan(partial_rank_correlation(x, y, np.array([np.exp(x)])).value)
    assert math.isnan(partial_rank_correlation(y, x, np.array([np.exp(x)])).value)
    assert math.isfinite(partial_rank_correlation(x, y, np.array([rng.normal(size=num_samples)])).value)
