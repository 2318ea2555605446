"""Tests of confidence sequences."""

import math

import numpy as np
import pytest
import scipy

from drake_quad.statistics.estimates import mean_interval, proportion_interval
from drake_quad.statistics.sequential import mean_sequence, probability_sequence

CHECKPOINTS = [round(256 * 1.25**k) for k in range(16)]  # up to 7,275 samples


@pytest.mark.parametrize(("count", "total"), [(3, 200), (0, 50), (50, 50), (120, 200)])
def test_the_likelihood_ratio_reaches_its_limit_at_the_interval_ends(count, total):
    estimate = probability_sequence(count, total, 0.9)
    assert estimate.value == count / total
    mixture, _ = scipy.integrate.quad(
        lambda x: scipy.stats.beta.pdf(x, 0.5, 0.5) * scipy.stats.binom.pmf(count, total, x), 0.0, 1.0
    )
    for end, limit in ((estimate.low, 0.0), (estimate.high, 1.0)):
        if end == limit:
            assert count == limit * total
        else:
            assert mixture / scipy.stats.binom.pmf(count, total, end) == pytest.approx(10.0, rel=1e-4)


def test_intervals_of_sequences_are_up_to_twice_as_long_as_ordinary_intervals():
    values = np.random.default_rng(0).exponential(size=1000)
    sequence, interval = mean_sequence(values), mean_interval(values)
    assert sequence.value == interval.value
    assert 1.3 < (sequence.high - sequence.low) / (interval.high - interval.low) < 1.9
    sequence, interval = probability_sequence(30, 1000), proportion_interval(30, 1000)
    assert 1.2 < (sequence.high - sequence.low) / (interval.high - interval.low) < 1.9


@pytest.mark.long
@pytest.mark.parametrize("probability", [1e-3, 0.01, 0.3, 0.97])
def test_all_intervals_of_a_probability_contain_it_in_95_percent_of_studies(probability):
    """For comparison, the fraction of studies in which all ordinary intervals contain the probability is smaller."""
    generator = np.random.default_rng(1)
    events = generator.random((1000, CHECKPOINTS[-1])) < probability
    counts = np.cumsum(events, axis=1)[:, np.array(CHECKPOINTS) - 1]
    covered, ordinary = (
        np.mean(
            [
                all(
                    (estimate := function(int(count), total)).low <= probability <= estimate.high
                    for count, total in zip(row, CHECKPOINTS, strict=True)
                )
                for row in counts[:300]
            ]
        )
        for function in (probability_sequence, proportion_interval)
    )
    assert covered >= 0.95
    assert ordinary < covered


@pytest.mark.long
@pytest.mark.parametrize(
    ("draw", "mean"),
    [
        (lambda generator, shape: generator.exponential(size=shape), 1.0),
        (lambda generator, shape: generator.lognormal(0.0, 1.0, shape), math.exp(0.5)),
        (lambda generator, shape: 5.0 + generator.standard_normal(shape), 5.0),
    ],
)
def test_all_intervals_of_a_mean_contain_it_in_95_percent_of_studies(draw, mean):
    values = draw(np.random.default_rng(2), (1000, CHECKPOINTS[-1]))
    covered = [
        all((estimate := mean_sequence(row[:check])).low <= mean <= estimate.high for check in CHECKPOINTS)
        for row in values
    ]
    assert np.mean(covered) >= 0.95


def test_a_sequence_of_too_few_samples_does_not_bound_the_estimate():
    assert probability_sequence(0, 0)[1:] == (0.0, 1.0)
    assert math.isnan(mean_sequence(np.array([])).value)
    assert mean_sequence(np.array([2.0])).value == 2.0
    assert math.isnan(mean_sequence(np.array([2.0])).low)
