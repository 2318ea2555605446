"""Tests that panels of a figure share their axes and fill the figure, and that overlapping curves are dashed."""

import numpy as np
import pytest
from test_design_plots import drawn_map, panels  # noqa: F401 - a fixture
from test_ends_of_axes import design, identification  # noqa: F401 - a fixture
from test_identification_plots import compared  # noqa: F401 - a fixture
from test_study_plots import study

from drake_quad import load_scenario, simulate
from drake_quad.flight.mission import plan_route
from drake_quad.identification.results.estimates import Estimates, Source
from drake_quad.planning.nominal import planned_parameters
from drake_quad.scenario.layouts import rotors_of
from drake_quad.space.shapes import Ball
from drake_quad.space.space import Obstacle, Space
from drake_quad.visualization import design_plots, identification_plots, learning_plots, plots
from drake_quad.visualization.comparison_plots import plot_comparison
from drake_quad.visualization.curves import dash_overlapping_curves
from drake_quad.visualization.frames import Camera
from drake_quad.visualization.log_comparison_plots import plot_log_comparison
from drake_quad.visualization.overview import plot_flight
from drake_quad.visualization.plan_plots import plot_plan
from drake_quad.visualization.replay.scene import reference_points
from drake_quad.visualization.style import new_figure


@pytest.fixture(scope="module")
def hover():
    return simulate(load_scenario("hover", ["duration=0.2"]))


@pytest.fixture(scope="module")
def learned():
    return simulate(load_scenario("paper:low_wind_pd_t2fnn", ["duration=0.5"]))


def check_shared_axes(figure, rows, columns, *, x, y):
    """Check which panels of a grid share the axes x and y: all ("all"), those of a row or column, or none ("")."""
    grid = np.array(figure.axes[: rows * columns]).reshape(rows, columns)
    for i, j in np.ndindex(rows, columns):
        for k, m in np.ndindex(rows, columns):
            if (i, j) < (k, m):
                first, second = grid[i, j], grid[k, m]
                is_shared = {"": False, "all": True, "col": j == m, "row": i == k}
                assert first.get_shared_x_axes().joined(first, second) == is_shared[x]
                assert first.get_shared_y_axes().joined(first, second) == is_shared[y]


@pytest.mark.slow
def test_panels_of_flights_and_networks_share_their_axes(hover, learned):
    check_shared_axes(plots.plot_errors(hover), 2, 1, x="all", y="")
    check_shared_axes(plots.plot_attitude(hover), 3, 1, x="all", y="")
    check_shared_axes(learning_plots.plot_memberships(), 1, 4, x="", y="all")
    check_shared_axes(learning_plots.plot_learning(learned), 3, 2, x="all", y="row")
    check_shared_axes(learning_plots.plot_surfaces(learned), 2, 2, x="all", y="all")
    check_shared_axes(learning_plots.plot_secant_gains(learned), 1, 2, x="", y="all")


@pytest.mark.long
def test_panels_of_designs_and_logs_share_their_axes(design, panels, compared):  # noqa: F811
    check_shared_axes(design_plots.plot_bode(design), 2, 2, x="col", y="row")
    result, first, second, *_ = panels
    check_shared_axes(drawn_map(result, first, second), 1, 2, x="", y="all")
    check_shared_axes(plot_log_comparison(compared), 3, 2, x="all", y="")
    check_shared_axes(identification_plots.plot_fit(identification("m", "rad")), 2, 2, x="all", y="")
    flights = {"calm": {"a": study().metrics}, "gale": {"a": study().metrics}}
    check_shared_axes(plot_comparison(flights), 1, 2, x="all", y="all")


@pytest.mark.slow
def test_a_network_on_one_axis_has_one_column():
    flight = simulate(load_scenario("paper:low_wind_pd_t2fnn", ["duration=0.1", "control.network.axes=[y]"]))
    assert len(learning_plots.plot_memberships([(1.2, 0.8)]).axes) == 1
    assert len(learning_plots.plot_secant_gains(flight).axes) == 1
    trace, surfaces = learning_plots.plot_learning(flight), learning_plots.plot_surfaces(flight)
    assert [axes.get_title(loc="left") for axes in trace.axes] == ["on Y", "", ""]
    assert [axes.get_title() for axes in surfaces.axes] == ["on Y, before the flight", "on Y, after the flight", ""]


def test_overlapping_curves_are_dashed_in_all_plots_of_a_flight(hover):
    """In hover without wind all errors and angles are almost zero, so their curves overlap."""
    upper, _ = plots.plot_errors(hover).axes
    assert [line.is_dashed() for line in upper.lines[:2]] == [False, True]
    for axes in plots.plot_attitude(hover).axes[:2]:
        commanded, flown = axes.lines
        assert not commanded.is_dashed()
        assert flown.is_dashed()
    _, axes = plot_flight(hover)
    assert [line.is_dashed() for line in axes["command"].lines[:2]] == [False, True]


def test_overlap_is_judged_on_the_final_scale_of_the_axes():
    axes = new_figure(4.0, 3.0).subplots()
    x = np.linspace(0.0, 1.0, 50)
    curves = [axes.plot(x, 5000.0 * x + offset)[0] for offset in (0.0, 1.0, 1000.0)]
    dash_overlapping_curves(axes)
    assert [curve.is_dashed() for curve in curves] == [False, True, False]


def test_leg_numbers_are_in_the_middle_of_the_flown_part():
    flight = simulate(load_scenario("figure_eight", ["duration=4"]))
    last = flight.time[-1]
    ends = [*(time for time in flight.plan.leg_times if time < last), last]
    middle_times = 0.5 * (np.array(ends[1:]) + ends[:-1])
    for axes in plots.plot_errors(flight).axes:
        number_times = [text.xy[0] for text in axes.texts if text.get_text().isdigit()]
        np.testing.assert_allclose(number_times, middle_times, atol=1e-9)
        (second,) = axes.patches
        assert (second.get_x(), second.get_x() + second.get_width()) == pytest.approx(ends[1:3])


@pytest.mark.long
def test_the_view_of_a_hover_spans_half_a_metre(hover):
    _, plane = plots.plot_path(hover).axes
    plane.figure.draw_without_rendering()
    assert 0.5 <= min(np.ptp(plane.get_xlim()), np.ptp(plane.get_ylim())) < 0.75
    plan = plot_plan(hover.plan, planned_parameters(hover.scenario))
    plan.draw_without_rendering()
    for axes in plan.axes[:3]:
        assert min(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())) < 0.75
    # If the speed is always zero, the axis ends a little above 1 m/s.
    assert plan.axes[3].get_ylim() == (0.0, 1.12)


@pytest.mark.slow
def test_the_plot_of_a_plan_fills_its_figure_and_shows_the_clearance_of_obstacles():
    scenario = load_scenario("figure_eight")
    space = Space((Obstacle("ball", Ball((3.0, 0.0, 1.0), radius=0.2)),), 0.1)
    figure = plot_plan(plan_route(scenario), planned_parameters(scenario), space=space)
    figure.draw_without_rendering()
    views, profiles = figure.axes[:3], figure.axes[3:]
    assert [len(axes.patches) for axes in views] == [2, 2, 2]
    lefts, rights = ([axes.get_position().intervalx for axes in part] for part in (views, profiles))
    assert np.min(lefts) < 0.1
    assert np.max(rights) > 0.95
    assert 0.0 < np.min(rights) - np.max(lefts) < 0.15
    assert len(profiles) == 5


@pytest.mark.long
def test_a_star_marks_the_gains_of_the_scenario_if_they_are_on_the_map(panels):  # noqa: F811
    result, first, second, *_ = panels
    k_p, k_d = (first[0], first[-1]), (second[0], second[-1])
    inside = [(a, b) for a in k_p for b in k_d]
    beyond = [(k_p[0] - 0.1, 2.0), (k_p[1] + 0.1, 2.0), (3.0, k_d[0] - 0.1), (3.0, k_d[1] + 0.1)]
    for positions, count in ((inside, 1), (beyond, 0)):
        for position in positions:
            stars = [
                line
                for line in drawn_map(result[:1], first, second, position).axes[0].lines
                if line.get_marker() == "*"
            ]
            assert len(stars) == count


def test_the_edge_of_stability_is_where_a_pole_leaves_the_unit_circle(panels):  # noqa: F811
    result, first, second, *_ = panels
    edge, *_ = [each for each in drawn_map(result[:1], first, second).axes[0].collections if hasattr(each, "levels")]
    assert edge.levels == [1.0]
    assert sum(len(path.vertices) for path in edge.get_paths()) > 5


def test_colour_bars_have_labels():
    estimates = Estimates(("inertia[0]", "inertia[1]"), np.ones(2), np.eye(2), 9.0, Source("m", "a"))
    axes, bar = identification_plots.plot_correlations(estimates).axes
    assert bar.get_ylabel() == "correlation of estimation errors (1)"
    assert axes.images[0].get_clim() == (-1.0, 1.0)


def test_a_nyquist_plot_has_equal_units(design):  # noqa: F811
    for axes in design_plots.plot_nyquist(design).axes:
        assert axes.get_aspect() == 1.0


@pytest.mark.slow
def test_the_scene_of_a_camera_contains_the_whole_path_and_is_not_too_flat():
    scenario = load_scenario("figure_eight")
    plan = plan_route(scenario)
    axes = Camera(scenario, plan)._axes
    (path,) = axes.lines
    np.testing.assert_allclose(np.array(path.get_data_3d()).T, reference_points(plan))
    low, high = reference_points(plan).min(axis=0), reference_points(plan).max(axis=0)
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    max_rotor_distance = max(float(np.hypot(rotor.x, rotor.y)) for rotor in rotors_of(scenario.nominal))
    size = high - low + 6.0 * max_rotor_distance
    np.testing.assert_allclose(np.ptp(limits, axis=1), np.maximum(size, 0.3 * size.max()))
    np.testing.assert_allclose(limits.mean(axis=1), 0.5 * (low + high))
    # The longest side has at most six ticks, and shorter sides have fewer.
    marks = [axis.get_major_locator()._nbins for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
    assert max(marks) == 6
    assert np.argsort(marks, kind="stable").tolist() == np.argsort(np.ptp(limits, axis=1), kind="stable").tolist()
