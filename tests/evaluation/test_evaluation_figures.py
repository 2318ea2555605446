"""Tests that the figures of the evaluation show the results of invented flights."""

import numpy as np
import pytest
from invented_flights import evaluation, flights

from drake_quad.evaluation.claims import CONTROLLER_NAMES, comparisons_by_laboratory
from drake_quad.evaluation.families import FAMILIES
from drake_quad.evaluation.figures import (
    base_and_network,
    errors_figure,
    evaluation_figures,
    laps_figure,
    margins_figure,
    networks_figure,
    reductions_by_network,
)
from drake_quad.evaluation.results import Evaluation
from drake_quad.reports.claims import reduction
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import values_without_crashes

LABORATORIES = ("no wind", "low wind", "high wind", "outdoor")


def centimetres(metrics):
    return mean_interval(100.0 * values_without_crashes(metrics, "rmse"))


def ticks(axis):
    """Return the positions of the ticks of an axis and their labels."""
    return axis.get_ticklocs().tolist(), [text.get_text() for text in axis.get_ticklabels()]


def test_a_figure_is_drawn_only_if_the_evaluation_contains_its_flights():
    result = evaluation()
    drawn = dict(evaluation_figures(result))
    assert list(drawn) == ["errors", "networks", "margins", "laps"]
    labels = {name: [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes] for name, figure in drawn.items()}
    assert drawn["errors"].get_supxlabel() == "RMSE (cm)"
    assert labels["networks"] == [("reduction of the RMSE by the network (%)", "")]
    sensitivity, delay = "peak sensitivity", "tolerated additional delay (ms)"
    assert labels["margins"] == [(sensitivity, "RMSE in high wind (cm)"), (delay, "")]
    assert labels["laps"] == [("lap", "RMSE (cm)")]
    for name in ("margins", "laps"):
        (legend,) = drawn[name].legends
        assert [text.get_text() for text in legend.texts] == drawn[name].axes[0].get_legend_handles_labels()[1]
        assert len(legend.texts) == 2
    for figure in drawn.values():
        assert 3.0 < figure.get_figwidth() < 10.0  # inches, one or two columns of a page
    few = Evaluation({"outdoor": {"pd": result.flights["outdoor"]["pd"]}}, {"outdoor": result.traits["outdoor"]})
    assert [name for name, _ in evaluation_figures(few)] == ["errors"]


def test_a_name_is_split_into_controller_and_network():
    assert base_and_network("pid_t2fnn") == ("pid", "t2fnn")
    assert base_and_network("pd_t2fnn_map") == ("pd", "t2fnn_map")
    assert base_and_network("disturbance_observer") == ("disturbance_observer", "")


def test_the_errors_figure_has_markers_with_intervals():
    result = evaluation(crashed=range(8))
    for laboratory in ("robustness", "still air"):
        result.flights[laboratory] = {"pd": flights(0.9), "indi": flights(0.01, scatter=1)}
    names = ["pd", "indi", "pd_t1fnn", "pd_t2fnn", "indi_t2fnn"]
    figure = errors_figure(result)
    visible_axes = [axes for axes in figure.axes if axes.get_visible()]
    titles = ["no wind", "low wind", "high wind", "outdoor", "robustness", "still air"]
    assert [axes.get_title().split("\n")[-1] for axes in visible_axes] == titles
    assert visible_axes[0].get_title() == "laboratory\nno wind"
    assert visible_axes[3].get_title() == "outdoor"
    assert ticks(visible_axes[0].yaxis) == ([*range(5)], [CONTROLLER_NAMES[name] for name in names])
    styles = {}
    for axes, laboratory in zip(visible_axes, titles, strict=True):
        flown = [name for name in names if name in result.flights[laboratory]]
        low, high = axes.get_xlim()
        for name, interval, marker in zip(flown, axes.lines[::2], axes.lines[1::2], strict=True):
            row, mean = names.index(name), centimetres(result.flights[laboratory][name])
            np.testing.assert_allclose(interval.get_xydata(), [[mean.low, row], [mean.high, row]])
            np.testing.assert_allclose(marker.get_xydata(), [[mean.value, row]])
            assert (marker.get_fillstyle() == "none") == ((name, laboratory) == ("pd_t2fnn", "outdoor"))
            assert interval.get_color() == marker.get_color()
            styles.setdefault(name, set()).add((marker.get_color(), marker.get_marker()))
            assert low * 1.2 < mean.low < mean.high < high / 1.2
        assert axes.get_ylim() == (pytest.approx(len(names) - 0.5, abs=0.2), pytest.approx(-0.5, abs=0.2))
        positions, labels = ticks(axes.xaxis)
        assert len(positions) >= 3
        assert low <= min(positions) < max(positions) <= high
        assert labels == [f"{each:g}" for each in positions]
        # Tick labels are round numbers and do not overlap.
        assert {f"{each:e}".partition("e")[0].rstrip(".0") for each in positions} <= {"1", "2", "3", "5"}
        assert min(np.diff(np.log10(positions))) > 0.06 * np.log10(high / low)
        assert not len(axes.xaxis.get_minorticklocs())
        assert axes.get_xscale() == "log"
    # A controller has the same colour with and without a network, and each kind of network has one marker.
    ((color, marker),) = styles["pd"]
    assert styles["pd_t2fnn"] == {(color, styles["indi_t2fnn"].copy().pop()[1])}
    assert styles["pd_t1fnn"] != styles["pd_t2fnn"]
    assert styles["indi"].copy().pop()[0] == styles["indi_t2fnn"].copy().pop()[0] != color
    assert styles["indi"].copy().pop()[1] == marker


def test_the_errors_figure_omits_controllers_that_crash_in_all_samples():
    lost = Evaluation({"outdoor": {"pd": flights(0.2, crashed=range(40)), "indi": flights(0.1)}}, {})
    (axes,) = errors_figure(lost).axes
    assert [line.get_ydata()[0] for line in axes.lines] == [1, 1]


def test_the_networks_figure_has_a_row_per_network():
    result = evaluation(type_1_ratio=0.9, type_2_ratio=0.8)
    result.flights["high wind"]["pd_t2fnn_map"] = flights(0.5, scatter=1)
    reductions = reductions_by_network(result)
    assert list(reductions) == ["pd_t1fnn", "pd_t2fnn", "pd_t2fnn_map", "indi_t2fnn"]
    assert [*reductions["pd_t1fnn"]] == [*LABORATORIES]
    assert reductions["pd_t2fnn"]["outdoor"] == reduction(
        comparisons_by_laboratory(result, "pd_t2fnn", "pd")["outdoor"].ratio
    )
    figure = networks_figure(result)
    (axes,) = figure.axes
    zero, *lines = axes.lines
    assert set(zero.get_xdata()) == {0.0}
    pairs_of_lines = iter(zip(lines[::2], lines[1::2], strict=True))
    (legend,) = figure.legends
    colors = {text.get_text(): line.get_color() for text, line in zip(legend.texts, legend.get_lines(), strict=True)}
    assert list(colors) == list(FAMILIES)
    assert len(set(colors.values())) == 4
    low, high = axes.get_xlim()
    for row, by_laboratory in enumerate(reductions.values()):
        heights = []
        for laboratory, each in by_laboratory.items():
            interval, marker = next(pairs_of_lines)
            family = "outdoor" if laboratory == "outdoor" else "laboratory"
            assert interval.get_color() == marker.get_color() == colors[family]
            np.testing.assert_allclose(interval.get_xdata(), [100.0 * each.low, 100.0 * each.high])
            np.testing.assert_allclose(marker.get_xdata(), 100.0 * each.value)
            np.testing.assert_allclose(interval.get_ydata(), marker.get_ydata()[0])
            heights.append(float(marker.get_ydata()[0]) - row)
            assert low < 100.0 * each.low < 100.0 * each.high < high
        # The markers of a row are separate, in order, and closer to their row than to the next one.
        assert sorted(heights) == heights
        assert max(np.abs(heights)) < 0.5
        assert len(set(heights)) == len(by_laboratory)
    assert next(pairs_of_lines, None) is None
    positions, labels = ticks(axes.yaxis)
    assert (positions, labels) == ([*range(4)], [CONTROLLER_NAMES[name] for name in reductions])
    bottom, top = axes.get_ylim()
    assert (bottom, top) == (3.5, -0.5)
    positions, labels = ticks(axes.xaxis)
    assert [float(text) for text in labels] == positions
    assert not len(axes.xaxis.get_minorticklocs())
    worst = min(each.low for by_laboratory in reductions.values() for each in by_laboratory.values())
    assert 100.0 * worst > low > 150.0 * worst


def test_the_axis_of_the_networks_figure_extends_beyond_six_per_cent_even_if_all_reductions_are_small():
    result = evaluation(type_1_ratio=0.999, type_2_ratio=0.999)
    low, high = networks_figure(result).axes[0].get_xlim()
    assert -8.0 < low < -6.0
    assert 6.0 < high < 8.0


def test_large_changes_by_networks_do_not_hide_small_ones():
    """The scale is logarithmic beyond 10 %. A network with thirty times the error is outside of the axis."""
    axes = networks_figure(evaluation(type_1_ratio=30.0, type_2_ratio=0.0001)).axes[0]
    assert axes.get_xscale() == "symlog"
    assert axes.xaxis.get_transform().linthresh == 10.0
    assert axes.get_xlim() == (-400.0, 110.0)


def test_the_margins_figure_shows_errors_over_the_peak_sensitivity_and_over_the_delay():
    actual = evaluation()
    figure = margins_figure(actual)
    errors = {name: centimetres(each).value for name, each in actual.flights["high wind"].items()}
    expected = [errors["indi@1.6"], errors["indi"], errors["indi@3"]]
    for axes, line, plain in zip(figure.axes, ([1.6, 2.2, 3.0], [62.5, 90.0, 100.0 / 3.0]), (2.2, 90.0), strict=True):
        designs_by_sensitivity, *others = axes.lines
        np.testing.assert_allclose(designs_by_sensitivity.get_xydata(), np.transpose([line, expected]))
        assert [other.get_label() for other in others] == ["PD", "INDI"]
        np.testing.assert_allclose(
            [other.get_xydata()[0] for other in others], [[plain, errors["pd"]], [plain, errors["indi"]]]
        )
        assert designs_by_sensitivity.get_color() == others[1].get_color() != others[0].get_color()
        low, high = axes.get_xlim()
        assert low <= min(line)
        assert high >= max(line)
    left, right = figure.axes
    assert left.get_shared_y_axes().joined(left, right)
    assert left.get_yscale() == right.get_yscale() == "log"
    assert not len(left.yaxis.get_minorticklocs())
    assert left.get_xlim() == (pytest.approx(1.5, abs=0.05), 3.1)
    assert right.get_xlim() == (0.0, 100.0)
    positions, labels = ticks(left.yaxis)
    assert positions == [3, 5, 10, 20]
    assert labels == ["3", "5", "10", "20"]


def test_the_axes_of_the_margins_figure_are_extended_for_designs_beyond_the_usual_limits():
    result = evaluation()
    traits = result.traits["laboratory"]
    traits["pd"] = traits["pd"]._replace(sensitivity=1.2, delay_flown=0.25)
    traits["indi"] = traits["indi"]._replace(sensitivity=4.0, delay_flown=np.inf)
    left, right = margins_figure(result).axes
    assert left.get_xlim()[0] < 1.2
    assert left.get_xlim()[1] > 4.0
    assert right.get_xlim()[1] > 250.0
    # An infinite tolerated delay is not drawn.
    assert np.isnan(right.lines[-1].get_xdata()[0])


def test_the_laps_figure_shows_errors_lap_by_lap():
    result = evaluation()
    figure = laps_figure(result, ["pd"])
    (axes,) = figure.axes
    for container, controller in zip(axes.containers, ("pd", "pd_t2fnn_map"), strict=True):
        means = [centimetres(result.flights[f"high wind, lap {lap}"][controller]) for lap in (1, 2, 3)]
        curve, _, (bars,) = container
        assert container.get_label() == CONTROLLER_NAMES[controller]
        np.testing.assert_allclose(curve.get_xydata(), [[i, mean.value] for i, mean in enumerate(means, start=1)])
        for i, (bar, mean) in enumerate(zip(bars.get_segments(), means, strict=True), start=1):
            np.testing.assert_allclose(bar, [[i, mean.low], [i, mean.high]])
    assert axes.get_ylim()[0] == 0.0
    assert axes.get_xticks().tolist() == [1, 2, 3]
    without, with_map = (container[0] for container in axes.containers)
    assert without.get_linestyle() != with_map.get_linestyle()
    assert without.get_color() == with_map.get_color()
