"""Tests of studies with correlated random parameters: reproducibility and influences."""

import math

import numpy as np
import pytest
import scipy

from drake_quad import load_scenario, read_study, run_monte_carlo
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.paths import distributions_in
from drake_quad.statistics.estimates import partial_rank_correlation, rank_correlation
from drake_quad.studies.drake_monte_carlo import drake_monte_carlo
from drake_quad.studies.statistics import influences
from drake_quad.studies.study import Study
from drake_quad.visualization.study_plots import plot_influences

MASS, DRAG, STEP = "vehicle.mass", "vehicle.linear_drag", "vehicle.quadratic_drag"
CORRELATED_OVERRIDES = [
    "duration=0.2",
    f"{MASS}={{normal: {{mean: 0.68, standard_deviation: 0.02, min: 0.5, shared: {{a: 0.9}}}}}}",
    f"{DRAG}={{normal: {{mean: 0.2, standard_deviation: 0.05, min: 0.0, shared: {{a: 0.9}}}}}}",
    f"{STEP}={{uniform: {{min: 0.0, max: 0.1}}}}",
]


@pytest.fixture(scope="module")
def scenario(diagrams):
    return load_scenario(diagrams / "robustness.yaml", CORRELATED_OVERRIDES)


@pytest.fixture(scope="module")
def flown(scenario, tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    return folder, run_monte_carlo(scenario, 7, 3, folder=folder, num_workers=1, batch_size=7)


@pytest.mark.long
def test_results_do_not_depend_on_the_batch_size(scenario, flown):
    _, expected = flown
    single = run_monte_carlo(scenario, 7, 3, num_workers=1, batch_size=1)
    for path in (MASS, DRAG):
        np.testing.assert_array_equal(single.parameters[path], expected.parameters[path])
    np.testing.assert_allclose(single.metrics.rmse, expected.metrics.rmse, rtol=1e-9)


def test_a_study_with_correlations_can_be_read_and_resumed(scenario, flown):
    """A resumed study flies rows again if their drawn values do not follow from the seed."""
    folder, flown_study = flown
    np.testing.assert_allclose(read_study(folder).parameters[MASS], flown_study.parameters[MASS], rtol=1e-11)
    resumed_study = run_monte_carlo(scenario, 9, 3, folder=folder, num_workers=1, resume=True)
    assert (len(resumed_study.samples), resumed_study.invalid_lines) == (9, ())
    assert resumed_study.simulated_time == pytest.approx(2 * 0.2)
    drawn_drag = Batch.draw(scenario, range(9), seed=3).varying[DRAG]
    np.testing.assert_allclose(resumed_study.parameters[DRAG], drawn_drag, rtol=1e-11)


def test_drake_monte_carlo_flies_correlated_samples(diagrams):
    scenario = load_scenario(diagrams / "hover.yaml", [*CORRELATED_OVERRIDES, "duration=0.1"])
    assert np.isfinite(drake_monte_carlo(scenario, 2, 1).rmse).all()


def study_of(scenario, count, rmse):
    """Return an invented study whose error is a function of the drawn values."""
    batch = Batch.draw(scenario, range(count))
    values = rmse(*(batch.varying[path] for path in (MASS, DRAG, STEP)))
    metrics = Metrics(*[values] * (len(Metrics._fields) - 1), np.full(count, math.inf))
    parameters = {path: batch.varying[path] for path in distributions_in(scenario)}
    return Study(scenario, 0.2, np.arange(count), parameters, metrics)


def test_a_parameter_that_is_only_correlated_with_the_cause_has_no_partial_influence(scenario):
    """The error depends on the mass. Drag is correlated with the mass by 0.81, and therefore with the error."""
    result = {
        each.path: each for each in influences(study_of(scenario, 2000, lambda mass, drag, step: 50.0 * mass + step))
    }
    assert result[DRAG].correlation.low > 0.7
    assert abs(result[DRAG].partial.value) < 0.06
    assert result[MASS].partial.low > 0.9
    # The step is drawn independently of the other parameters, so its partial correlation equals its correlation.
    assert result[STEP].partial == result[STEP].correlation


def test_the_plot_shows_partial_correlations(scenario):
    figure = plot_influences(study_of(scenario, 400, lambda mass, drag, step: 50.0 * mass + step))
    (axes,) = figure.axes
    texts = [text.get_text() for text in axes.texts]
    assert sum("; partial " in text for text in texts) == 2


def test_the_partial_rank_correlation_agrees_with_the_recursion_formula():
    """The formula is (r_xy - r_xz r_yz) / √((1 - r_xz²)(1 - r_yz²)) with Spearman's correlations."""
    z, *noise = np.random.default_rng(4).normal(size=(3, 500))
    x, y = np.exp(z + noise[0]), (z + 0.5 * noise[1]) ** 3
    r = scipy.stats.spearmanr(np.stack([x, y, z]), axis=1).statistic
    expected = (r[0, 1] - r[0, 2] * r[1, 2]) / math.sqrt((1.0 - r[0, 2] ** 2) * (1.0 - r[1, 2] ** 2))
    result = partial_rank_correlation(x, y, z[None])
    assert result.value == pytest.approx(expected, rel=1e-12)
    # The interval is that of a rank correlation (Bonett and Wright) with 499 samples instead of 500, since one variable
    # is held constant.
    half_width = 1.959964 * math.sqrt((1.0 + 0.5 * expected**2) / (500 - 1 - 3))
    assert np.arctanh(result.high) - np.arctanh(expected) == pytest.approx(half_width, rel=1e-6)
    assert np.arctanh(expected) - np.arctanh(result.low) == pytest.approx(half_width, rel=1e-6)
    assert partial_rank_correlation(x, y, np.empty((0, 500))) == rank_correlation(x, y)


def test_a_variable_determined_by_others_has_no_partial_correlation():
    x = np.random.default_rng(5).normal(size=50)
    y = np.sin(np.arange(50.0))
    assert math.isnan(partial_rank_correlation(x, y, np.exp(x)[None]).value)
    assert math.isnan(partial_rank_correlation(x[:4], y[:4], y[None, :4]).value)
    assert math.isnan(partial_rank_correlation(x, np.ones(50), y[None]).value)


def test_the_interval_of_the_partial_correlation_has_its_nominal_coverage():
    """The partial correlation of two variables that depend only on a third one is 0."""
    rng = np.random.default_rng(6)
    hits = 0
    for _ in range(400):
        z, a, b = rng.normal(size=(3, 40))
        _, low, high = partial_rank_correlation(a, b, z[None])
        hits += low <= 0.0 <= high
    assert 0.92 < hits / 400 < 0.98
