"""Pictures of an identification show what it holds."""

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.identification.flown_again.prediction import Predictions
from drake_quad.identification.identified import Fitted, Identification
from drake_quad.identification.results.estimates import Estimates, Source
from drake_quad.identification.results.vehicle_numbers import with_estimates
from drake_quad.visualization import identification_plots as plots

RNG = np.random.default_rng(5)
NAMES = ("motors.curve[0]", "motors.curve[1]", "motors.curve[2]", "inertia[0]")


@pytest.fixture(scope="module")
def identification(root):
    scenario = load_scenario(root / "diagrams" / "neural_fly.yaml:still")
    deviations = np.array([0.05, 0.2, 0.2, 0.002])
    estimates = Estimates(NAMES, np.array([-1.5, 17.0, 1.0, 0.03]), np.diag(deviations**2), 20.0, Source("m", "a"))
    time = np.arange(12)[:, None] * 1.0 + np.linspace(0.0, 1.0, 26)
    measured = np.sin(time)
    predicted = measured + RNG.normal(scale=0.1, size=time.shape)
    held_out = np.arange(12) >= 8
    log = np.array(["a"] * 12)
    outputs = tuple(
        Fitted(name, unit, log, time, measured, predicted, held_out, 0.92, 0.93, 0.1)
        for name, unit in (("position x", "m"), ("pitch", "rad"))
    )
    return Identification(estimates, with_estimates(scenario, estimates), outputs)


def test_the_fit_has_a_row_for_each_output_and_shades_what_was_held_out(identification):
    figure = plots.plot_fit(identification)
    left, right = figure.axes[:2]
    assert len(figure.axes) == 4
    assert left.get_ylabel() == "position x\n(cm)"
    assert figure.axes[2].get_ylabel() == "pitch\n(°)"
    spans = [patch for patch in left.patches if patch.get_width() == pytest.approx(1.0)]
    assert [patch.get_x() for patch in spans] == [8.0, 9.0, 10.0, 11.0]
    first = left.lines[0]
    assert first.get_xdata()[0] == 3.0
    np.testing.assert_allclose(first.get_ydata(), 100.0 * np.sin(first.get_xdata()))
    assert "explained 92.0 %" in right.get_title(loc="right")


def test_white_residuals_have_no_autocorrelation_and_a_flat_spectrum(identification):
    figure = plots.plot_residuals(identification)
    left, right = figure.axes[:2]
    correlation = left.lines[0].get_ydata()
    assert correlation[0] == pytest.approx(1.0)
    assert np.abs(correlation[1:]).max() < 0.25
    density = right.lines[0].get_ydata()
    assert density.max() / density.min() < 30.0
    # One-sided, of white noise: twice the sampling period.
    assert density.mean() == pytest.approx(2.0 * 0.04, rel=0.2)


def test_the_thrust_has_a_band_of_its_covariance(identification):
    figure = plots.plot_thrust(identification, np.linspace(0.3, 0.6, 100))
    (axes,) = figure.axes
    line = next(line for line in axes.lines if line.get_label() == "identified")
    u = line.get_xdata()
    np.testing.assert_allclose(line.get_ydata(), -1.5 + 17.0 * u + u**2)
    band = axes.collections[0].get_paths()[0].vertices
    top = band[np.isclose(band[:, 0], 1.0)][:, 1].max()
    assert top == pytest.approx(16.5 + 2.086 * np.sqrt(0.05**2 + 0.2**2 + 0.2**2), abs=0.01)
    without = Identification(
        identification.estimates.part(["inertia[0]"]), identification.vehicle, identification.outputs
    )
    assert plots.plot_thrust(without) is None


def test_correlations_are_written_where_there_are_some(identification):
    covariance = identification.estimates.covariance.copy()
    covariance[0, 1] = covariance[1, 0] = -0.8 * 0.05 * 0.2
    estimates = Estimates(NAMES, identification.estimates.values, covariance, 20.0, Source("m", "a"))
    axes = plots.plot_correlations(estimates).axes[0]
    assert {text.get_text() for text in axes.texts} == {"-0.8"}
    assert [label.get_text() for label in axes.get_xticklabels()] == [
        "motors.curve[0]",
        "motors.curve[1]",
        "motors.curve[2]",
        "inertia[0]",
    ]


def test_predictions_are_drawn_in_units_for_the_eye():
    errors = RNG.uniform(0.01, 0.02, size=(2, 2, 20))
    errors[:, 1, 5:] = np.nan
    given = Predictions(("one", "other"), (0.1, 0.5), np.array(["a"] * 20), np.arange(20.0), {"position": errors})
    figure = plots.plot_predictions(given)
    (axes,) = figure.axes
    assert axes.get_ylabel() == "RMS error of position (cm)"
    drawn = [container.lines[0].get_ydata() for container in axes.containers]
    expected = 100.0 * np.sqrt(np.nanmean(errors**2, axis=2))
    np.testing.assert_allclose(drawn, expected)
