"""Tests that plots of studies show the statistics of their samples."""

import math

import numpy as np
import pytest
from figure_content import curve, legends

from drake_quad import InputError, load_scenario
from drake_quad.laboratory.metrics import Metrics
from drake_quad.statistics.estimates import mean_interval, proportion_interval, quantile_interval, running_mean
from drake_quad.studies import statistics
from drake_quad.studies.study import Study
from drake_quad.visualization import study_plots as plots
from drake_quad.visualization.comparison_plots import plot_comparison
from drake_quad.visualization.overview import plot_study
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import save_figures

NUM_SAMPLES = 200  # samples of a study
MASS_PATH = "vehicle.mass"
DELAY_PATH = "laboratory.motion_capture.latency_frames"


def study(seed=0, crashes=30, count=NUM_SAMPLES):
    """Return a study whose heaviest samples crash, and whose errors grow with the mass."""
    rng = np.random.default_rng(seed)
    mass, delay = rng.uniform(0.5, 0.9, count), rng.integers(0, 2, count).astype(float)
    errors = 0.05 + 0.1 * (mass - 0.5) + 0.01 * rng.uniform(size=count)
    crash_time = np.where(np.argsort(np.argsort(-mass)) < crashes, 3.0, math.inf)
    numbers = {name: (1.0 + i) * errors for i, name in enumerate(Metrics._fields)} | {"crash_time": crash_time}
    scenario = load_scenario("robustness")
    return Study(scenario, 10.0, np.arange(count), {MASS_PATH: mass, DELAY_PATH: delay}, Metrics(**numbers))


def no_crash(seed=0, count=NUM_SAMPLES):
    return study(seed, 0, count)


def test_a_distribution_plot_shows_the_fraction_of_samples_up_to_each_value():
    """Crashed samples count as worse than all others. The bands follow from Massart's inequality."""
    study_with_crashes, study_without_crashes = study(), no_crash(1)
    figure = plots.plot_distribution({"one": study_with_crashes, "other": study_without_crashes})
    assert legends(figure) == ["one (15.0 % crashed)", "other"]
    (axes,) = figure.axes
    for label, each, crashed in (("one (15.0 % crashed)", study_with_crashes, 30), ("other", study_without_crashes, 0)):
        values, fractions = curve(axes, label)
        expected = np.sort(each.metrics.rmse[~each.metrics.crashed])
        assert len(values) == NUM_SAMPLES - crashed
        np.testing.assert_array_equal(values, expected)
        np.testing.assert_allclose(
            fractions, [(each.metrics.rmse[~each.metrics.crashed] <= v).sum() / NUM_SAMPLES for v in values]
        )
    half_width = math.sqrt(math.log(2.0 / 0.05) / (2.0 * NUM_SAMPLES))
    for collection, each in zip(axes.collections, (study_with_crashes, study_without_crashes), strict=True):
        edges = np.unique(collection.get_paths()[0].vertices[:, 1])
        assert edges.min() == 0.0
        assert edges.max() == pytest.approx(min((~each.metrics.crashed).mean() + half_width, 1.0))
    assert axes.get_title(loc="left") == "200 samples each; bands: 95 % confidence"
    assert axes.get_xlabel() == "RMSE (cm)"
    assert axes.get_ylim()[0] == 0.0
    assert axes.yaxis.get_major_formatter()(0.25) == "25 %"


def test_titles_state_the_number_of_samples():
    (axes,) = plots.plot_distribution({"one": study()}).axes
    assert axes.get_title(loc="left").startswith("200 samples;")
    (axes,) = plots.plot_distribution({"one": study(), "other": study(count=50)}).axes
    assert axes.get_title(loc="left").startswith("50 samples and 200 samples;")


def test_estimates_converge_with_the_number_of_samples():
    """The left panel shows the mean over samples without a crash, from the tenth on; the right panel shows crashes."""
    result = study()
    figure = plots.plot_convergence({"one": result})
    assert legends(figure) == ["one"]
    left, right = figure.axes
    values = result.metrics.rmse[~result.metrics.crashed]
    count, mean = curve(left, "one")
    np.testing.assert_array_equal(count, np.arange(10, len(values) + 1))
    np.testing.assert_allclose(mean, [values[:n].mean() for n in range(10, len(values) + 1)])
    low, high = np.array(running_mean(values))[1:, 9:]
    corners = left.collections[0].get_paths()[0].vertices
    assert corners[:, 1].min() == pytest.approx(low.min())
    assert corners[:, 1].max() == pytest.approx(high.max())
    sample_counts, fractions = curve(right, "one")
    assert (sample_counts[0], sample_counts[-1]) == (20.0, NUM_SAMPLES)
    assert (np.diff(sample_counts) > 0.0).all()
    np.testing.assert_allclose(fractions, [result.metrics.crashed[: int(n)].mean() for n in sample_counts])
    assert right.get_title(loc="left") == "crashes"
    assert right.yaxis.get_major_formatter()(0.1).endswith(" %")
    for axes in (left, right):
        assert axes.get_xscale() == "log"
        assert axes.xaxis.get_major_formatter()(2000.0) == "2,000"


def test_the_convergence_of_a_quantile_is_shown_for_a_study_without_a_crash():
    result = no_crash()
    left, right = plots.plot_convergence({"one": result}, "peak_error").axes
    sample_counts, values = curve(right, "one")
    expected = [quantile_interval(result.metrics.peak_error[: int(n)], 0.95) for n in sample_counts]
    np.testing.assert_allclose(values, [each.value for each in expected])
    # With few samples, the quantile has no confidence interval.
    has_interval = np.isfinite([each.high for each in expected])
    corners = right.collections[0].get_paths()[-1].vertices
    assert corners[:, 1].max() == pytest.approx(max(each.high for each in expected if np.isfinite(each.high)))
    assert has_interval.any()
    assert right.get_title(loc="left") == "95 % quantile"
    assert left.get_ylabel() == right.get_ylabel() == "peak error (cm)"


def test_a_study_of_crashes_only_is_drawn_without_a_mean():
    left, right = plots.plot_convergence({"one": study(crashes=NUM_SAMPLES)}).axes
    assert left.get_xscale() == "linear"
    assert right.get_xscale() == "log"


def requirement_study(robustness, crash_time):
    """Return a study with a requirement, whose robustness is better if larger."""
    condition = {"always": {"signal": "position_error", "below": 1.0}}
    scenario = load_scenario("robustness", {"requirements": {"near": condition}})
    metrics = scenario.metrics_type
    numbers = dict.fromkeys(metrics._fields, robustness) | {"crash_time": crash_time}
    return Study(scenario, 10.0, np.arange(len(robustness)), {}, metrics(**numbers))


def test_crashes_count_as_the_smallest_values_if_larger_values_of_a_metric_are_better():
    robustness = np.array([4.0, 2.0, 3.0, 1.0])
    (axes,) = plots.plot_distribution(
        {"one": requirement_study(robustness, np.array([math.inf, math.inf, math.inf, 3.0]))}, "near"
    ).axes
    values, fractions = curve(axes, "one (25.0 % crashed)")
    np.testing.assert_array_equal(values, [2.0, 3.0, 4.0])
    np.testing.assert_allclose(fractions, [0.5, 0.75, 1.0])


@pytest.mark.parametrize("values", [[math.inf] * 30, [math.nan] * 30, [math.inf, 1.0] * 15])
def test_metrics_without_a_finite_mean_are_drawn(values, tmp_path):
    result = requirement_study(np.array(values), np.full(len(values), math.inf))
    figure = plots.plot_convergence({"one": result}, "near")
    assert "no finite value" in [text.get_text() for text in figure.axes[0].texts]
    assert len(save_figures({"a": figure, "b": plots.plot_distribution({"one": result}, "near")}, tmp_path)) == 2


@pytest.mark.parametrize("name", ["rmse", "crashed"])
def test_a_tornado_shows_the_means_over_the_lowest_and_the_highest_tenth(name):
    result = study()
    figure = plots.plot_influences(result, name)
    assert legends(figure) == ["lowest tenth of the parameter", "highest tenth"]
    (axes,) = figure.axes
    colors = [patch.get_facecolor() for patch in axes.get_legend().get_patches()]
    assert [bar.get_facecolor() for bar in axes.patches[:2]] == colors
    assert axes.texts[-1].get_text().startswith("rank correlation")
    expected = statistics.influences(result, name)
    assert [each.path for each in expected] == [MASS_PATH, DELAY_PATH]
    values = result.metrics.crashed if name == "crashed" else result.metrics.rmse[~result.metrics.crashed]
    mean = np.mean(values)
    for index, each in enumerate(expected):
        for bar, end, offset in zip(axes.patches[2 * index : 2 * index + 2], (each.low, each.high), (-0.18, 0.18)):
            ends = sorted([bar.get_x(), bar.get_x() + bar.get_width()])
            np.testing.assert_allclose(ends, sorted([mean, end.value]))
            assert bar.get_y() + 0.5 * bar.get_height() == pytest.approx(index + offset)
        for line, end, offset in zip(axes.lines[2 * index : 2 * index + 2], (each.low, each.high), (-0.18, 0.18)):
            np.testing.assert_allclose(line.get_xydata(), [[end.low, index + offset], [end.high, index + offset]])
        assert axes.texts[index].get_text().startswith(each.correlation.text(signed=True))
        assert axes.texts[index].xy == (1.01, index)
    assert axes.lines[-1].get_xdata()[0] == pytest.approx(mean)
    # The parameter with the largest influence is at the top.
    low, high = axes.get_ylim()
    assert (low, high) == (1.5, -0.5)
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels == ["vehicle mass (kg)", "latency frames"]
    percent = name == "crashed"
    assert ("%" in axes.xaxis.get_major_formatter()(0.1)) == percent


def test_a_tornado_shows_at_most_sixteen_fields():
    result = study()
    rng = np.random.default_rng(2)
    parameters = {
        path: rng.uniform(size=NUM_SAMPLES)
        for path in (
            *(f"vehicle.inertia.{i}" for i in range(3)),
            *(f"control.position.k_p.{i}" for i in range(3)),
            *(f"control.position.k_d.{i}" for i in range(3)),
            *(f"control.attitude.k_p.{i}" for i in range(3)),
            *(f"control.attitude.k_d.{i}" for i in range(3)),
            "vehicle.rotor_inertia",
            "vehicle.mass",
        )
    }
    large = Study(result.scenario, 10.0, result.samples, parameters, result.metrics)
    (axes,) = plots.plot_influences(large).axes
    assert len(parameters) > 16
    assert len(axes.patches) == 32
    assert len(axes.get_yticks()) == 16


def test_the_probability_of_a_crash_is_shown_in_bins(monkeypatch):
    """Each point is at the median of its bin. Vertical bars show its interval, and horizontal bars show its bin."""
    result = study()
    (axes,) = plots.plot_crash_probability(result, MASS_PATH, num_bins=8).axes
    levels = statistics.crash_bins(result, MASS_PATH, num_bins=8)
    points = next(line for line in axes.lines if line.get_marker() == "o")
    np.testing.assert_allclose(points.get_xydata(), [[each.middle, each.probability.value] for each in levels])
    vertical_bars, horizontal_bars = axes.containers
    for level, vertical_segment, horizontal_segment in zip(
        levels, vertical_bars.lines[2][0].get_segments(), horizontal_bars.lines[2][0].get_segments(), strict=True
    ):
        np.testing.assert_allclose(
            vertical_segment, [[level.middle, level.probability.low], [level.middle, level.probability.high]]
        )
        np.testing.assert_allclose(
            horizontal_segment, [[level.low, level.probability.value], [level.high, level.probability.value]]
        )
    assert points.get_label() == f"robustness: {statistics.crash_probability(result.metrics).percent()} of 200 samples"
    assert [line for line in axes.lines if len(line.get_xdata()) == 2][-1].get_ydata()[0] == 0.15
    assert axes.get_xlabel() == "vehicle mass (kg)"
    # The default is the parameter with the largest influence on crashes.
    assert plots.plot_crash_probability(result).axes[0].get_xlabel() == "vehicle mass (kg)"
    study_without_parameters = Study(result.scenario, 10.0, result.samples, {}, result.metrics)
    with pytest.raises(InputError, match="no random parameter"):
        plots.plot_crash_probability(study_without_parameters)


def test_controllers_with_equal_values_are_drawn_side_by_side():
    """The markers are drawn three typographic points apart, around the true value. Integers have integer ticks."""
    studies = {name: study(seed) for seed, name in enumerate(("a", "b", "c"))}
    figure = plots.plot_crash_probability(studies, DELAY_PATH)
    (axes,) = figure.axes
    points = [line for line in axes.lines if line.get_marker() == "o"]
    assert len(points) == 3
    assert legends(figure) == [line.get_label() for line in points]
    data = axes.transData.transform([[0.0, 0.0]])[0]
    shifts = [(line.get_transform().transform([[0.0, 0.0]])[0] - data) * 72.0 / figure.dpi for line in points]
    np.testing.assert_allclose(shifts, [[-3.0, 0.0], [0.0, 0.0], [3.0, 0.0]], atol=1e-9)
    assert axes.xaxis.get_major_locator()._integer
    single_axes = plots.plot_crash_probability(studies["a"], MASS_PATH).axes[0]
    assert not getattr(single_axes.xaxis.get_major_locator(), "_integer", False)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("rmse", "RMSE (cm)"),
        ("rmse_z", "RMSE on Z (cm)"),
        ("effort_x", "control effort on X (m²/s⁴)"),
        ("variation_y", "total variation of the command on Y (m/s³)"),
        ("peak_error", "peak error (cm)"),
        ("crashed", "crashed samples"),
    ],
)
def test_labels_of_metrics_have_units(name, label):
    with new_panels(3.0, 3.0) as (_, axes):
        plots.label_metric(axes.xaxis, [study()], name)
        assert axes.get_xlabel() == label
        # Values are drawn in SI units, and tick labels are in the units of the tables.
        expected = {"RMSE": "25", "peak": "25", "ticks": "25 %"}.get(label.split()[0])
        assert expected is None or axes.xaxis.get_major_formatter()(0.25, 0) == expected


def test_axes_are_logarithmic_if_medians_differ_by_more_than_a_factor_of_ten():
    result = study()
    worse = Study(result.scenario, 10.0, result.samples, {}, result.metrics._replace(rmse=20.0 * result.metrics.rmse))
    doubled = Study(result.scenario, 10.0, result.samples, {}, result.metrics._replace(rmse=2.0 * result.metrics.rmse))
    assert plots.plot_distribution({"a": result, "b": worse}).axes[0].get_xscale() == "log"
    assert plots.plot_distribution({"a": result, "b": doubled}).axes[0].get_xscale() == "linear"


@pytest.mark.parametrize(("signal", "scale"), [("tilt", "log"), ("yaw_error", "linear")])
def test_the_axis_of_a_metric_is_logarithmic_only_if_the_metric_cannot_be_negative(signal, scale):
    """Samples below zero would not be drawn on a logarithmic axis, although both medians are positive."""
    scenario = load_scenario("robustness", [{"metrics": {"additional": {"mine": {"kind": "max", "of": signal}}}}])
    values = np.linspace(0.1, 1.0, 20)
    studies = {}
    for name, factor in (("a", 1.0), ("b", 20.0)):
        fields = dict.fromkeys(scenario.metrics_type._fields, factor * values)
        metrics = scenario.metrics_type(**{**fields, "crash_time": np.full(20, math.inf)})
        studies[name] = Study(scenario, 10.0, np.arange(20), {}, metrics)
    assert plots.plot_distribution(studies, "mine").axes[0].get_xscale() == scale


def test_the_overview_of_studies_has_their_means_and_crashes():
    studies = {"one": study(), "other": study(3, 5, 80)}
    _, axes = plot_study(studies, "peak_error")
    means = [mean_interval(each.metrics.peak_error[~each.metrics.crashed]) for each in studies.values()]
    crashes = [proportion_interval(30, 200), proportion_interval(5, 80)]
    for part, expected, size in (("mean", means, 1.0), ("crashes", crashes, 1.0)):
        (container,) = axes[part].containers
        np.testing.assert_allclose(
            container.lines[0].get_xydata(), [[size * each.value, i] for i, each in enumerate(expected)]
        )
        for i, (each, segment) in enumerate(zip(expected, container.lines[2][0].get_segments(), strict=True)):
            np.testing.assert_allclose(segment, [[size * each.low, i], [size * each.high, i]])
        assert axes[part].get_ylim() == (1.5, -0.5)
        assert [label.get_text() for label in axes[part].get_yticklabels()] == ["one", "other"]
    assert axes["mean"].get_xlabel() == "mean peak error (cm)"
    expected = np.sort(studies["other"].metrics.peak_error[~studies["other"].metrics.crashed])
    np.testing.assert_array_equal(axes["distribution"].lines[1].get_xdata(), expected)
    assert [label.get_text() for label in plot_study(studies["one"])[1]["mean"].get_yticklabels()] == ["robustness"]


def test_a_comparison_shows_every_sample_of_each_controller():
    """Errors of samples without a crash, and their mean, are drawn in cm around the row of their controller."""
    flights = {
        "calm": {"a": study().metrics, "b": no_crash(1, 50).metrics},
        "wind": {"a": study(2, NUM_SAMPLES).metrics},
    }
    flights["wind"]["b"] = study(4, 3, 40).metrics
    first, second = plot_comparison(flights).axes
    for axes, name in ((first, "calm"), (second, "wind")):
        assert axes.get_title() == name
        for row, (metrics, points) in enumerate(
            zip(flights[name].values(), [line for line in axes.lines if line.get_marker() == "."], strict=True)
        ):
            errors = 100.0 * metrics.rmse[~metrics.crashed]
            np.testing.assert_allclose(points.get_xdata(), errors)
            if len(errors):
                np.testing.assert_allclose(points.get_ydata(), row + np.linspace(-0.22, 0.22, len(errors)))
        means = [line for line in axes.lines if line.get_marker() != "."]
        expected = [
            (100.0 * metrics.rmse[~metrics.crashed].mean(), row)
            for row, metrics in enumerate(flights[name].values())
            if not metrics.crashed.all()
        ]
        np.testing.assert_allclose([line.get_xydata()[0] for line in means], expected)
        assert axes.get_xlim()[0] == 0.0
    mean = 100.0 * study().metrics.rmse[~study().metrics.crashed].mean()
    assert first.texts[0].get_text() == f"{mean:.1f} cm, 30 crashed"
    assert second.texts[0].get_text() == "200 crashed"
    assert second.texts[0].xy == (0.0, 0)
    assert first.texts[1].xy == pytest.approx((100.0 * flights["calm"]["b"].rmse.mean(), 1))
    assert [label.get_text() for label in first.get_yticklabels()] == ["a", "b"]
    assert first.get_ylim() == (1.5, -0.5)
    large = plot_comparison({"gale": {"a": study().metrics._replace(rmse=np.full(NUM_SAMPLES, 0.126))}}).axes[0]
    assert large.texts[0].get_text().startswith("13 cm")
    axes_of_one_sample = plot_comparison({"gale": {"a": no_crash(count=1).metrics}}).axes[0]
    np.testing.assert_array_equal(axes_of_one_sample.lines[0].get_ydata(), [0.0])
    axes_of_two_samples = plot_comparison({"gale": {"a": no_crash(count=2).metrics}}).axes[0]
    np.testing.assert_allclose(axes_of_two_samples.lines[0].get_ydata(), [-0.22, 0.22])
