"""Tests that figures are legible: labels have a background, and each curve is visible and has a legend entry."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.text import Annotation

from drake_quad import load_scenario, simulate
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.nominal import planned_parameters
from drake_quad.visualization.comparison_plots import plot_comparison
from drake_quad.visualization.curves import dash_overlapping_curves, dashes
from drake_quad.visualization.learning_plots import plot_learning, plot_secant_gains
from drake_quad.visualization.plan_plots import plot_plan
from drake_quad.visualization.plots import plot_errors, plot_path, plot_rotors
from drake_quad.visualization.style import new_figure


@pytest.fixture(scope="module")
def flight():
    return simulate(load_scenario("diagrams/figure_eight.yaml", ["duration=8"]))


@pytest.fixture(scope="module")
def learned():
    return simulate(load_scenario("diagrams/paper.yaml:low_wind_pd_t2fnn", ["duration=8"]))


def num_white_labels(figure):
    """Return the number of annotations in a figure; all of them must have a white background."""
    labels = [text for axes in figure.axes for text in axes.texts if isinstance(text, Annotation) and text.get_text()]
    assert all(to_hex(label.get_bbox_patch().get_facecolor()) == "#ffffff" for label in labels)
    assert all(3.0 <= np.hypot(*label.get_position()) <= 10.0 for label in labels)
    return len(labels)


def test_waypoint_numbers_have_a_white_background():
    scenario = load_scenario("diagrams/figure_eight.yaml")
    figure = plot_plan(plan_route(scenario), planned_parameters(scenario))
    assert num_white_labels(figure) == 15


def test_the_labels_of_secant_gains_have_a_white_background(learned):
    assert num_white_labels(plot_secant_gains(learned)) == 6


def test_the_labels_of_mean_errors_in_a_comparison_have_a_white_background():
    generator = np.random.default_rng(1)
    count = len(Metrics._fields) - 1

    def metrics(mean):
        rows = np.abs(mean * (1.0 + 0.02 * generator.standard_normal((count, 20))))
        return Metrics(*rows, crash_time=np.full(20, np.inf))

    flights = {name: {"low": metrics(0.01), "middle": metrics(0.5), "high": metrics(1.0)} for name in ("a", "b", "c")}
    assert num_white_labels(plot_comparison(flights)) == 9


def test_leg_numbers_and_legend_of_errors_are_above_the_curves(flight):
    figure = plot_errors(flight)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    renderer = figure.canvas.get_renderer()
    for axes in figure.axes:
        inside = axes.get_window_extent()
        assert not legend.get_window_extent(renderer).overlaps(inside)
        numbers = [text for text in axes.texts if text.get_text().isdigit()]
        assert len(numbers) >= 3
        for number in numbers:
            box = number.get_window_extent(renderer)
            assert box.y0 >= inside.y1
            assert not legend.get_window_extent(renderer).overlaps(box)


def test_overlapping_curves_are_dashed():
    figure = new_figure(4.0, 3.0)
    axes = figure.subplots()
    time = np.linspace(0.0, 1.0, 200)
    curves = [axes.plot(time, values)[0] for values in (time, 1.0 - time, time + 1e-3, 0.5 * time, time - 1e-3)]
    dash_overlapping_curves(axes)
    assert [curve.is_dashed() for curve in curves] == [False, False, True, False, True]


def test_each_of_several_overlapping_curves_is_visible():
    """The dashes of each curve cover a smaller fraction of its length than the dashes of the curve below it."""
    patterns = [dashes(index, 4)[1] for index in range(4)]
    fractions = [dash / (dash + gap) for dash, gap in patterns]
    assert fractions == pytest.approx([1.0, 0.75, 0.5, 0.25])
    assert len({dash + gap for dash, gap in patterns}) == 1
    # The visible part of each curve is several times as long as the curve is wide.
    visible_lengths = -np.diff([dash for dash, _ in patterns] + [0.0])
    assert np.all(visible_lengths > 4.0)


def test_equal_rotor_speeds_are_distinguishable(flight):
    """Each rotor has its own panel. In the panel with the limits, the curves are dashed."""
    figure = plot_rotors(flight)
    *panels, common_panel = figure.axes
    figure.draw_without_rendering()
    boxes = [axes.get_window_extent() for axes in panels]
    assert all(upper.y0 > lower.y1 for upper, lower in pairwise(boxes))
    assert all(axes.get_shared_y_axes().joined(panels[0], axes) for axes in panels)
    rotors = [line for line in common_panel.lines if line.get_label().startswith("rotor")]
    assert [line.is_dashed() for line in rotors] == [False, True, True, True]


def test_the_legend_identifies_each_weight(learned):
    """The last rule has the last set of each input, and its curve has the colour and the line style of these sets."""
    figure = plot_learning(learned)
    weights = figure.axes[3]
    key = {text.get_text(): line for text, line in zip(*legend_of(weights), strict=True)}
    assert list(key) == [f"{name} at {centre}" for name in ("error", "rate") for centre in ("−1", "0", "+1")]
    last = learned["weights"][:, -1]
    (curve,) = [line for line in weights.lines if np.array_equal(line.get_ydata(), last)]
    assert to_hex(curve.get_color()) == to_hex(key["error at +1"].get_color())
    assert curve.get_linestyle() == key["rate at +1"].get_linestyle()
    styles = {(line.get_color(), line.get_linestyle()) for line in weights.lines}
    assert len(styles) == len(weights.lines) == 9


def legend_of(axes):
    legend = axes.get_legend()
    return legend.get_texts(), legend.get_lines()


@pytest.mark.slow
def test_a_path_has_equal_scales_in_three_dimensions():
    flight = simulate(load_scenario("diagrams/slalom.yaml", ["duration=3"]))
    space = plot_path(flight).axes[0]
    lengths = np.ptp([space.get_xlim(), space.get_ylim(), space.get_zlim()], axis=1)
    aspect = np.array(space._box_aspect)
    np.testing.assert_allclose(lengths / lengths[0], aspect / aspect[0], rtol=0.05)
    assert lengths.min() > 0.3 * lengths.max()
