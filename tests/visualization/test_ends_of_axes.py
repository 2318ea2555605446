"""Tests that axes contain all curves, that ticks are at round numbers, and that overlapping curves are dashed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d import proj3d
from pydrake.math import RollPitchYaw
from test_study_plots import no_crash, study

from drake_quad import load_scenario, simulate
from drake_quad.design.cascade import design_cascade
from drake_quad.flight.mission import plan_route
from drake_quad.identification.result import ForecastOutput, Identification
from drake_quad.identification.results.estimates import Estimates, Source
from drake_quad.identification.validation.prediction import Predictions
from drake_quad.planning.nominal import planned_parameters
from drake_quad.signals import Reference, State
from drake_quad.visualization import block_drawing, curves, design_plots, identification_plots, plots, study_plots
from drake_quad.visualization.comparison_plots import plot_comparison
from drake_quad.visualization.curves import dash_overlapping_curves
from drake_quad.visualization.frames import Camera
from drake_quad.visualization.plan_plots import plot_plan
from drake_quad.visualization.replay.scene import reference_points
from drake_quad.visualization.style import new_figure
from drake_quad.visualization.wind_plots import plot_wind


@pytest.fixture(scope="module")
def design():
    return design_cascade(load_scenario("laboratory:nominal"))


@pytest.mark.slow
def test_bode_plots_have_symmetric_gain_axes_and_phase_ticks_at_45_degrees(design):
    upper, lower = np.array(design_plots.plot_bode(design).axes).reshape(2, 2)
    for name, gain, phase in zip(("pitch", "x"), upper, lower, strict=True):
        margins = design.all_loops[name].margins
        bottom, top = gain.get_ylim()
        assert -bottom == top > margins.gain
        # Phases have ticks at multiples of 45 degrees, from one end of the axis to the other.
        bottom, top = phase.get_ylim()
        np.testing.assert_array_equal(phase.get_yticks(), np.arange(bottom, top + 1.0, 45.0))
        assert phase.get_yticks()[-1] == top
        assert phase.get_xlim()[0] < 0.2 * margins.crossover


def test_a_nyquist_plot_has_one_scale_and_the_unit_circle(design):
    for axes in design_plots.plot_nyquist(design).axes:
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        assert right - left == pytest.approx(top - bottom)
        assert -bottom == top > 1.0
        assert 1.0 < right < 1.5


def test_damping_rays_are_labelled_near_their_ends(design):
    (axes,) = design_plots.plot_root_locus(design).axes
    rays = [line.get_xydata()[1] for line in axes.lines if len(line.get_xdata()) == 5]
    for text, end in zip(axes.texts, rays, strict=True):
        fraction = np.array(text.xy) / end
        assert fraction[0] == pytest.approx(fraction[1])
        assert 0.8 < fraction[0] < 1.0
    assert [line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 2] == [0.0]


def test_compared_errors_fit_into_the_axes():
    metrics = {name: {"a": study().metrics, "b": no_crash(1, 50).metrics} for name in ("calm", "wind")}
    # Errors of the second scenario that are larger than all errors of the first one are drawn, too.
    large = metrics["wind"]["a"]
    metrics["wind"]["a"] = large._replace(rmse=3.0 * large.rmse)
    panels = plot_comparison(metrics).axes
    max_error = max(line.get_xdata().max() for axes in panels for line in axes.lines)
    for axes in panels:
        assert 1.1 * max_error < axes.get_xlim()[1] < 1.7 * max_error


def test_the_axis_of_sample_fractions_ends_just_above_one():
    (axes,) = study_plots.plot_distribution({"one": no_crash()}).axes
    assert 1.0 < axes.get_ylim()[1] < 1.1
    (axes,) = study_plots.plot_influences(study()).axes
    # The two bars of a parameter touch, and there is a gap before the bars of the next parameter.
    bars = [(bar.get_y(), bar.get_y() + bar.get_height()) for bar in axes.patches]
    assert bars[0][1] == pytest.approx(bars[1][0])
    assert bars[1][1] < bars[2][0]


def test_sample_counts_have_ticks_at_one_two_and_five():
    for axes in study_plots.plot_convergence({"one": study()}).axes:
        ticks = axes.xaxis.get_major_locator().tick_values(10.0, 200.0)
        assert {10.0, 20.0, 50.0, 100.0, 200.0} <= set(np.round(ticks, 6))
        assert {round(tick / 10.0 ** np.floor(np.log10(tick) + 1e-9)) for tick in ticks} == {1, 2, 5}
        assert len(axes.xaxis.get_minorticklocs()) == 0


def is_dashed(distance, fraction, count=200):
    """Return whether `dash_overlapping_curves` dashes a curve that partly overlaps another one.

    Args:
        distance: distance between the curves where they overlap, in points.
        fraction: fraction of the curve's length over which the curves overlap.
        count: number of points of the curve.
    """
    figure = new_figure(4.0, 3.0)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    x = np.linspace(0.0, 1.0, count)
    axes.plot(x, np.full(count, 0.5))
    offsets = np.where(np.arange(count) < fraction * count, distance, 40.0)
    # The figure is 216 points high.
    (second_curve,) = axes.plot(x, 0.5 + offsets / 216.0)
    dash_overlapping_curves(axes)
    return second_curve.is_dashed()


def test_curves_overlap_if_they_are_near_over_a_quarter_of_their_length():
    assert is_dashed(1.1, 1.0)
    assert not is_dashed(1.3, 1.0)
    assert is_dashed(0.0, 0.27)
    assert not is_dashed(0.0, 0.23)
    # Lines between two points, such as limits, are not dashed.
    assert not is_dashed(0.0, 1.0, count=2)
    assert is_dashed(0.0, 1.0, count=3)


def test_curves_with_different_abscissas_are_not_compared():
    axes = new_figure(4.0, 3.0).subplots()
    curves = [axes.plot(np.linspace(0.0, 1.0, count), np.zeros(count))[0] for count in (10, 20, 10)]
    dash_overlapping_curves(axes)
    assert [curve.is_dashed() for curve in curves] == [False, False, True]


def test_each_group_of_overlapping_curves_is_dashed_once(monkeypatch):
    calls = []
    monkeypatch.setattr(curves, "dashes", lambda *arguments: calls.append(arguments) or "--")
    axes = new_figure(4.0, 3.0).subplots()
    x = np.linspace(0.0, 1.0, 10)
    lines = [axes.plot(x, np.full(10, height))[0] for height in (0.0, 1.0, 0.0, 1.0, 0.0)]
    dash_overlapping_curves(axes)
    assert [line.is_dashed() for line in lines] == [False, False, True, True, True]
    # Three curves lie at height 0, and the second and third of them are dashed. Two curves lie at height 1, and the
    # second of them is dashed.
    assert calls == [(1, 3), (2, 3), (1, 2)]


def test_panels_of_single_rotors_do_not_include_the_speed_limits():
    flight = simulate(load_scenario("figure_eight", ["duration=0.4"]))
    single_rotor, *_, all_rotors = plots.plot_rotors(flight).axes
    (bottom, top), (lowest, highest) = single_rotor.get_ylim(), all_rotors.get_ylim()
    speeds = flight["rotor_speed"]
    assert bottom < speeds.min() < speeds.max() < top
    vehicle = flight.scenario.vehicle
    assert lowest <= vehicle.min_rotor_speed < vehicle.max_rotor_speed < highest
    assert top - bottom < highest - lowest


@pytest.mark.slow
def test_equal_rotor_speeds_of_a_plan_are_dashed():
    """In hover all rotors have the same speed."""
    scenario = load_scenario("figure_eight", ["route={kind: hover, position: [0, 0, 1]}", "duration=1"])
    plan = plan_route(scenario)
    figure = plot_plan(plan, planned_parameters(scenario))
    rotors = [line for line in figure.axes[7].lines if line.get_label().startswith("rotor")]
    assert [line.is_dashed() for line in rotors] == [False, True, True, True]
    # The views of a hover are at least half a metre wide.
    figure.draw_without_rendering()
    for axes in figure.axes[:3]:
        assert min(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())) >= 0.5
    yaw = figure.axes[6].get_ylim()
    assert np.ptp(yaw) == pytest.approx(20.0)
    assert np.mean(yaw) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_a_diverged_flight_is_drawn_until_its_state_is_not_finite():
    wind = "laboratory.wind=[{kind: fan, position: [-2, 0, 1], direction: [1, 0, 0], flow: 1.0, diameter: 0.6}]"
    flight = simulate(load_scenario("hover", ["duration=0.2", wind]))
    state = flight["state"].copy()
    state[-5:] = np.nan
    state[-5:, 1] = 1e6  # large but finite; a position with NaN components is not shown
    diverged = replace(flight, signals={**flight.signals, "state": state})
    for full_axes, cut_axes in zip(plot_wind(flight).axes[:2], plot_wind(diverged).axes[:2], strict=True):
        np.testing.assert_allclose(cut_axes.get_xlim(), full_axes.get_xlim(), atol=0.02)
        np.testing.assert_allclose(cut_axes.get_ylim(), full_axes.get_ylim(), atol=0.02)


@pytest.mark.slow
def test_wind_in_the_signals_is_plotted_even_if_the_scenario_has_none(monkeypatch):
    """The flight's signal `wind` is changed to a short wind along one axis."""
    monkeypatch.setattr(plots, "save_figures", lambda figures, folder, vector: [*figures])
    flight = simulate(load_scenario("hover", ["duration=0.1"]))
    wind = np.zeros_like(flight["wind"])
    wind[3, 0] = 1.0
    assert "wind" not in plots.save_plots(flight, ".")
    assert "wind" in plots.save_plots(replace(flight, signals={**flight.signals, "wind": wind}), ".")


@pytest.mark.slow
def test_the_points_at_which_a_reference_is_drawn_extend_from_its_start_to_its_end():
    plan = plan_route(load_scenario("slalom"))
    points = reference_points(plan)
    np.testing.assert_allclose(points[[0, -1]], plan.waypoints[[0, -1]], atol=1e-6)
    # The reference has twenty points per second.
    assert len(points) == int(20.0 * plan.duration)
    np.testing.assert_allclose(
        points[1:4].T, plan.derivative(0).vector_values(np.arange(1, 4) * plan.duration / (len(points) - 1)), atol=1e-6
    )


def identification(*units, fraction=0.9):
    """Return an identification with one output for each unit.

    The forecast error of an output alternates between 0 and 0.1 of its unit.
    """
    time = np.arange(12)[:, None] + np.linspace(0.0, 1.0, 26)
    measured = np.sin(time)
    outputs = tuple(
        ForecastOutput(
            "angular velocity about x", unit, time, measured, measured - 0.1 * (time % 0.2 < 0.1), fraction, 0.1
        )
        for unit in units
    )  # fmt: skip
    return Identification(None, None, outputs)


@pytest.mark.parametrize(
    ("unit", "factor", "unit_label"),
    [
        ("m", 100.0, "cm"),
        ("rad", 180.0 / np.pi, "°"),
        ("rad/s", 180.0 / np.pi, "°/s"),
        ("m/s", 1.0, "m/s"),
        ("N", 1.0, "N"),
    ],
)
def test_outputs_are_drawn_in_the_unit_of_their_label(unit, factor, unit_label):
    result = identification(unit)
    left, right = identification_plots.plot_fit(result).axes
    output = result.outputs[0]
    assert left.get_ylabel() == f"angular\nvelocity about\nx\n({unit_label})"
    np.testing.assert_allclose(left.lines[0].get_ydata(), factor * output.measured[0])
    np.testing.assert_allclose(right.lines[0].get_ydata(), factor * output.residual[0])
    # Zero error is marked by a line.
    assert right.lines[-1].get_ydata()[0] == 0.0


def test_the_title_of_a_forecast_states_that_no_variance_is_explained_unless_the_fraction_is_positive():
    for fraction, words in (
        (-0.9, "no variance explained"),
        (0.0, "no variance explained"),
        (0.001, "explained variance 0.1 %"),
    ):
        _, right = identification_plots.plot_fit(identification("m", fraction=fraction)).axes
        assert right.get_title(loc="right") == words


def test_residual_correlations_fit_their_axis_and_frequencies_are_plain_numbers():
    figure = identification_plots.plot_residuals(identification("m"))
    left, right = figure.axes
    bottom, top = left.get_ylim()
    assert -1.0 <= bottom < 0.0
    assert 1.0 < top < 1.2
    assert right.xaxis.get_major_formatter()(0.5) == "0.5"
    assert right.xaxis.get_minor_formatter()(0.5) == ""
    ticks = right.xaxis.get_major_locator().tick_values(1.0, 10.0)
    assert {1.0, 2.0, 5.0, 10.0} <= set(np.round(ticks, 6))


def test_strong_correlations_are_written_in_white():
    names = ("inertia[0]", "inertia[1]", "inertia[2]")
    covariance = np.eye(3)
    covariance[0, 1] = covariance[1, 0] = -0.75
    covariance[0, 2] = covariance[2, 0] = 0.65
    axes = identification_plots.plot_correlations(Estimates(names, np.ones(3), covariance, 9.0, Source("m", "a"))).axes[
        0
    ]
    colors = {text.get_position(): text.get_color() for text in axes.texts}
    assert colors == {(1, 0): "white", (0, 1): "white", (2, 0): "black", (0, 2): "black"}


def test_the_first_two_quantities_are_drawn_if_position_and_attitude_are_unknown():
    errors = dict.fromkeys(("velocity", "climb", "height"), np.full((1, 2, 8), 0.02))
    predictions = Predictions(("one",), (0.1, 0.5), np.array(["a"] * 8), np.arange(8.0), errors)
    first, second = identification_plots.plot_predictions(predictions).axes
    assert (first.get_ylabel(), second.get_ylabel()) == ("RMS error of velocity (m/s)", "RMS error of climb (m/s)")
    assert len(first.xaxis.get_minorticklocs()) == 0


def test_a_drawing_that_graphviz_cannot_render_is_a_failure(monkeypatch):
    commands = []

    def run(command, **options):
        commands.append((command, options["input"]))
        return SimpleNamespace(
            returncode=len(commands) - 1, stdout='<?xml?>\n<svg width="3">\n</svg>\n\n', stderr="line 1\n"
        )

    monkeypatch.setattr(block_drawing.shutil, "which", lambda _: "/usr/bin/dot")
    monkeypatch.setattr(block_drawing.subprocess, "run", run)
    assert block_drawing.svg("digraph {}") == (
        f'<svg width="3">\n</svg>\n<!-- {block_drawing.digest("digraph {}")} -->\n'
    )
    assert commands == [(["dot", "-Tsvg"], "digraph {}")]
    with pytest.raises(RuntimeError, match="Graphviz's dot ended with status 1: line 1"):
        block_drawing.svg("digraph {}")


@pytest.fixture(scope="module")
def camera():
    scenario = load_scenario("hover")
    return Camera(scenario, plan_route(scenario))


def middle_of(frame, color):
    """Return the mean position of all pixels of a colour, from the left and the bottom; None without such pixels."""
    up, across = np.nonzero(np.abs(frame - 255.0 * np.array(to_rgb(color))).max(axis=2) < 30.0)
    return np.array([across.mean(), len(frame) - up.mean()]) if len(up) else None


@pytest.mark.slow
def test_a_frame_shows_vehicle_and_target_at_their_positions(camera):
    position, target = np.array([0.1, -0.05, 1.05]), np.array([-0.3, -0.3, 0.8])
    attitude = np.array([0.5, -0.4, 2.0])
    state = State(*np.array([*position, *attitude, *[0.0] * 6])[:, np.newaxis])
    (frame,) = camera.frames(state, Reference(*np.array([*target, *[0.0] * 8])[:, np.newaxis]))

    def on_image(point):
        across, up, _ = proj3d.proj_transform(*point, camera._projection)
        return camera._axes.transData.transform((across, up))

    np.testing.assert_allclose(middle_of(frame, "tab:green"), on_image(target), atol=1.5)
    # The front of the vehicle is red. With this pitch and yaw it points up and to the left.
    front_direction = RollPitchYaw(*attitude).ToRotationMatrix().matrix()[:, 0]
    expected_direction, drawn_direction = (
        on_image(position + 0.1 * front_direction) - on_image(position),
        middle_of(frame, "tab:red") - on_image(position),
    )
    assert (
        drawn_direction @ expected_direction / np.linalg.norm(drawn_direction) / np.linalg.norm(expected_direction)
        > 0.98
    )
    # A vehicle whose position is NaN is not drawn, but its target is.
    (empty,) = camera.frames(
        State(*np.full((12, 1), np.nan)), Reference(*np.array([*target, *[0.0] * 8])[:, np.newaxis])
    )
    assert middle_of(empty, "tab:red") is None
    np.testing.assert_allclose(middle_of(empty, "tab:green"), on_image(target), atol=1.5)
    up, across = np.nonzero((frame != empty).any(axis=2))
    np.testing.assert_allclose([across.mean(), len(frame) - up.mean()], on_image(position), atol=8.0)
    assert np.ptp(across) > 50


def test_a_camera_sees_a_room_around_the_path(camera):
    """The room around a hover is six times as wide as the largest distance of a rotor from the centre.

    Each axis has two to eight ticks.
    """
    axes = camera._axes
    max_rotor_distance = float(np.linalg.norm(camera._arms[:, :2], axis=1).max())
    for limits, centre in ((axes.get_xlim(), 0.0), (axes.get_ylim(), 0.0), (axes.get_zlim(), 1.0)):
        assert np.mean(limits) == pytest.approx(centre, abs=1e-6)
        assert np.ptp(limits) == pytest.approx(6.0 * max_rotor_distance)
    assert camera._radius == pytest.approx(0.45 * max_rotor_distance)
    assert [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()] == ["X (m)", "Y (m)", "Z (m)"]
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        assert 2 <= len(axis.get_major_locator().tick_values(0.0, 1.0)) <= 8
