"""Samples of a study: distributed as written, and the same whatever else is drawn."""

import numpy as np
import pytest
from scipy import stats

from drake_quad import InputError, load_scenario
from drake_quad.scenario import distributions_in, draw_sample, draw_samples

DISTRIBUTIONS = {
    "{uniform: {min: 0.6, max: 0.8}}": stats.uniform(0.6, 0.2),
    "{log_uniform: {min: 0.1, max: 10}}": stats.loguniform(0.1, 10.0),
    "{normal: {mean: 0.7, standard_deviation: 0.02, min: 0.66}}": stats.truncnorm(-2.0, np.inf, 0.7, 0.02),
    "{normal: {mean: 0.7, standard_deviation: 0.02, min: 0.69, max: 0.73}}": stats.truncnorm(-0.5, 1.5, 0.7, 0.02),
}


@pytest.fixture
def study(diagrams):
    return lambda *overrides: load_scenario(diagrams / "figure_eight.yaml", overrides)


@pytest.mark.parametrize("written", DISTRIBUTIONS)
def test_drawn_values_have_the_distribution_that_is_written(study, written):
    masses = draw_samples(study(f"vehicle.mass={written}"), range(4000)).vehicle.mass
    assert stats.kstest(masses, DISTRIBUTIONS[written].cdf).pvalue > 1e-3


def test_choices_are_equally_likely(study):
    rotors = draw_samples(study("vehicle.rotor_failure={rotor: {choice: [1, 2, 4]}, time: 3}"), range(3000))
    values, counts = np.unique(rotors.vehicle.rotor_failure.rotor, return_counts=True)
    assert values.tolist() == [1.0, 2.0, 4.0]
    assert stats.chisquare(counts).pvalue > 1e-3


def test_one_sample_alone_is_the_same_as_among_many(study):
    scenario = study(
        "vehicle.mass={uniform: {min: 0.6, max: 0.8}}",
        "control.position.k_p=[{uniform: {min: 0.5, max: 1}}, 0.8, {normal: {mean: 4, standard_deviation: 1, min: 1}}]",
        "laboratory.wind=[{kind: steady, velocity: [{normal: {mean: 0, standard_deviation: 2}}, 0, 0]}]",
    )
    many = draw_samples(scenario, range(20), seed=9)
    for i in (0, 13):
        one = draw_sample(scenario, i, seed=9)
        assert distributions_in(one) == []
        assert (one.seed, one.sample) == (9, i)
        assert one.vehicle.mass == many.vehicle.mass[i]
        assert one.control.position.k_p == (many.control.position.k_p[0][i], 0.8, many.control.position.k_p[2][i])
        assert one.laboratory.wind[0].velocity[0] == many.laboratory.wind[0].velocity[0][i]
    assert one.vehicle.mass != draw_sample(scenario, 13, seed=8).vehicle.mass


def test_a_field_is_drawn_the_same_whatever_else_is_drawn(study):
    mass, drag = "vehicle.mass={uniform: {min: 0.6, max: 0.8}}", "vehicle.linear_drag={uniform: {min: 0, max: 0.3}}"
    both, alone = draw_samples(study(mass, drag), range(50)), draw_samples(study(mass), range(50))
    np.testing.assert_array_equal(both.vehicle.mass, alone.vehicle.mass)
    assert abs(np.corrcoef(both.vehicle.mass, both.vehicle.linear_drag)[0, 1]) < 0.5


def test_what_is_not_drawn_stays_as_it_is(study):
    scenario = study("vehicle.mass={uniform: {min: 0.6, max: 0.8}}")
    drawn = draw_samples(scenario, range(3))
    assert drawn.control is scenario.control
    assert drawn.vehicle.model_copy(update={"mass": 0.0}) == scenario.vehicle.model_copy(update={"mass": 0.0})


@pytest.mark.parametrize(
    ("sample", "seed", "words"), [(-1, 0, "sample is -1"), (2**31, 0, "sample is"), (0, -3, "seed is -3")]
)
def test_a_wrong_seed_or_sample_is_refused(study, sample, seed, words):
    with pytest.raises(InputError, match=words):
        draw_sample(study(), sample, seed=seed)


def test_a_fleet_flies_one_route(study):
    with pytest.raises(InputError, match=r"route.radius is a distribution; the vehicles of a fleet fly one route"):
        draw_samples(study("route.radius={uniform: {min: 1.2, max: 1.4}}"), range(2))
