"""Tests that plots of designs, stability maps, plans and sensitivities show the right values."""

import dataclasses
import math
import re

import numpy as np
import pytest
import scipy

from drake_quad import load_scenario
from drake_quad.design.cascade import design_cascade
from drake_quad.design.sensitivity import Sensitivities
from drake_quad.design.stability_map import StabilityMap
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.planning.feasibility import plan_demand
from drake_quad.planning.nominal import planned_parameters
from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate, hermite_path
from drake_quad.reference.regions import Box, Polytope, Sphere
from drake_quad.space.shapes import Ball, Cuboid
from drake_quad.space.space import Obstacle, Space
from drake_quad.visualization import design_plots, map_plots, plan_plots
from drake_quad.visualization.obstacles import convex_hull, draw_obstacles, draw_solids
from drake_quad.visualization.sensitivity_plots import plot_sensitivities
from drake_quad.visualization.style import BLUE, VERMILION, new_figure


@pytest.fixture(scope="module")
def design():
    return design_cascade(load_scenario("laboratory:nominal"))


def response_of(loop, frequency):
    """Return L at frequencies (rad/s), from the transfer matrices of the plant and the gains."""
    plant = loop.plant
    responses = []
    for w in frequency:
        z = np.exp(1j * w * plant.period)
        outputs = plant.C @ np.linalg.solve(z * np.eye(len(plant.A)) - plant.A, plant.B) + plant.D
        responses.append(complex((np.array([loop.gains]) @ outputs)[0, 0]))
    return np.array(responses)


@pytest.mark.long
def test_bode_plots_have_gain_phase_and_margins(design):
    figure = design_plots.plot_bode(design)
    grid = np.array(figure.axes).reshape(2, 2)
    for column, (name, title) in enumerate((("pitch", "attitude (pitch)"), ("x", "position (x)"))):
        upper = grid[0, column]
        lower = grid[1, column]
        loop = design.all_loops[name]
        (curve,) = [line for line in upper.lines if len(line.get_xdata()) > 100]
        frequency, gain = curve.get_xydata()[::40].T
        expected = response_of(loop, frequency)
        np.testing.assert_allclose(gain, 20.0 * np.log10(np.abs(expected)), atol=1e-6)
        (curve,) = [line for line in lower.lines if len(line.get_xdata()) > 100]
        phase = curve.get_ydata()
        turns = (phase[::40] - np.degrees(np.angle(expected))) / 360.0
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-6)
        assert np.abs(np.diff(phase)).max() < 90.0
        # Double integrators begin at -180 degrees.
        assert phase[0] == pytest.approx(-180.0, abs=90.0)
        margins = loop.margins
        first, second = upper.get_title().splitlines()
        assert first == f"{title}, delay margin {1e3 * margins.delay:.0f} ms"
        gain, _, phase, crossover = (float(number) for number in re.findall(r"[\d.]+", second))
        assert (gain, phase, crossover) == pytest.approx((margins.gain, margins.phase, margins.crossover), abs=0.02)
        assert lower.get_xlim()[1] == pytest.approx(math.pi / loop.plant.period)


def test_the_loop_of_a_nyquist_plot_stays_outside_the_disk_and_touches_it(design):
    for axes, name in zip(design_plots.plot_nyquist(design).axes, ("pitch", "x"), strict=True):
        loop = design.all_loops[name]
        named = [text.get_text() for text in axes.get_legend().get_texts()]
        assert named == ["L", "|L| = 1", f"disk margin {loop.margins.disk:.2f}"]
        curve = axes.lines[0].get_xydata() @ [1.0, 1j]
        frequency = np.geomspace(0.1, 0.9 * math.pi / loop.plant.period, 400)
        expected = response_of(loop, frequency)
        distances = np.abs(expected[:, None] - curve).min(axis=1)
        assert (distances < 0.05 * np.maximum(np.abs(expected), 0.1)).all()
        circle = axes.lines[1].get_xydata() @ [1.0, 1j]
        np.testing.assert_allclose(np.abs(circle), 1.0)
        assert circle[0] == pytest.approx(circle[-1])
        corners = axes.patches[0].get_xy()
        low, high = corners[:, 0].min(), corners[:, 0].max()
        alpha = loop.margins.disk
        ends = [-(1.0 + 0.5 * alpha) / (1.0 - 0.5 * alpha), -(1.0 - 0.5 * alpha) / (1.0 + 0.5 * alpha)]
        np.testing.assert_allclose([low, high], ends, rtol=1e-3)
        centre, radius = 0.5 * (low + high), 0.5 * (high - low)
        np.testing.assert_allclose(np.hypot(corners[:, 0] - centre, corners[:, 1]), radius, rtol=1e-3)
        # The Nyquist curve touches the disk of the disk margin.
        assert np.abs(curve - centre).min() == pytest.approx(radius, rel=0.02)
        assert axes.lines[2].get_xydata().tolist() == [[-1.0, 0.0]]


def test_a_root_locus_contains_the_poles_of_the_closed_loop(design):
    loop = design.loops["x"]
    plant = loop.plant
    row = np.array([loop.gains])
    figure = design_plots.plot_root_locus(design)
    (axes,) = figure.axes
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named[:2] == ["open loop", "as designed"]
    assert len(named) == 3

    def poles(factor):
        """Return the poles in continuous time, without those of delays, which have no continuous counterpart."""
        result = np.linalg.eigvals(plant.A - factor * plant.B @ row @ plant.C)
        return np.log(result[np.abs(result) > 1e-6].astype(complex)) / plant.period

    limit = 10.0 ** (loop.margins.gain / 20.0)
    marked = [line for line in axes.lines if line.get_marker() in "xso" and line.get_linestyle() == "None"]
    assert len(marked) == 3
    for line, factor in zip(marked, (0.0, 1.0, limit), strict=True):
        drawn_poles = line.get_xydata() @ [1.0, 1j]
        drawn_poles = drawn_poles[np.isfinite(drawn_poles)]
        for pole in poles(factor):
            assert np.abs(drawn_poles - pole).min() < 1e-4 * (1.0 + abs(pole))
        assert len(drawn_poles) == len(poles(factor))
    # At the limit of stability a pair of poles is on the imaginary axis.
    assert np.abs(poles(limit).real).min() < 1e-2
    assert marked[2].get_label() == f"limit of stability, × {limit:.2f}"
    cloud = axes.lines[0].get_xydata() @ [1.0, 1j]
    cloud = cloud[np.isfinite(cloud)]
    for factor in (0.0, 0.5, 3.0, 29.0):
        for pole in poles(factor):
            assert np.abs(cloud - pole).min() < 0.02 * (1.0 + abs(pole))
    # The rays of constant damping ratio reach the edge of the plot.
    rays = [line.get_xydata() for line in axes.lines if len(line.get_xdata()) == 5]
    for ray, damping in zip(rays, (0.3, 0.5, 0.7), strict=True):
        for x, y in (ray[1], ray[4]):
            assert -x / math.hypot(x, y) == pytest.approx(damping)
        assert ray[1, 1] == -ray[4, 1] == axes.get_ylim()[1]
    assert [text.get_text() for text in axes.texts] == ["ζ 0.3", "ζ 0.5", "ζ 0.7"]
    edge = max(4.0 * loop.margins.bandwidth, 1.2 * np.abs(poles(limit)[np.abs(poles(limit).real).argmin()].imag))
    assert axes.get_ylim() == pytest.approx((-edge, edge), rel=1e-6)
    assert axes.get_xlim() == pytest.approx((-1.3 * edge, 0.4 * edge), rel=1e-6)


@pytest.mark.long
def test_step_responses_settle_at_the_step_size():
    loop = closed_loop(load_scenario("laboratory:nominal"))
    for axes, (row, size) in zip(
        design_plots.plot_steps(loop).axes, (("x", 0.5), ("z", 0.5), ("yaw", 0.5)), strict=True
    ):
        diagram, model, reference = axes.lines
        assert axes.get_title() == f"step in {row}"
        assert reference.get_ydata()[0] == size
        for line in (diagram, model):
            assert line.get_ydata()[0] == pytest.approx(0.0, abs=1e-9)
            assert line.get_ydata()[-1] == pytest.approx(size, rel=0.1)
        np.testing.assert_allclose(diagram.get_ydata(), model.get_ydata(), atol=0.12 * size)
        assert axes.get_ylim()[1] >= 1.06 * size
    # The plot ends after five time constants of the slowest mode, but not before 4 s or after 20 s.
    slowest = -math.log(np.abs(loop.system.poles()).max()) / loop.system.period
    assert diagram.get_xdata()[-1] == pytest.approx(min(max(5.0 / slowest, 4.0), 20.0), abs=0.05)


def metrics_of(rmse, crashed):
    return Metrics(rmse, *[rmse] * (len(Metrics._fields) - 2), np.where(crashed, 1.0, np.inf))


@pytest.fixture(scope="module")
def panels():
    """Return panels and their values.

    Gains with k_D below k_P / 4 are unstable, and flights with the largest gains crash.
    """
    first, second = np.linspace(1.0, 5.0, 9), np.linspace(0.5, 3.5, 13)
    k_p, k_d = np.meshgrid(first, second, indexing="ij")
    size = 1.0 + 0.1 * (0.25 * k_p - k_d)
    damping = np.where(size < 1.0, k_d / (2.0 * np.sqrt(k_p)), np.nan)
    delay = np.where(size < 1.0, 0.5 / (k_p + k_d), np.nan)
    rmse = 0.02 + 0.01 * np.hypot(k_p - 3.0, k_d - 2.0)
    crashed = k_p + k_d > 8.2
    panels = [
        map_plots.MapPanel(name, StabilityMap(size, damping, delay), metrics_of(factor * rmse, crashed))
        for name, factor in (("calm", 1.0), ("windy", 4.0))
    ]
    return panels, first, second, rmse, crashed


def drawn_map(panels, first, second, marked=(3.0, 2.0)):
    return map_plots.plot_map(panels, first, second, labels=("k_P (1/s²)", "k_D (1/s)"), marked=marked, loop="position")


@pytest.mark.long
def test_a_map_shows_the_error_of_each_pair_of_gains(panels):
    result, first, second, rmse, crashed = panels
    figure = drawn_map(result, first, second)
    left, right, bar = figure.axes
    for axes, factor in ((left, 1.0), (right, 4.0)):
        (image,) = axes.images
        drawn_values = np.ma.filled(image.get_array(), np.nan)
        np.testing.assert_allclose(drawn_values, np.where(crashed, np.nan, 100.0 * factor * rmse))
        # Each pair of gains is in the middle of its cell.
        assert image.get_extent() == pytest.approx((0.5 - 0.125, 3.5 + 0.125, 0.75, 5.25))
        assert image.origin == "lower"
        (star,) = [line for line in axes.lines if line.get_marker() == "*"]
        assert star.get_xydata().tolist() == [[2.0, 3.0]]
        low = 100.0 * rmse[~crashed].min()
        high = 100.0 * 4.0 * rmse[~crashed].max()
        assert (image.norm.vmin, image.norm.vmax) == pytest.approx((low, high))
    assert (left.get_xlabel(), left.get_ylabel()) == ("k_D (1/s)", "k_P (1/s²)")
    assert [axes.get_title() for axes in (left, right)] == ["calm", "windy"]
    assert bar.get_ylabel() == "RMSE of the flight (cm)"
    assert set(bar.get_yticks()) == {2.0, 5.0, 10.0}
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == ["stability limit", "damping ratio ζ", "delay margin", "gains of the scenario", "crashed"]
    assert figure.get_suptitle() == "Gains of the position loop: simulated flights as colours, linear model as lines"
    outside = drawn_map(result, first, second, marked=(0.5, 2.0)).axes[0]
    assert not outside.lines


@pytest.mark.slow
def test_contours_of_a_map_show_stability_limit_damping_and_delay_margin(panels):
    result, first, second, *_ = panels
    axes = drawn_map(result, first, second).axes[0]
    edge, damping, delay = [each for each in axes.collections if hasattr(each, "levels")]
    for path in edge.get_paths():
        for k_d, k_p in path.vertices:
            assert k_d == pytest.approx(0.25 * k_p, abs=1e-6)
    for level, path in zip(damping.levels, damping.get_paths(), strict=True):
        for k_d, k_p in path.vertices:
            assert k_d / (2.0 * math.sqrt(k_p)) == pytest.approx(level, abs=0.02)
    assert tuple(damping.levels) == (0.2, 0.4, 0.6, 0.8)
    np.testing.assert_allclose(delay.levels, [0.02, 0.08, 0.32, 1.28, 5.12])
    for level, path in zip(delay.levels, delay.get_paths(), strict=True):
        for k_d, k_p in path.vertices:
            assert 0.5 / (k_p + k_d) == pytest.approx(level, rel=0.05)
    labels = [text.get_text() for text in axes.texts]
    assert {"ζ 0.4", "80 ms"} <= set(labels)
    # A map has no stability limit if all gains are stable.
    stable = [result[0]._replace(linear=result[0].linear._replace(size=np.full((9, 13), 0.9)))]
    assert len([each for each in drawn_map(stable, first, second).axes[0].collections if hasattr(each, "levels")]) == 2


def test_contour_labels_are_on_their_lines_and_do_not_overlap(panels):
    result, first, second, *_ = panels
    figure = drawn_map(result[:1], first, second)
    figure.draw_without_rendering()
    axes = figure.axes[0]
    inside = axes.get_window_extent()
    positions = []
    for text in axes.texts:
        x, y = axes.transData.transform(text.get_position())
        assert inside.x0 + 20.0 < x < inside.x1 - 20.0
        assert inside.y0 + 20.0 < y < inside.y1 - 20.0
        level = float(text.get_text().removeprefix("ζ ").removesuffix(" ms"))
        k_d, k_p = text.get_position()
        value = k_d / (2.0 * math.sqrt(k_p)) if "ζ" in text.get_text() else 500.0 / (k_p + k_d)
        assert value == pytest.approx(level, rel=0.1)
        positions.append((x, y))
    assert len(positions) >= 4
    assert scipy.spatial.distance.pdist(positions).min() > 20.0


@pytest.mark.slow
def test_the_colour_scale_of_a_map_has_a_positive_width_if_all_errors_are_equal_or_tiny(panels):
    result, first, second, *_ = panels
    zero = [result[0]._replace(simulated=metrics_of(np.zeros((9, 13)), np.zeros((9, 13), dtype=bool)))]
    image = drawn_map(zero, first, second).axes[0].images[0]
    assert (image.norm.vmin, image.norm.vmax) == pytest.approx((0.01, 0.02))
    crash = [result[0]._replace(simulated=metrics_of(np.zeros((9, 13)), np.ones((9, 13), dtype=bool)))]
    image = drawn_map(crash, first, second).axes[0].images[0]
    assert (image.norm.vmin, image.norm.vmax) == pytest.approx((1.0, 2.0))
    wide = [
        result[0]._replace(simulated=metrics_of(np.geomspace(1e-3, 9.0, 117).reshape(9, 13), np.zeros((9, 13), bool)))
    ]
    image = drawn_map(wide, first, second).axes[0].images[0]
    assert (image.norm.vmin, image.norm.vmax) == pytest.approx((0.1, 3.0))


def test_sensitivities_are_drawn_in_per_cent_per_per_cent():
    fields = ("a", "b", "c", "d")
    values = np.array([2.0, 0.5, 0.0, 4.0])
    gradients = {"rmse": np.array([0.1, -2.0, 7.0, np.nan]), "effort_x": np.zeros(4)}
    result = Sensitivities(fields, values, {"rmse": 0.4, "effort_x": 0.0}, np.inf, gradients)
    (axes,) = plot_sensitivities(result, "rmse").axes
    # The largest bar is at the top. A field that is zero and a metric without a derivative have no bar.
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b"]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([0.5, -2.5])
    assert [bar.get_y() + 0.5 * bar.get_height() for bar in axes.patches] == pytest.approx([0.0, 1.0])
    colors = [bar.get_facecolor() for bar in axes.patches]
    reference = new_figure(1.0, 1.0).subplots().bar([0, 1], [1, 1], color=[VERMILION, BLUE])
    assert colors == [bar.get_facecolor() for bar in reference]
    assert axes.get_title() == "Sensitivities of RMSE"
    (empty_axes,) = plot_sensitivities(result, "effort_x").axes
    mine = dataclasses.replace(result, metrics={"my_metric": 0.4}, gradients={"my_metric": gradients["rmse"]})
    assert plot_sensitivities(mine, "my_metric").axes[0].get_title() == "Sensitivities of my metric"
    assert not empty_axes.patches
    assert empty_axes.texts[0].get_text() == "no field changes the metric to first order"


@pytest.fixture(scope="module")
def planned():
    scenario = load_scenario("figure_eight")
    return plan_route(scenario), planned_parameters(scenario)


@pytest.fixture(scope="module")
def drawn_plan(planned):
    """Return the axes of a drawn plan. It stays far below its speed limit, and need not pass through any regions."""
    return plan_plots.plot_plan(*planned, limits=PathLimits(speed=9.0)).axes


def test_a_plan_is_drawn_in_three_views(planned, drawn_plan):
    plan, _ = planned
    views = drawn_plan[:3]
    for axes, (i, j) in zip(views, ((0, 1), (0, 2), (1, 2)), strict=True):
        path, points, start = axes.lines
        times = np.linspace(plan.path.times[0], plan.path.times[-1], 500)
        simulated = evaluate(plan.path, times)[[i, j]].T
        assert np.linalg.norm(simulated[:, None] - path.get_xydata(), axis=2).min(axis=1).max() < 0.02
        np.testing.assert_allclose(points.get_xydata(), plan.waypoints[:, [i, j]])
        np.testing.assert_allclose(start.get_xydata(), plan.waypoints[:1, [i, j]])
        assert (axes.get_xlabel(), axes.get_ylabel()) == (f"{'XYZ'[i]} (m)", f"{'XYZ'[j]} (m)")
        assert axes.get_aspect() == 1.0
        assert bool(axes.texts) == (j == 1)
    # Waypoints at the same position have a single label with all their numbers.
    numbers = sorted(int(number) for text in views[0].texts for number in text.get_text().split(", "))
    assert numbers == list(range(len(plan.waypoints)))
    for text in views[0].texts:
        for number in text.get_text().split(", "):
            tolerance = 0.02 * np.ptp(plan.waypoints[:, :2], axis=0).max()
            assert np.linalg.norm(plan.waypoints[int(number), :2] - text.xy) <= tolerance + 1e-9


def test_profiles_of_a_plan_are_norms_of_its_derivatives(planned, drawn_plan):
    plan, parameters = planned
    speed, acceleration, snap, yaw, rotors = drawn_plan[3:]
    times = speed.lines[0].get_xdata()
    assert (times[0], times[-1]) == (0.0, plan.duration)
    for axes, order in ((speed, 1), (acceleration, 2), (snap, 4)):
        expected = np.linalg.norm(evaluate(plan.path, times, order), axis=0)
        np.testing.assert_allclose(axes.lines[0].get_ydata(), expected)
        top = 9.0 if order == 1 else expected.max()
        assert axes.get_ylim() == pytest.approx((0.0, 1.12 * top))
        assert axes.get_xlim() == (0.0, plan.duration)
    assert speed.lines[1].get_ydata()[0] == 9.0
    np.testing.assert_allclose(yaw.lines[0].get_ydata(), np.degrees(evaluate(plan.yaw, times)[0]))
    low, high = yaw.get_ylim()
    assert high - low >= 20.0 - 1e-9
    demand = plan_demand(plan, parameters, times).rotor_speed
    for i, (line, speeds) in enumerate(zip(rotors.lines, demand, strict=False), start=1):
        assert line.get_label() == f"rotor {i}"
        np.testing.assert_allclose(line.get_ydata(), speeds)
    assert [line.get_ydata()[0] for line in rotors.lines[4:6]] == [
        parameters.min_rotor_speed,
        parameters.max_rotor_speed,
    ]
    assert [text.get_text() for text in rotors.get_legend().get_texts()] == [f"rotor {i}" for i in range(1, 5)]
    assert rotors.get_ylim() == pytest.approx((0.0, 1.12 * parameters.max_rotor_speed))
    waypoint_times = [line.get_xdata()[0] for line in rotors.lines[6:]]
    np.testing.assert_allclose(waypoint_times, plan.path.times)


@pytest.mark.slow
@pytest.mark.parametrize("turn", [5.0, 90.0])
def test_the_yaw_axis_contains_the_yaw_and_spans_at_least_twenty_degrees(planned, turn):
    plan, parameters = planned
    ends = np.radians([[[0.0], [0.0], [0.0]], [[turn], [0.0], [0.0]]])
    turning_plan = Plan(plan.path, hermite_path(plan.path.times[[0, -1]], ends))
    *_, yaw, _ = plan_plots.plot_plan(turning_plan, parameters).axes
    low, high = yaw.get_ylim()
    if turn < 20.0:
        assert (low, high) == pytest.approx((0.5 * turn - 10.0, 0.5 * turn + 10.0))
    else:
        assert -0.1 * turn < low < 0.0 < turn < high < 1.1 * turn


@pytest.mark.slow
def test_regions_and_waypoints_of_a_plan_are_drawn_at_their_positions(planned):
    """Only the waypoints of the route are drawn."""
    plan, parameters = planned
    box = Box([1.0, 2.0, 0.5], [1.5, 2.6, 1.0])
    ball = Sphere([0.3, 0.4, 1.2], 0.25)
    corridor = Box([-2.0, -3.0, 0.0], [3.0, 4.0, 2.5])
    half = Polytope([[1.0, 0.0, 0.0]], [2.0])
    figure = plan_plots.plot_plan(
        plan,
        parameters,
        regions=(Box.point([0, 0, 1]), box, ball),
        corridors=(corridor, None, corridor, half),
        waypoints=np.array([0, 2, 5]),
    )
    np.testing.assert_allclose(figure.axes[0].lines[1].get_xydata(), plan.waypoints[[0, 2, 5], :2])
    for axes, (i, j) in zip(figure.axes[:3], ((0, 1), (0, 2), (1, 2)), strict=True):
        # The corridor that two segments share is drawn once. The first region is a single point and is not drawn.
        first, second, third, fourth = axes.patches
        for patch, region in ((first, corridor), (third, box)):
            assert patch.get_xy() == (region.low[i], region.low[j])
            assert (patch.get_width(), patch.get_height()) == pytest.approx(
                (region.high[i] - region.low[i], region.high[j] - region.low[j])
            )
        path = evaluate(plan.path, np.linspace(0.0, plan.duration, 4000))
        margin = 0.25 + 0.1 * np.ptp(path, axis=1).max()
        ends = np.array([second.get_xy().min(axis=0), second.get_xy().max(axis=0)])
        expected = np.array([path.min(axis=1) - margin, path.max(axis=1) + margin])
        expected[1, 0] = 2.0 if expected[1, 0] > 2.0 else expected[1, 0]
        np.testing.assert_allclose(ends, expected[:, [i, j]], atol=1e-3)
        assert (fourth.get_center(), fourth.get_radius()) == ((ball.centre[i], ball.centre[j]), 0.25)


def test_obstacles_are_drawn_as_projections():
    space = Space(
        (Obstacle("post", Cuboid((1.0, 2.0, 0.5), size=(0.4, 0.6, 1.0))), Obstacle("ball", Ball((0.0, 0.0, 1.0)))),
        0.1,
        margin=0.2,
    )
    axes = new_figure(3.0, 3.0).subplots()
    draw_obstacles(axes, space, 0, 2, clearance=True)
    box, box_clearance, disc, disc_clearance = axes.patches
    np.testing.assert_allclose(np.sort(box.get_xy()[:-1], axis=0), [[0.8, 0.0], [0.8, 0.0], [1.2, 1.0], [1.2, 1.0]])
    np.testing.assert_allclose(
        [box_clearance.get_xy().min(axis=0), box_clearance.get_xy().max(axis=0)], [[0.5, -0.3], [1.5, 1.3]], atol=1e-3
    )
    np.testing.assert_allclose(np.hypot(*(disc.get_xy() - [0.0, 1.0]).T), 1.0, atol=0.02)
    np.testing.assert_allclose(np.hypot(*(disc_clearance.get_xy() - [0.0, 1.0]).T), 1.3, atol=0.02)
    assert [patch.get_fill() for patch in axes.patches] == [True, False, True, False]
    assert not axes.texts
    above = new_figure(3.0, 3.0).subplots()
    draw_obstacles(above, space, 0, 1)
    assert len(above.patches) == 2
    assert [text.get_text() for text in above.texts] == ["post", "ball"]
    assert above.texts[0].get_position() == pytest.approx((1.0, 1.7))
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5], [0.5, 0.0]])
    result = convex_hull(square)
    assert sorted(map(tuple, result.tolist())) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    x, y = result.T
    assert 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)) == pytest.approx(1.0)
    solid = new_figure(3.0, 3.0).add_subplot(projection="3d")
    corners = draw_solids(solid, space)
    np.testing.assert_allclose(corners, [[-1.0, -1.0, 0.0], [1.2, 2.3, 2.0]])
    assert len(solid.collections) == 2


def test_names_of_many_obstacles_are_left_out():
    for count, named in ((30, True), (31, False)):
        boxes = tuple(Obstacle(str(i), Cuboid((2.0 * i, 0.0, 0.0))) for i in range(count))
        axes = new_figure(3.0, 3.0).subplots()
        draw_obstacles(axes, Space(boxes, 0.1), 0, 1)
        assert bool(axes.texts) == named


def test_many_obstacles_are_one_silhouette_from_the_side():
    """Individual outlines and clearances would hide the path in this view; from above, each obstacle is visible."""
    for count, patches_from_the_side in ((6, 12), (7, 7)):
        boxes = tuple(Obstacle(str(i), Cuboid((2.0 * i, 0.0, 0.0))) for i in range(count))
        side, above = new_figure(3.0, 3.0).subplots(1, 2)
        draw_obstacles(side, Space(boxes, 0.1), 0, 2, clearance=True)
        draw_obstacles(above, Space(boxes, 0.1), 0, 1, clearance=True)
        assert len(side.patches) == patches_from_the_side
        assert len(above.patches) == 2 * count
    assert {patch.get_alpha() or patch.get_facecolor() for patch in side.patches} == {(0.88, 0.88, 0.88, 1.0)}


def test_profiles_show_the_whole_curve_and_the_limit(planned):
    def top_and_data(limit):
        speed = plan_plots.plot_plan(*planned, limits=PathLimits(speed=limit)).axes[3]
        return speed.get_ylim()[1], float(speed.lines[0].get_ydata().max())

    top, largest = top_and_data(0.1)
    assert top == pytest.approx(1.12 * largest)
    top, largest = top_and_data(9.0)
    assert top == pytest.approx(1.12 * 9.0)
