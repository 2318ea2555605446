"""Tests of subset simulation for events with known probabilities."""

import math

import numpy as np
import pytest
import scipy

from drake_quad import InputError
from drake_quad.statistics.subset_simulation import (
    MIN_RUNS,
    NOISE_SEED_BOUND,
    probability_of_runs,
    relative_half_width,
    run_together,
    subset_simulation,
    subset_steps,
)

DIMENSION, NUM_NOISE = 20, 10


def mean_of(points):
    return points.sum(axis=1) / math.sqrt(points.shape[1])


def half_space(probability):
    """Return the performance function of an event: the point lies beyond a plane."""
    return lambda points, noise: mean_of(points) + scipy.special.ndtri(probability)


def two_sides(probability):
    """Return the performance function of an event: the first coordinate is large, with either sign.

    A Markov chain cannot change the sign.
    """
    return lambda points, noise: np.abs(points[:, 0]) + scipy.special.ndtri(0.5 * probability)


def far_away(probability):
    """Return the performance function of an event: the first ten coordinates are far from the origin."""
    radius = math.sqrt(scipy.stats.chi2.isf(probability, 10))
    return lambda points, noise: np.linalg.norm(points[:, :10], axis=1) - radius


def event_of_noise(probability):
    """Return the performance function of an event that depends on the noise only."""
    return lambda points, noise: (
        mean_of(scipy.special.ndtri((noise + 0.5) / NOISE_SEED_BOUND)) + scipy.special.ndtri(probability)
    )


def runs_of(performance, seed, number=MIN_RUNS, **options):
    return [
        subset_simulation(performance, DIMENSION, NUM_NOISE, np.random.default_rng([seed, i]), **options)
        for i in range(number)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("event", [half_space, two_sides, far_away, event_of_noise])
@pytest.mark.parametrize("probability", [1e-4])
def test_intervals_contain_the_known_probability_in_95_percent_of_the_cases(event, probability):
    """If the confidence is 95 %, the probability is 0.5 % that at most 11 of 15 intervals contain the true value."""
    performance, hits, ratios = event(probability), 0, []
    for seed in range(15):
        interval = probability_of_runs([run.probability for run in runs_of(performance, seed, size=500)])
        hits += interval.low <= probability <= interval.high
        ratios.append(interval.value / probability)
    assert hits > 11
    assert np.mean(ratios) == pytest.approx(1.0, abs=5.0 * np.std(ratios) / math.sqrt(len(ratios)))


def test_a_run_counts_its_evaluations_and_keeps_the_samples_with_the_event():
    count = 0

    def performance(points, noise):
        nonlocal count
        count += len(points)
        return half_space(1e-4)(points, noise)

    run = subset_simulation(performance, DIMENSION, NUM_NOISE, np.random.default_rng(1), size=400)
    assert run.num_evaluations == count
    assert len(run.history) == len(run.levels)
    assert [*run.levels] == sorted(run.levels)
    assert run.levels[-1] == 0.0
    np.testing.assert_array_equal(run.performance, half_space(1e-4)(run.points, run.noise))
    assert np.all(run.performance >= 0.0)
    assert run.probability == pytest.approx(math.prod(run.fractions[:-1]) * len(run.performance) / 400)
    assert run.fractions[:-1] == (0.1,) * (len(run.levels) - 1)
    for values, level in zip(run.history[:-1], run.levels[:-1], strict=True):
        assert np.sum(values > level) < 40 <= np.sum(values >= level)
    assert 1e-5 < run.probability < 1e-3
    # Most samples with the event are near its boundary, and so is their mean.
    assert mean_of(run.points).mean() == pytest.approx(3.96, abs=0.2)


def test_the_probability_of_exceedance_is_known_at_all_levels():
    runs = runs_of(half_space(1e-5), 3, size=1000)
    thresholds = np.linspace(scipy.special.ndtri(1e-5), 0.0, 7)
    estimates = np.mean([run.exceedance(thresholds) for run in runs], axis=0)
    exact = scipy.special.ndtr(scipy.special.ndtri(1e-5) - thresholds)
    np.testing.assert_allclose(estimates, exact, rtol=0.4)
    assert [run.exceedance(np.zeros(1))[0] for run in runs] == [run.probability for run in runs]


def test_a_frequent_event_needs_no_markov_chains():
    run = subset_simulation(half_space(0.3), DIMENSION, NUM_NOISE, np.random.default_rng(0), size=1000)
    assert run.num_evaluations == 1000
    assert run.probability == pytest.approx(0.3, abs=0.06)


def test_an_event_that_is_not_reached_has_probability_zero():
    run = subset_simulation(
        lambda points, noise: np.minimum(mean_of(points), 1.0) - 2.0, 3, 0, np.random.default_rng(0), size=100
    )
    assert run.probability == 0.0
    assert len(run.performance) == 0
    with pytest.raises(InputError, match="1 of 6 runs did not reach the event"):
        probability_of_runs([0.1] * 5 + [0.0])


@pytest.mark.parametrize("value", [-np.inf, -7.0])
def test_equal_performances_of_most_samples_do_not_change_the_probability(value):
    """The metric of most flights may be constant or infinite, such as the settling time of a flight without an end."""

    def mostly_equal(points, noise):
        distances = half_space(1e-4)(points, noise)
        return np.where(mean_of(points) < -scipy.special.ndtri(0.05), value, distances)

    runs = runs_of(mostly_equal, 2, number=20, size=500)
    assert runs[0].levels[0] > value
    assert 0.03 < runs[0].fractions[0] < 0.07
    interval = probability_of_runs([run.probability for run in runs])
    assert interval.low < 1e-4 < interval.high < 3e-4


def test_a_run_ends_if_almost_all_samples_have_the_same_performance():
    run = runs_of(lambda points, noise: np.where(mean_of(points) > 2.6, 1.0, -3.0), 0, number=1, size=1000)[0]
    assert run.probability == 0.0
    assert 0.99 < run.equal_fraction < 1.0
    assert len(run.performance) == 0


def test_a_frequent_event_is_counted_if_all_other_samples_have_the_same_performance():
    run = runs_of(lambda points, noise: np.where(mean_of(points) > 2.0, 1.0, -3.0), 0, number=1, size=1000)[0]
    assert run.probability == pytest.approx(scipy.special.ndtr(-2.0), abs=0.01)
    assert run.num_evaluations == 1000


def test_too_few_runs_have_no_interval():
    with pytest.raises(InputError, match="needs at least 6 independent runs, but there are 5"):
        probability_of_runs([0.1] * 5)
    interval = probability_of_runs([1e-6, 1.2e-6, 0.9e-6, 1.1e-6, 1e-6, 0.8e-6])
    assert interval.value == pytest.approx(1e-6)
    assert interval.low < 1e-6 < interval.high
    assert relative_half_width(interval) == pytest.approx(0.5 * (interval.high - interval.low) / 1e-6)


def test_the_same_seed_gives_the_same_run():
    first, second = (runs_of(two_sides(1e-3), 5, number=1, size=200)[0] for _ in range(2))
    assert first.probability == second.probability
    np.testing.assert_array_equal(first.noise, second.noise)


def test_simultaneous_runs_equal_separate_runs_and_need_fewer_evaluations():
    """Runs that reach the event earlier end earlier, and do not change the others."""
    sizes, event = [], half_space(0.02)

    def performance(points, noise):
        sizes.append(len(points))
        return event(points, noise)

    steps = [subset_steps(DIMENSION, NUM_NOISE, np.random.default_rng([3, i]), size=200) for i in range(4)]
    together = run_together(performance, steps)
    separate_runs = runs_of(event, 3, 4, size=200)
    for result, expected in zip(together, separate_runs, strict=True):
        assert (result.probability, result.levels) == (expected.probability, expected.levels)
        np.testing.assert_array_equal(result.points, expected.points)
    assert sizes[0] == 4 * 200
    assert sum(sizes) == sum(run.num_evaluations for run in separate_runs)
    assert len(sizes) == max(run.num_evaluations - 200 for run in separate_runs) // 20 + 1
