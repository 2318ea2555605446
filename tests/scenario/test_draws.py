"""Tests of designed draws: Latin hypercubes and Sobol sequences."""

import numpy as np
import pytest
import scipy

from drake_quad import InputError, load_scenario
from drake_quad.scenario.batch import Batch, check_pairs, coordinates
from drake_quad.scenario.draws import DesignedDraws
from drake_quad.statistics.replicates import Replicates

DESIGN_KINDS = ["latin_hypercube", "sobol"]
CORRELATED_FIELDS = {
    "vehicle.mass": {"normal": {"mean": 0.7, "standard_deviation": 0.02, "min": 0.6, "max": 0.8, "shared": {"a": 0.8}}},
    "vehicle.linear_drag": {"uniform": {"min": 0.1, "max": 0.3}},
    "vehicle.centre_of_mass.0": {
        "normal": {"mean": 0.0, "standard_deviation": 0.001, "min": -0.01, "shared": {"a": -0.5}}
    },
}


def scenario(kind, size=64, **fields):
    draws = None if kind is None else {"kind": kind, "size": size}
    return load_scenario(
        "laboratory:low_wind", [{key: each} for key, each in {**CORRELATED_FIELDS, **fields}.items()]
    ).model_copy(update={"draws": draws and DesignedDraws(**draws)})


def points(kind, size, samples, names=("a", "b", "c"), seed=5):
    numbers = DesignedDraws(kind=kind, size=size).numbers(seed, samples, names)
    return np.stack([numbers[name] for name in names], axis=1)


@pytest.mark.parametrize("kind", DESIGN_KINDS)
def test_each_replicate_has_one_number_in_each_of_its_equal_intervals(kind):
    result = points(kind, 32, range(96)).reshape(3, 32, 3)
    expected = np.broadcast_to(np.arange(32)[:, None], (32, 3))
    for replicate in result:
        np.testing.assert_array_equal(np.sort(np.floor(32 * replicate), axis=0), expected)
    assert len(np.unique(result)) == result.size


def test_a_replicate_of_a_sobol_sequence_covers_pairs_of_numbers_evenly():
    """In the plane of the first two numbers, each dyadic rectangle of area 2^-k contains one of 2^k points."""
    result = points("sobol", 64, range(64), ("a", "b"))
    for first in range(7):
        cells = np.floor(result * (2**first, 2 ** (6 - first)))
        assert len(np.unique(cells, axis=0)) == 64


@pytest.mark.parametrize("kind", DESIGN_KINDS)
def test_numbers_are_uniform_over_all_replicates(kind):
    result = np.concatenate([points(kind, 4, range(400), seed=seed) for seed in range(5)])
    for column in result.T:
        assert scipy.stats.kstest(column, "uniform").pvalue > 0.01
    assert np.abs(np.corrcoef(result.T) - np.eye(3)).max() < 0.06


@pytest.mark.parametrize("kind", DESIGN_KINDS)
def test_a_sample_does_not_depend_on_its_batch(kind):
    full_batch = Batch.draw(scenario(kind), range(200))
    part = Batch.draw(scenario(kind), [150, 3, 64])
    for path, values in full_batch.varying.items():
        np.testing.assert_array_equal(part.varying[path], values[[150, 3, 64]])
    sample_scenario = part.vehicle_scenario(1)
    assert (sample_scenario.vehicle.mass, sample_scenario.sample, sample_scenario.draws) == (
        full_batch.varying["vehicle.mass"][3],
        3,
        None,
    )
    assert part.noise_samples.indices == (150, 3, 64)


@pytest.mark.parametrize("kind", DESIGN_KINDS)
def test_designed_draws_have_the_distributions_and_correlations_of_the_scenario(kind):
    names = "vehicle.mass", "vehicle.centre_of_mass.0", "vehicle.linear_drag"
    designed, independent = (Batch.draw(scenario(each), range(4096)).varying for each in (kind, None))
    for name in names:
        assert scipy.stats.ks_2samp(designed[name], independent[name]).pvalue > 0.01
    result, expected = (np.corrcoef([each[name] for name in names]) for each in (designed, independent))
    np.testing.assert_allclose(result, expected, atol=0.05)
    assert len(coordinates(scenario(kind))) == 4


def test_independent_draws_have_the_values_of_earlier_versions():
    """The expected numbers were drawn by a version without the kinds latin_hypercube and sobol."""
    assert Batch.draw(scenario(None), [0, 1, 2]).varying["vehicle.mass"].tolist() == [
        0.6982564584397424,
        0.7091102985541686,
        0.6853294518017968,
    ]


def test_fields_of_a_latin_hypercube_do_not_depend_on_other_fields():
    first = scenario("latin_hypercube")
    second = scenario("latin_hypercube", **{"vehicle.quadratic_drag": {"uniform": {"min": 0.0, "max": 0.1}}})
    name = "vehicle.linear_drag"
    np.testing.assert_array_equal(*(Batch.draw(each, range(70)).varying[name] for each in (first, second)))
    check_pairs({"first": first, "second": second})


def test_scenarios_whose_samples_do_not_correspond_cannot_be_compared_in_pairs():
    additional_field = {"vehicle.quadratic_drag": {"uniform": {"min": 0.0, "max": 0.1}}}
    with pytest.raises(
        InputError, match=r"second and first have different random parameters \(vehicle.quadratic_drag\)"
    ):
        check_pairs({"first": scenario("sobol"), "second": scenario("sobol", **additional_field)})
    with pytest.raises(InputError, match="second and first have different draws"):
        check_pairs({"first": scenario("sobol"), "second": scenario(None)})


@pytest.mark.long
@pytest.mark.parametrize("kind", DESIGN_KINDS)
def test_means_are_precise_and_their_intervals_contain_the_true_mean(kind):
    """The confidence interval of a smooth function's mean is at most a quarter as wide as with independent samples."""
    num_samples, repetitions, names = 256, 200, [f"x{i}" for i in range(4)]
    hits, widths, samples = 0, [], np.arange(num_samples)
    for seed in range(repetitions):
        values = np.exp(0.5 * points(kind, 16, samples, names, seed=seed).sum(axis=1))
        mean = Replicates(samples // 16).mean(values)
        hits += mean.low <= (2.0 * np.expm1(0.5)) ** 4 <= mean.high
        widths.append(mean.high - mean.low)
    assert hits / repetitions >= 0.92
    deviation = np.std(np.exp(0.5 * np.random.default_rng(0).random((10_000, 4)).sum(axis=1)))
    assert np.mean(widths) < 0.25 * 2.0 * 1.96 * deviation / np.sqrt(num_samples)


@pytest.mark.parametrize(
    ("draws", "words"),
    [
        ("{kind: sobol, size: 48}", "draws.size is 48, but must be a power of two for sobol"),
        ("{kind: sobol, size: 1}", "draws.size"),
        ("{kind: halton, size: 16}", "draws.kind"),
    ],
)
def test_invalid_settings_of_draws_are_refused(draws, words):
    with pytest.raises(InputError, match=words):
        load_scenario("hover", [f"draws={draws}"])
