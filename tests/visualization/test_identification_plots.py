"""Tests of plots of an identification: forecasts, residuals, thrust curve, correlations and prediction errors."""

from dataclasses import replace

import numpy as np
import pytest
from figure_content import legends
from scipy import signal

from drake_quad import load_scenario
from drake_quad.identification.result import ForecastOutput, Identification
from drake_quad.identification.results.estimates import Estimates, Source
from drake_quad.identification.results.vehicle_values import with_vehicle_values
from drake_quad.identification.validation.comparison import LogComparison
from drake_quad.identification.validation.prediction import Predictions
from drake_quad.visualization import identification_plots as plots
from drake_quad.visualization.log_comparison_plots import plot_log_comparison

RNG = np.random.default_rng(5)
PARAMETER_NAMES = ("motors.curve[0]", "motors.curve[1]", "motors.curve[2]", "inertia[0]")


@pytest.fixture(scope="module")
def identification(root):
    scenario = load_scenario(root / "diagrams" / "neural_fly.yaml:still")
    deviations = np.array([0.05, 0.2, 0.2, 0.002])
    estimates = Estimates(
        PARAMETER_NAMES, np.array([-1.5, 17.0, 1.0, 0.03]), np.diag(deviations**2), 20.0, Source("m", "a")
    )
    time = np.arange(12)[:, None] * 1.0 + np.linspace(0.0, 1.0, 26)
    measured = np.sin(time)
    predicted = measured + RNG.normal(scale=0.1, size=time.shape)
    outputs = tuple(
        ForecastOutput(name, unit, time, measured, predicted, 0.92, 0.1)
        for name, unit in (("position x", "m"), ("pitch", "rad"))
    )
    return Identification(
        estimates,
        with_vehicle_values(scenario, dict(zip(estimates.names, map(float, estimates.values), strict=True))),
        outputs,
    )


def test_the_fit_has_a_row_for_each_output_and_shades_every_other_window(identification):
    figure = plots.plot_fit(identification)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["measured", "forecast"]
    left, right = figure.axes[:2]
    assert len(figure.axes) == 4
    assert left.get_ylabel() == "position x\n(cm)"
    assert figure.axes[2].get_ylabel() == "pitch\n(°)"
    spans = [patch for patch in left.patches if patch.get_width() == pytest.approx(1.0)]
    assert [patch.get_x() for patch in spans] == [1.0, 3.0, 5.0, 7.0, 9.0]
    first = left.lines[0]
    assert first.get_xdata()[0] == 0.0
    np.testing.assert_allclose(first.get_ydata(), 100.0 * np.sin(first.get_xdata()))
    assert "explained variance 92.0 %" in right.get_title(loc="right")


def test_white_residuals_have_no_autocorrelation_and_a_flat_spectrum(identification):
    figure = plots.plot_residuals(identification)
    left, right = figure.axes[:2]
    correlation = left.lines[0].get_ydata()
    assert correlation[0] == pytest.approx(1.0)
    assert np.abs(correlation[1:]).max() < 0.25
    density = right.lines[0].get_ydata()
    assert density.max() / density.min() < 30.0
    # The one-sided spectral density of white noise, divided by its variance, is twice the sampling period.
    assert density.mean() == pytest.approx(2.0 * 0.04, rel=0.2)
    assert legends(figure) == [output.name for output in identification.outputs]
    labels = [(axes.get_xlabel(), axes.get_ylabel()) for axes in (left, right)]
    assert labels == [("lag (s)", "autocorrelation (1)"), ("frequency (Hz)", "spectral density over variance (s)")]


def test_the_thrust_has_a_confidence_band_from_its_covariance(identification):
    figure = plots.plot_thrust(identification, np.linspace(0.3, 0.6, 100))
    (axes,) = figure.axes
    line = next(line for line in axes.lines if line.get_label() == "identified")
    u = line.get_xdata()
    np.testing.assert_allclose(line.get_ydata(), -1.5 + 17.0 * u + u**2)
    band = axes.collections[0].get_paths()[0].vertices
    top = band[np.isclose(band[:, 0], 1.0)][:, 1].max()
    bottom = band[np.isclose(band[:, 0], 1.0)][:, 1].min()
    half_width = 2.086 * np.sqrt(0.05**2 + 0.2**2 + 0.2**2)
    assert (bottom, top) == pytest.approx((16.5 - half_width, 16.5 + half_width), abs=0.01)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["95 %", "identified", "hover", "flown"]
    without = Identification(
        identification.estimates.subset(["inertia[0]"]), identification.vehicle, identification.outputs
    )
    assert plots.plot_thrust(without) is None


def test_nonzero_correlations_are_written(identification):
    covariance = identification.estimates.covariance.copy()
    covariance[0, 1] = covariance[1, 0] = -0.8 * 0.05 * 0.2
    estimates = Estimates(PARAMETER_NAMES, identification.estimates.values, covariance, 20.0, Source("m", "a"))
    axes = plots.plot_correlations(estimates).axes[0]
    assert {text.get_text() for text in axes.texts} == {"-0.8"}
    assert [label.get_text() for label in axes.get_xticklabels()] == [
        "thrust curve k_0",
        "thrust curve k_1",
        "thrust curve k_2",
        "I_xx",
    ]


def test_the_figure_of_correlations_has_room_for_every_estimate(identification):
    """Each estimate adds a row and a column of constant size, with room for the values in the cells."""
    names = [
        f"{name}[{i}]" for name in ("inertia", "body_drag.linear", "motors.curve", "centre_of_mass") for i in range(3)
    ]
    names = ["mass", *names[:-1]]
    sizes = []
    for count in (4, 8, 12):
        estimates = Estimates(tuple(names[:count]), np.ones(count), np.eye(count), 20.0, Source("m", "a"))
        sizes.append(plots.plot_correlations(estimates).get_size_inches())
    first, second, third = sizes
    np.testing.assert_allclose(second - first, third - second)
    assert (second - first > 4 * 0.3).all()


def test_predictions_are_drawn_in_display_units():
    errors = RNG.uniform(0.01, 0.02, size=(2, 2, 20))
    errors[:, 1, 5:] = np.nan
    predictions = Predictions(("one", "other"), (0.1, 0.5), np.array(["a"] * 20), np.arange(20.0), {"position": errors})
    figure = plots.plot_predictions(predictions)
    (axes,) = figure.axes
    assert axes.get_ylabel() == "RMS error of position (cm)"
    drawn_errors = [container.lines[0].get_ydata() for container in axes.containers]
    expected = 100.0 * np.sqrt(np.nanmean(errors**2, axis=2))
    np.testing.assert_allclose(drawn_errors, expected)


def test_the_first_ten_windows_are_drawn(identification):
    output = identification.outputs[0]
    fitted = Identification(identification.estimates, identification.vehicle, (output,))
    left, right = plots.plot_fit(fitted).axes
    measured, predicted = left.lines[0::2], left.lines[1::2]
    for i in range(10):
        np.testing.assert_allclose(measured[i].get_xydata().T, [output.time[i], 100.0 * output.measured[i]])
        np.testing.assert_allclose(predicted[i].get_xydata().T, [output.time[i], 100.0 * output.predicted[i]])
        np.testing.assert_allclose(right.lines[i].get_ydata(), 100.0 * output.residual[i])
    assert len(measured) == len(predicted) == 10
    assert [line.get_label() for line in left.lines[:2]] == ["measured", "forecast"]
    assert left.get_xlabel() == "time in held-out windows (s)"


@pytest.mark.parametrize(("fraction", "words"), [(0.5, "explained variance 50.0 %"), (-3.0, "no variance explained")])
def test_the_explained_variance_is_in_the_title(identification, fraction, words):
    output = identification.outputs[0]._replace(explained_variance=fraction)
    _, right = plots.plot_fit(Identification(identification.estimates, identification.vehicle, (output,))).axes
    assert right.get_title(loc="right") == words


def test_autocorrelation_and_spectrum_of_residuals_agree_with_numpy_and_scipy(identification):
    output = identification.outputs[0]
    coloured = np.cumsum(output.residual, axis=1)
    figure = plots.plot_residuals(
        Identification(
            identification.estimates, identification.vehicle, (output._replace(predicted=output.measured - coloured),)
        )
    )
    left, right = figure.axes
    lags, correlation = left.lines[0].get_xydata().T
    assert len(lags) == 14
    np.testing.assert_allclose(lags, output.time[0, :14] - output.time[0, 0])
    centred = coloured - coloured.mean()
    for lag, value in enumerate(correlation):
        sums = np.mean([np.correlate(row[lag:], row[: len(row) - lag])[0] / (len(row) - lag) for row in centred])
        assert value == pytest.approx(sums / np.mean(centred**2))
    frequency, density = right.lines[0].get_xydata().T
    expected = signal.periodogram(
        coloured, 1.0 / 0.04, window=np.hanning(26), detrend=False, scaling="density", return_onesided=True
    )
    np.testing.assert_allclose(frequency, expected[0][1:])
    # A one-sided spectrum doubles the density at every frequency except the last one.
    np.testing.assert_allclose(density[:-1], expected[1].mean(axis=0)[1:-1] / np.mean(coloured**2))
    span = left.patches[0].get_y(), left.patches[0].get_y() + left.patches[0].get_height()
    assert span == pytest.approx((-1.96 / np.sqrt(coloured.size), 1.96 / np.sqrt(coloured.size)))


def test_a_fit_without_any_error_has_no_spectrum(identification):
    output = identification.outputs[0]
    exact = output._replace(predicted=output.measured)
    left, right = plots.plot_residuals(Identification(identification.estimates, identification.vehicle, (exact,))).axes
    np.testing.assert_array_equal(left.lines[0].get_ydata(), 0.0)
    np.testing.assert_array_equal(right.lines[0].get_ydata(), 0.0)


def test_residuals_of_short_windows_are_visible(identification):
    """Windows of three samples have autocorrelations at two lags, and a spectrum at one frequency."""
    output = identification.outputs[0]
    short = output._replace(**{name: getattr(output, name)[:, :3] for name in ("time", "measured", "predicted")})
    figure = plots.plot_residuals(Identification(identification.estimates, identification.vehicle, (short,)))
    assert [len(axes.lines[0].get_xdata()) for axes in figure.axes] == [2, 1]
    assert [axes.lines[0].get_marker() for axes in figure.axes] == [".", "."]


def test_the_curves_of_many_outputs_differ_in_colour_or_style(identification):
    outputs = tuple(identification.outputs[0]._replace(name=str(i)) for i in range(14))
    left, _ = plots.plot_residuals(Identification(identification.estimates, identification.vehicle, outputs)).axes
    styles = [(line.get_color(), line.get_linestyle()) for line in left.lines]
    assert len(set(styles)) == 14


def test_the_plot_of_thrust_shows_hover_and_the_flown_range(identification):
    commands = np.concatenate([np.linspace(0.3, 0.6, 100), [0.99]])
    (axes,) = plots.plot_thrust(identification, commands).axes
    vehicle = identification.vehicle.vehicle
    (hover,) = [line for line in axes.lines if line.get_label() == "hover"]
    assert hover.get_ydata()[0] == pytest.approx(0.25 * float(vehicle.mass) * float(vehicle.gravity))
    (flown,) = axes.patches
    ends = np.quantile(commands, [0.01, 0.99])
    assert (flown.get_x(), flown.get_width()) == pytest.approx((ends[0], ends[1] - ends[0]))
    assert axes.get_xlim() == (0.0, 1.0)
    assert axes.get_ylim()[0] == 0.0
    assert not plots.plot_thrust(identification).axes[0].patches


def test_each_correlation_is_shaded_in_its_cell(identification):
    covariance = identification.estimates.covariance.copy()
    covariance[0, 3] = covariance[3, 0] = 0.5 * 0.05 * 0.002
    covariance[1, 2] = covariance[2, 1] = 0.04 * 0.2 * 0.2
    estimates = Estimates(PARAMETER_NAMES, identification.estimates.values, covariance, 20.0, Source("m", "a"))
    axes = plots.plot_correlations(estimates).axes[0]
    np.testing.assert_allclose(axes.images[0].get_array(), estimates.correlation)
    assert axes.images[0].get_clim() == (-1.0, 1.0)
    # Correlations below 0.05 are not written.
    assert {(text.get_position(), text.get_text()) for text in axes.texts} == {((3, 0), "0.5"), ((0, 3), "0.5")}
    assert {text.get_color() for text in axes.texts} == {"black"}
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        label.get_text() for label in axes.get_xticklabels()
    ]


def test_prediction_errors_have_intervals_and_are_side_by_side():
    errors = RNG.uniform(0.01, 0.02, size=(2, 2, 20))
    predictions = Predictions(
        ("one", "other"), (0.1, 0.5), np.array(["a"] * 20), np.arange(20.0), {"attitude": errors, "velocity": errors}
    )
    figure = plots.plot_predictions(predictions, ("attitude", "velocity"))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["one", "other"]
    first, second = figure.axes
    assert [label.get_text() for label in first.get_xticklabels()] == ["0.1", "0.5"]
    assert (first.get_xscale(), first.get_yscale()) == ("log", "log")
    for axes, quantity, factor in ((first, "attitude", np.degrees(1.0)), (second, "velocity", 1.0)):
        for i, (vehicle, container) in enumerate(zip(("one", "other"), axes.containers, strict=True)):
            result = [predictions.rmse(quantity, vehicle, horizon) for horizon in (0.1, 0.5)]
            x, y = container.lines[0].get_xydata().T
            np.testing.assert_allclose(x, np.array([0.1, 0.5]) * (1.0 + 0.03 * (i - 0.5)))
            np.testing.assert_allclose(y, [factor * each.value for each in result])
            for each, segment in zip(result, container.lines[2][0].get_segments(), strict=True):
                np.testing.assert_allclose(segment[:, 1], [factor * each.low, factor * each.high])
    assert first.get_ylabel() == "RMS error of attitude (°)"
    assert second.get_ylabel() == "RMS error of velocity (m/s)"
    # If position and attitude are missing, the first two remaining quantities are drawn.
    (only,) = plots.plot_predictions(replace(predictions, errors={"velocity": errors})).axes
    assert only.get_ylabel() == "RMS error of velocity (m/s)"


@pytest.fixture(scope="module")
def compared():
    """Return a comparison of a log of one second, with a gap, and twenty predictions; one crashes half-way."""
    time = np.concatenate([np.arange(40) * 0.01, 0.9 + np.arange(40) * 0.01])
    target = np.stack([time, 2.0 * time, 1.0 + 0.0 * time], axis=1)
    flown = 0.02 * np.stack([np.sin(9.0 * time), np.cos(9.0 * time), time], axis=1)
    predicted = flown + 0.01 * RNG.normal(size=(20, 80, 3))
    predicted[4, 40:] = np.nan
    return LogComparison(None, None, None, None, time, target, flown, predicted)


def test_a_log_is_drawn_over_the_band_of_its_predictions(compared):
    figure = plot_log_comparison(compared)
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == ["reference", "95 % of the predictions", "predicted", "flown"]
    grid = np.array(figure.axes).reshape(3, 2)
    assert [axes.get_xlabel() for axes in grid[:, 0]] == ["", "", "time of the log (s)"]
    for i, (position_axes, error_axes) in enumerate(grid):
        reference, predicted, flown = (line.get_xydata().T for line in position_axes.lines)
        # Lines are broken where the log has a gap.
        assert np.flatnonzero(np.isnan(flown[0])).tolist() == [40]
        is_logged = np.arange(81) != 40
        np.testing.assert_array_equal(reference[:, is_logged], [compared.time, compared.target[:, i]])
        np.testing.assert_allclose(flown[1][is_logged], compared.target[:, i] - compared.logged_error[:, i])
        median = np.nanmedian(compared.predicted[:, :, i], axis=0)
        np.testing.assert_allclose(predicted[1][is_logged], compared.target[:, i] - median)
        np.testing.assert_allclose(error_axes.lines[0].get_ydata()[is_logged], 100.0 * median)
        np.testing.assert_allclose(error_axes.lines[1].get_ydata()[is_logged], 100.0 * compared.logged_error[:, i])
        low, high = np.nanquantile(compared.predicted[:, :, i], (0.025, 0.975), axis=0)
        edges = np.vstack([path.vertices for path in error_axes.collections[0].get_paths()])
        for tick in (0, 17, 60):
            heights = np.unique(edges[np.isclose(edges[:, 0], compared.time[tick]), 1])
            np.testing.assert_allclose(heights[[0, -1]], [100.0 * low[tick], 100.0 * high[tick]])
        edges = np.vstack([path.vertices for path in position_axes.collections[0].get_paths()])
        heights = np.unique(edges[np.isclose(edges[:, 0], compared.time[17]), 1])
        np.testing.assert_allclose(heights[[0, -1]], compared.target[17, i] - [high[17], low[17]])
        assert (position_axes.get_ylabel(), error_axes.get_ylabel()) == (f"{'xyz'[i]} (m)", f"error on {'XYZ'[i]} (cm)")
    crashed = replace(compared, predicted=np.full((2, 80, 3), np.nan))
    assert np.isnan(plot_log_comparison(crashed).axes[1].lines[0].get_ydata()).all()
