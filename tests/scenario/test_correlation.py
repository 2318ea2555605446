"""Tests of correlated distributions: covariance, marginals, and agreement with samples of earlier releases."""

import json

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_normals import joint_normal

from drake_quad import InputError
from drake_quad.randomness.streams import parameter_numbers
from drake_quad.scenario import correlation
from drake_quad.scenario.batch import Batch, draw_sample
from drake_quad.scenario.correlation import (
    correlated_groups,
    correlated_normals,
    correlated_pairs,
    correlation_matrix,
    shared_names,
)
from drake_quad.scenario.distributions import Normal
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.limits import MAX_SHARED
from drake_quad.scenario.paths import distributions_in

MASS_FIELD = "vehicle.mass"
LAG_FIELD = "vehicle.rotor_time_constant"
DRAG_FIELD = "vehicle.linear_drag"
UNIFORM_YAML = "{uniform: {min: 0.0, max: 0.1}}"


def normal_text(mean, deviation, shared="", limits=""):
    return f"{{normal: {{mean: {mean}, standard_deviation: {deviation}{limits}{shared and f', shared: {shared}'}}}}}"


def correlated_overrides(shared_of_mass="{a: 0.9, b: -0.3}", shared_of_lag="{a: -0.5}", shared_of_drag="{b: 1.0}"):
    return (
        f"{MASS_FIELD}={normal_text(0.68, 0.02, shared_of_mass, ', min: 0.5')}",
        f"{LAG_FIELD}={normal_text(0.05, 0.004, shared_of_lag, ', min: 0.03, max: 0.07')}",
        f"{DRAG_FIELD}={normal_text(0.2, 0.1, shared_of_drag, ', min: 0.15')}",
    )


@pytest.fixture(scope="module")
def study(diagrams):
    return lambda *overrides: load_scenario(diagrams / "figure_eight.yaml", overrides)


@pytest.fixture(scope="module")
def samples(study):
    return Batch.draw(study(*correlated_overrides()), range(20_000)).varying


def test_samples_have_the_given_covariance(study, samples):
    """Without truncation, the correlation of 20,000 samples has a standard deviation of at most 0.007."""
    joint = joint_normal(distributions_in(study(*correlated_overrides())))
    assert joint.paths == (MASS_FIELD, DRAG_FIELD, LAG_FIELD)
    deviation = np.array([0.02, 0.1, 0.004])
    correlation = np.array([[1.0, -0.3, -0.45], [-0.3, 1.0, 0.0], [-0.45, 0.0, 1.0]])
    np.testing.assert_allclose(joint.covariance, correlation * np.outer(deviation, deviation), atol=1e-15)
    np.testing.assert_array_equal(joint.mean, [0.68, 0.2, 0.05])
    untruncated = np.ix_([0, 2], [0, 2])
    covariance = np.cov([samples[MASS_FIELD], samples[LAG_FIELD]]) / np.outer(deviation, deviation)[untruncated]
    assert np.abs(covariance - correlation[untruncated]).max() < 0.03


def test_limits_do_not_change_the_copula(samples):
    """Spearman's correlation under a Gaussian copula is 6/π asin(r/2), for any limits of the distributions."""
    ranks = scipy.stats.spearmanr(
        np.stack([samples[MASS_FIELD], samples[LAG_FIELD], samples[DRAG_FIELD]]), axis=1
    ).statistic
    for i, j, normal in ((0, 1, -0.45), (0, 2, -0.3), (1, 2, 0.0)):
        assert ranks[i, j] == pytest.approx(6.0 / np.pi * np.arcsin(0.5 * normal), abs=0.02)


@pytest.mark.parametrize(
    ("path", "arguments"),
    [
        (MASS_FIELD, (-9.0, np.inf, 0.68, 0.02)),
        (LAG_FIELD, (-5.0, 5.0, 0.05, 0.004)),
        (DRAG_FIELD, (-0.5, np.inf, 0.2, 0.1)),
    ],
)
def test_each_field_has_its_given_distribution(samples, path, arguments):
    assert scipy.stats.kstest(samples[path], "truncnorm", arguments).pvalue > 1e-3


def test_samples_of_an_uncorrelated_normal_agree_with_earlier_releases(study):
    """Samples are bit-identical, because they use only the random numbers of their own field."""
    values = Batch.draw(study(*correlated_overrides("", "", "")), range(50), seed=3).varying
    expected = 0.68 + 0.02 * scipy.special.ndtri(
        (low := scipy.special.ndtr((0.5 - 0.68) / 0.02)) + parameter_numbers(3, range(50), MASS_FIELD) * (1.0 - low)
    )
    np.testing.assert_array_equal(values[MASS_FIELD], expected)
    empty = Batch.draw(study(*correlated_overrides("{}", "{}", "{}")), range(50), seed=3).varying
    np.testing.assert_array_equal(empty[MASS_FIELD], values[MASS_FIELD])


def test_samples_of_shared_variables_agree_with_earlier_releases(study):
    """The expected values are from the release that introduced shared variables."""
    values = Batch.draw(study(correlated_overrides()[0]), [0, 1, 41], seed=7).varying[MASS_FIELD]
    np.testing.assert_allclose(values, [0.6461897527911218, 0.6293774984326039, 0.6691488411462073], rtol=1e-14)


def test_samples_of_a_field_do_not_depend_on_uncorrelated_fields(study):
    """Samples of the field stay the same if other correlated fields are added or removed."""
    both_fields = Batch.draw(study(*correlated_overrides()), range(20), seed=5).varying
    mass_only = Batch.draw(study(correlated_overrides()[0]), range(20), seed=5).varying
    np.testing.assert_array_equal(mass_only[MASS_FIELD], both_fields[MASS_FIELD])
    number = Batch.draw(study(*correlated_overrides(), f"{LAG_FIELD}=0.05"), range(20), seed=5).varying
    assert [*number] == [MASS_FIELD, DRAG_FIELD]
    np.testing.assert_array_equal(number[DRAG_FIELD], both_fields[DRAG_FIELD])
    sample_scenario = draw_sample(study(*correlated_overrides()), 13, seed=5)
    assert (sample_scenario.vehicle.mass, sample_scenario.vehicle.rotor_time_constant) == (
        both_fields[MASS_FIELD][13],
        both_fields[LAG_FIELD][13],
    )
    assert not np.any(
        Batch.draw(study(*correlated_overrides()), range(20), seed=6).varying[MASS_FIELD] == both_fields[MASS_FIELD]
    )


def test_only_fields_with_the_same_shared_variable_are_correlated(study):
    """Two fields with correlations of 1 or -1 to the variable `a` have equal or opposite ranks.

    Two fields with correlations to different variables are independent.
    """
    positive, negative, independent = (
        Batch.draw(study(*correlated_overrides("{a: 1.0}", shared, "")), range(200)).varying
        for shared in ("{a: 1.0}", "{a: -1.0}", "{vehicle: 1.0}")
    )
    assert scipy.stats.spearmanr(positive[MASS_FIELD], positive[LAG_FIELD]).statistic == pytest.approx(1.0)
    assert scipy.stats.spearmanr(negative[MASS_FIELD], negative[LAG_FIELD]).statistic == pytest.approx(-1.0)
    assert abs(scipy.stats.spearmanr(independent[MASS_FIELD], independent[LAG_FIELD]).statistic) < 0.3


def test_drawn_values_are_finite_for_any_number_of_shared_variables(study, monkeypatch):
    """The sum of sixteen variables at their extremes is larger than a single variable can be."""
    monkeypatch.setattr(
        correlation, "parameter_numbers", lambda seed, samples, stream: np.full(len(samples), 1.0 - 2.0**-53)
    )
    shared = ", ".join(f"x{i}: 0.25" for i in range(16))
    scenario = study(f"vehicle.centre_of_mass=[{normal_text(0.0, 0.001, f'{{{shared}}}')}, 0]")
    (samples,) = Batch.draw(scenario, range(3)).varying.values()
    np.testing.assert_allclose(samples, 0.0082, rtol=0.01)


def test_correlated_groups_include_indirect_correlations(study):
    scenario = study(
        *correlated_overrides("{a: 0.9}", "{a: -0.5, b: 0.5}", "{b: 0.8}"), f"vehicle.quadratic_drag={UNIFORM_YAML}"
    )
    distributions = distributions_in(scenario)
    pairs = correlated_pairs(distributions)
    assert [(pair.first, pair.second) for pair in pairs] == [(MASS_FIELD, LAG_FIELD), (DRAG_FIELD, LAG_FIELD)]
    assert [pair.correlation for pair in pairs] == pytest.approx([-0.45, 0.4])
    # Drag and mass share no variable, but each shares one with the lag.
    assert correlated_groups(distributions) == dict.fromkeys(
        (MASS_FIELD, DRAG_FIELD, LAG_FIELD), (MASS_FIELD, DRAG_FIELD, LAG_FIELD)
    )
    assert shared_names(distributions.values()) == ["a", "b"]
    assert correlated_groups(distributions_in(study(correlated_overrides()[0]))) == {}
    assert correlated_pairs({}) == []


@pytest.mark.parametrize(
    ("shared", "words"),
    [
        ("{a: 0.8, b: 0.7}", "shared is {'a': 0.8, 'b': 0.7}, but must have correlations whose squares sum to at most"),
        ("{a: 1.1}", "shared.a is 1.1, but must be less than or equal to 1"),
        ("{a: heavy}", "shared.a is 'heavy', but must be a valid number"),
        ("{my drone: 0.1}", "must not have the name 'my drone'; the name of a shared variable must consist of at most"),
        ("[a]", "is ['a'], but must be a mapping from names to numbers"),
    ],
)
def test_invalid_shared_variables_are_refused(study, shared, words):
    with pytest.raises(InputError) as caught:
        study(correlated_overrides(shared)[0])
    assert words in str(caught.value)


def test_squared_correlations_may_sum_to_exactly_one(study):
    """The correlations in this example are allowed, although their squares sum to more than 1 by rounding errors."""
    study(correlated_overrides("{a: 0.2, b: 0.4, c: 0.4, d: 0.8}")[0])


def test_the_number_of_shared_variables_is_limited(study):
    def study_with_shared_variables(count):
        names = [f"x{i}: 0.1" for i in range(count)]
        parts = (names[:40], names[40:], names[:3])
        distributions = [normal_text(0.007, 0.001, f"{{{', '.join(part)}}}", ", min: 0.001") for part in parts]
        return study(f"vehicle.inertia=[{', '.join(distributions)}]")

    assert len(shared_names(distributions_in(study_with_shared_variables(MAX_SHARED)).values())) == MAX_SHARED
    with pytest.raises(InputError, match=r"vehicle\.inertia\.1\.normal\.shared is .* already has 64"):
        study_with_shared_variables(MAX_SHARED + 1)


def test_correlations_are_written_and_read_again(study, tmp_path):
    scenario = study(*correlated_overrides())
    save_scenario(scenario, tmp_path / "again.yaml")
    assert load_scenario(tmp_path / "again.yaml") == scenario


def test_an_uncorrelated_normal_is_saved_as_in_earlier_releases(study):
    """A study is identified by the text of its scenario, which must not change."""
    mass = json.loads(study(correlated_overrides("")[0]).model_dump_json())["vehicle"]["mass"]
    assert mass == {"normal": {"mean": 0.68, "standard_deviation": 0.02, "min": 0.5, "max": None}}


def test_an_extension_replaces_the_distribution_of_one_field_only(study, diagrams, tmp_path):
    """A number or distribution replaces a whole distribution, including its correlations with shared variables."""
    base = ", ".join(override.partition(".")[2].replace("=", ": ", 1) for override in correlated_overrides())
    path = tmp_path / "mine.yaml"
    faster = normal_text(0.05, 0.001, "", ", min: 0.03, max: 0.07")
    path.write_text(
        f"base: {{extends: {diagrams / 'figure_eight.yaml'}, vehicle: {{{base}}}}}\n"
        f"light: {{extends: base, vehicle: {{mass: 0.5, rotor_time_constant: {faster}}}}}\n"
    )
    light = distributions_in(load_scenario(f"{path}:light"))
    assert set(light) == {LAG_FIELD, DRAG_FIELD}
    assert light[LAG_FIELD].normal.shared == {}
    base_values, extended_values = (
        Batch.draw(load_scenario(f"{path}:{name}"), range(9)).varying for name in ("base", "light")
    )
    np.testing.assert_array_equal(extended_values[DRAG_FIELD], base_values[DRAG_FIELD])


def normals(distributions):
    return {name: Normal.model_validate(each) for name, each in distributions.items()}


@settings(max_examples=40)
@given(count=st.integers(1, 10), rank=st.integers(1, 12), seed=st.integers(0, 2**31))
def test_correlated_normals_reproduce_a_covariance(count, rank, seed):
    """For any rank and units, variances agree to rounding errors, and variances of weighted sums to 2 %."""
    rng = np.random.default_rng(seed)
    shape = rng.normal(size=(count, rank))
    scale = 10.0 ** rng.uniform(-8.0, 3.0, count)
    covariance = shape @ shape.T * np.outer(scale, scale)
    mean, names = rng.normal(size=count), [f"p{i}" for i in range(count)]
    joint = joint_normal(normals(correlated_normals(names, mean, covariance)))
    assert joint.paths == tuple(names)
    np.testing.assert_array_equal(joint.mean, mean)
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(np.diag(joint.covariance), deviation**2, rtol=1e-14)
    correlation, expected = (each / np.outer(deviation, deviation) for each in (joint.covariance, covariance))
    sums = rng.normal(size=(200, count))
    np.testing.assert_allclose(
        *(np.einsum("ij,jk,ik->i", sums, each, sums) for each in (correlation, expected)), rtol=0.02
    )
    size, vectors = np.linalg.eigh(expected)
    weak = np.einsum("ji,jk,ki->i", vectors, correlation, vectors)
    np.testing.assert_allclose(weak, size, rtol=0.02, atol=1e-9)


def test_correlated_normal_distributions_need_few_shared_variables():
    """A pair of fields, or several fields with a common cause, need one variable. Uncorrelated fields need none."""
    pair = correlated_normals("ab", np.zeros(2), np.array([[4.0, -1.0], [-1.0, 1.0]]))
    assert pair["a"] == {"normal": {"mean": 0.0, "standard_deviation": 2.0, "shared": {"common_1": 0.7071}}}
    assert pair["b"]["normal"]["shared"] == {"common_1": -0.7071}
    uniform = np.full((6, 6), 0.3) + 0.7 * np.eye(6)
    assert len(shared_names(normals(correlated_normals("abcdef", np.zeros(6), uniform)).values())) == 1
    blocks = scipy.linalg.block_diag([[1.0, 0.5], [0.5, 1.0]], [[1.0]], [[1.0, 0.9], [0.9, 1.0]])
    distributions = correlated_normals("abcde", np.zeros(5), blocks + 1e-4, prefix="mine")
    assert [[*each["normal"].get("shared", {})] for each in distributions.values()] == [
        ["mine_1"],
        ["mine_1"],
        [],
        ["mine_2"],
        ["mine_2"],
    ]


def test_a_sum_has_its_given_variance_even_if_its_terms_are_much_less_certain():
    """In this example, the coefficients of a fitted thrust curve are uncertain, but the hover thrust is well known."""
    throttle = np.linspace(0.5, 0.7, 200)
    powers = np.stack([throttle**0, throttle, throttle**2])
    covariance = 1e-6 * np.linalg.inv(powers @ powers.T)
    joint = joint_normal(normals(correlated_normals("abc", np.zeros(3), covariance)))
    hover = np.array([1.0, 0.6, 0.36])
    deviation = np.sqrt(hover @ covariance @ hover)
    assert deviation < 5e-3 * np.sqrt(covariance[1, 1])
    assert np.sqrt(hover @ joint.covariance @ hover) == pytest.approx(deviation, rel=0.011)


@pytest.mark.parametrize(
    ("names", "covariance", "words"),
    [
        ("ab", [[1.0, 2.0], [2.0, 1.0]], "is not positive semidefinite"),
        ("ab", [[1.0, 0.5], [0.4, 1.0]], "is not symmetric"),
        ("ab", [[1.0, np.nan], [np.nan, 1.0]], "is not symmetric"),
        ("ab", [[1.0, 0.0], [0.0, 0.0]], "'b' has mean 0 and variance 0"),
        ("ab", [[1.0]], "2 names need"),
    ],
)
def test_an_invalid_covariance_is_refused(names, covariance, words):
    with pytest.raises(InputError, match=words):
        correlated_normals(names, np.zeros(len(names)), np.array(covariance))


def test_only_normal_distributions_are_correlated(study):
    scenario = study(correlated_overrides()[0], f"{DRAG_FIELD}={UNIFORM_YAML}")
    assert np.array_equal(correlation_matrix([*distributions_in(scenario).values()]), np.eye(2))
    assert joint_normal(distributions_in(scenario)).paths == (MASS_FIELD,)
