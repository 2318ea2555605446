"""Tests that plots of a flight show its signals in the units of their labels."""

from dataclasses import replace

import numpy as np
import pytest
from figure_content import curve, legends
from matplotlib.colors import to_hex

from drake_quad import load_scenario, simulate
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.wind.fans import jet_speed
from drake_quad.scenario.winds.source import jets
from drake_quad.signals import State
from drake_quad.visualization import plots
from drake_quad.visualization.estimate_plots import plot_flown_estimate
from drake_quad.visualization.leg_marks import leg_legend, leg_marks, number_legs, shade_legs
from drake_quad.visualization.overview import plot_flight
from drake_quad.visualization.positions import coordinates_by_axis, positions
from drake_quad.visualization.style import AXIS_COLORS, ROTOR_COLORS, new_figure
from drake_quad.visualization.wind_plots import plot_wind

WIND_OVERRIDE = (
    "laboratory.wind=["
    "{kind: fan, position: [-2.0, 0.3, 1.1], direction: [0.92106, 0.38942, 0.0], flow: 1.131, diameter: 0.6},"
    "{kind: steady, velocity: [0.3, -0.2, 0.1]}]"
)


@pytest.fixture(scope="module")
def flight():
    """Return a windy flight of three seconds past a pillar."""
    pillar = "space={obstacles: {pillar: {kind: cylinder, centre: [0.4, 2.5, 1.0], radius: 0.2, height: 2.0}}}"
    return simulate(load_scenario("laboratory:low_wind", ["duration=3", pillar]))


@pytest.fixture(scope="module")
def crash():
    """Return a flight that crashes in a strong wind."""
    wind = ["vehicle.linear_drag=0.3", "laboratory.wind=[{kind: steady, velocity: [6, 0, 0]}]"]
    return simulate(load_scenario("hover", ["duration=3", "crash.position_error=0.5", *wind]))


@pytest.fixture(scope="module")
def estimated():
    """Return a flight with a state estimator."""
    return simulate(load_scenario("warehouse_uwb", ["duration=1"]))


@pytest.mark.slow
def test_the_position_error_is_reference_minus_flown_in_centimetres(flight):
    figure = plots.plot_errors(flight)
    assert legends(figure) == ["X", "Y", "Z"]
    upper, lower = figure.axes
    state, reference = flight.record("state"), flight.record("reference")
    squared = 0.0
    for axis in "xyz":
        error = 100.0 * (getattr(reference, axis) - getattr(state, axis))
        np.testing.assert_allclose(curve(upper, axis.upper()), [flight.time, error])
        squared += error**2
    np.testing.assert_allclose(lower.lines[0].get_xydata().T, [flight.time, np.sqrt(squared)])
    np.testing.assert_allclose(lower.lines[1].get_ydata(), 100.0 * flight.metrics.rmse)
    texts = [text.get_text() for text in lower.texts]
    assert f"RMSE\n{100.0 * flight.metrics.rmse:.2f} cm" in texts
    assert lower.get_ylim()[0] == 0.0
    assert upper.get_shared_x_axes().joined(upper, lower)


def test_attitude_is_shown_in_degrees_with_its_command(flight):
    figure = plots.plot_attitude(flight)
    assert legends(figure) == ["commanded", "flown"]
    rows = figure.axes
    for axes, angle in zip(rows, ("roll", "pitch", "yaw"), strict=True):
        np.testing.assert_allclose(curve(axes, "flown")[1], np.degrees(getattr(flight.record("state"), angle)))
        command = np.degrees(getattr(flight.record("attitude_command"), angle))
        np.testing.assert_allclose(curve(axes, "commanded"), [flight.time, command])
        assert axes.get_ylabel() == f"{angle} (°)"
    # The axis of a yaw that hardly changes spans at least two degrees.
    low, high = rows[2].get_ylim()
    yaw = np.degrees(flight.record("state").yaw)
    assert high - low >= 2.0 - 1e-9
    assert low < yaw.min() <= yaw.max() < high
    roll = np.degrees(flight.record("state").roll)
    assert (rows[0].get_ylim()[0] < roll.min()) & (roll.max() < rows[0].get_ylim()[1])


def test_a_constant_attitude_is_in_the_middle_of_its_axis():
    flight = simulate(load_scenario("hover", ["duration=0.2"]))
    for axes, angle in zip(plots.plot_attitude(flight).axes, ("roll", "pitch", "yaw"), strict=True):
        angles = np.degrees(getattr(flight.record("state"), angle))
        low, high = axes.get_ylim()
        assert high - low == pytest.approx(2.0)
        assert 0.5 * (low + high) == pytest.approx(angles.mean(), abs=0.1)


def test_each_rotor_speed_has_its_own_panel_and_all_are_shown_with_their_limits(flight):
    *panels, common_panel = plots.plot_rotors(flight).axes
    vehicle = flight.scenario.vehicle
    speeds = flight.record("rotor_speed")
    limits = [vehicle.min_rotor_speed, vehicle.max_rotor_speed]
    for i, (axes, color, speed) in enumerate(zip(panels, ROTOR_COLORS, speeds, strict=True), start=1):
        assert axes.get_ylabel() == f"rotor {i} (rad/s)"
        speed_line, mean, *other_lines = axes.lines
        assert to_hex(speed_line.get_color()) == color.lower()
        np.testing.assert_allclose(speed_line.get_data(), [flight.time, speed])
        np.testing.assert_allclose(mean.get_ydata(), np.mean(speeds, axis=0))
        assert [line.get_ydata()[0] for line in other_lines] == limits
        np.testing.assert_allclose(curve(common_panel, f"rotor {i}"), [flight.time, speed])
    assert [line.get_ydata()[0] for line in common_panel.lines[4:]] == limits
    assert common_panel.get_ylim()[0] == 0.0
    assert limits[1] < common_panel.get_ylim()[1] < 1.2 * limits[1]
    assert [(text.get_text(), text.xy[1]) for text in common_panel.texts] == [
        (f"min {limits[0]:g}", limits[0]),
        (f"max {limits[1]:g}", limits[1]),
    ]
    # The panels of the four rotors have the same vertical range. It depends on the speeds and not on the speed limits.
    (low, high), *other_lines = [axes.get_ylim() for axes in panels]
    assert np.ptp(speeds) > 0.8 * (high - low)
    assert other_lines == [(low, high)] * 3


def test_a_path_is_shown_in_space_and_from_above(flight):
    figure = plots.plot_path(flight)
    assert legends(figure) == ["flown", "reference", "start", *(leg.name for leg in flight.plan.legs)]
    space, plane = figure.axes
    numbers = [text.get_text() for text in plane.texts if text.get_text().isdigit()]
    assert numbers == [str(mark.number) for mark in leg_marks(flight.plan) if np.any(mark.right)]
    state, reference = flight.record("state"), flight.record("reference")
    flown, drawn_reference = (np.array(line.get_data_3d()) for line in space.lines)
    np.testing.assert_array_equal(flown, [state.x, state.y, state.z])
    np.testing.assert_array_equal(drawn_reference, [reference.x, reference.y, reference.z])
    # The start is marked, and the pillar next to the path is in view.
    start = np.array(space.collections[0]._offsets3d)[:, 0]
    np.testing.assert_array_equal(start, flown[:, 0])
    limits = np.array([space.get_xlim(), space.get_ylim(), space.get_zlim()])
    corners = np.column_stack([flown, drawn_reference, [0.6, 2.7, 2.0], [0.2, 2.3, 0.0]])
    assert (limits[:, 0] <= corners.min(axis=1) + 1e-9).all()
    assert (limits[:, 1] >= corners.max(axis=1) - 1e-9).all()
    np.testing.assert_allclose(limits.mean(axis=1), 0.5 * (corners.min(axis=1) + corners.max(axis=1)), atol=1e-9)
    # No side of the three-dimensional view is much shorter than another.
    extents = np.diff(limits)[:, 0]
    np.testing.assert_allclose(
        extents, np.maximum(np.ptp(corners, axis=1), max(0.35 * np.ptp(corners, axis=1).max(), 0.5))
    )
    np.testing.assert_array_equal(curve(plane, "flown"), flown[:2])
    np.testing.assert_array_equal(curve(plane, "reference"), drawn_reference[:2])
    np.testing.assert_array_equal(curve(plane, "start")[:, 0], flown[:2, 0])
    assert len(plane.patches) == 1
    assert plane.get_aspect() == 1.0


def test_the_view_of_a_hover_is_half_a_metre_wide_and_centred():
    flight = simulate(load_scenario("hover", ["duration=0.2", "route={kind: hover, position: [3, -4, 1]}"]))
    space, plane = plots.plot_path(flight).axes
    centre = [state[0] for state in flight.record("state")[:3]]
    for limits, coordinate in zip((space.get_xlim(), space.get_ylim(), space.get_zlim()), centre, strict=True):
        assert np.ptp(limits) == pytest.approx(0.5, abs=0.01)
        assert np.mean(limits) == pytest.approx(coordinate, abs=0.02)
    plane.figure.draw_without_rendering()
    for limits, coordinate in zip((plane.get_xlim(), plane.get_ylim()), centre, strict=False):
        assert 0.5 <= np.ptp(limits) < 2.0
        assert np.mean(limits) == pytest.approx(coordinate, abs=0.02)


@pytest.mark.slow
def test_a_crash_is_marked_at_its_position(crash):
    assert crash.metrics.crashed
    _, plane = plots.plot_path(crash).axes
    state = crash.record("state")
    np.testing.assert_array_equal(curve(plane, crash.crash)[:, 0], [state.x[-1], state.y[-1]])
    _, axes_without_crash = plots.plot_path(simulate(load_scenario("hover", ["duration=0.1"]))).axes
    assert [line.get_label() for line in axes_without_crash.lines][:3] == ["flown", "reference", "start"]
    assert len(axes_without_crash.lines) == 3


def test_the_overview_of_a_flight_has_four_panels(flight, crash):
    figure, axes = plot_flight(flight)
    named = ["flown", "reference", "start", "X", "Y", "Z", *(f"rotor {i}" for i in range(1, 5))]
    assert sorted(legends(figure)) == sorted(named)
    np.testing.assert_array_equal(curve(axes["path"], "flown")[0], flight.record("state").x)
    command = flight.record("acceleration_command")
    for axis in "xyz":
        np.testing.assert_array_equal(curve(axes["command"], axis.upper()), [flight.time, getattr(command, axis)])
    np.testing.assert_array_equal(curve(axes["rotors"], "rotor 2")[1], flight.record("rotor_speed")[1])
    assert axes["error"].get_shared_x_axes().joined(axes["error"], axes["rotors"])
    assert axes["command"].get_shared_x_axes().joined(axes["command"], axes["rotors"])
    assert axes["error"].get_xlabel() == axes["command"].get_xlabel() == ""
    assert axes["rotors"].get_xlabel() == "time (s)"


@pytest.mark.long
def test_only_the_plots_that_apply_to_a_flight_are_saved(flight, estimated, monkeypatch):
    """A flight without wind has no plot of the wind, and a flight without a network has no plots of the learning."""
    monkeypatch.setattr(plots, "save_figures", lambda figures, folder, vector: [*figures])
    always = ["path", "errors", "attitude", "rotors"]
    assert plots.save_plots(flight, ".") == [*always, "wind"]
    flight_without_wind = simulate(load_scenario("hover", ["duration=0.1"]))
    assert plots.save_plots(flight_without_wind, ".") == always
    assert plots.save_plots(estimated, ".") == [*always, "estimate"]
    learned = simulate(load_scenario("paper:low_wind_pd_t2fnn", ["duration=0.1", "laboratory.wind=[]"]))
    assert plots.save_plots(learned, ".") == [*always, "memberships", "learning", "surfaces", "secant_gains"]


def test_errors_of_an_estimate_are_shown_with_two_standard_deviations_and_innovations(estimated):
    figure = plot_flown_estimate(estimated)
    assert legends(figure) == ["2 standard deviations", "error"]
    position, *_, yaw, innovations = figure.axes
    difference = estimated["measurement"] - estimated["state"]
    np.testing.assert_allclose(curve(position, "error")[1], 100.0 * np.linalg.norm(difference[:, :3], axis=1))
    np.testing.assert_allclose(curve(yaw, "error")[1], 1000.0 * np.abs(difference[:, 5]), atol=1e-9)
    band = position.collections[0].get_paths()[0].vertices[:, 1].max()
    deviation = np.linalg.norm(estimated["estimate_deviation"][:, :3], axis=1)
    assert band == pytest.approx(200.0 * deviation.max())
    drawn_innovations = np.array([line.get_ydata() for line in innovations.lines])
    np.testing.assert_array_equal(drawn_innovations, estimated["innovation"].T)


def test_positions_of_a_vehicle_are_read_from_its_state(flight):
    state = flight.record("state")
    np.testing.assert_array_equal(positions(state), np.transpose([state.x, state.y, state.z]))
    assert {axis: rows is not None for axis, rows in coordinates_by_axis(state).items()} == dict.fromkeys("xyz", True)
    np.testing.assert_array_equal(coordinates_by_axis(state)["y"], state.y)


@pytest.fixture(scope="module")
def plan():
    return plan_route(load_scenario("figure_eight"))


def test_a_leg_is_marked_to_the_right_of_its_middle(plan):
    marks = leg_marks(plan)
    ends = [*plan.leg_times, plan.path.times[-1]]
    assert [mark.number for mark in marks] == list(range(1, len(ends)))
    for mark, start, end in zip(marks, ends[:-1], ends[1:], strict=True):
        middle_time = 0.5 * (start + end)
        np.testing.assert_allclose(mark.middle, plan.derivative(0).value(middle_time)[:, 0])
        v_x, v_y, _ = plan.derivative(1).value(middle_time)[:, 0]
        if np.any(mark.right):
            # The direction to the mark is a unit vector to the right of the direction of flight.
            assert mark.right @ [v_x, v_y] == pytest.approx(0.0, abs=1e-9)
            assert v_x * mark.right[1] - v_y * mark.right[0] < 0.0
            assert np.linalg.norm(mark.right) == pytest.approx(1.0)
        else:
            assert np.hypot(v_x, v_y) <= 0.2
    assert sum(np.any(mark.right) for mark in marks) > 1
    assert leg_marks(plan_route(load_scenario("hover"))) == []


def test_leg_numbers_are_next_to_the_path_and_along_the_time_axis(plan):
    figure = new_figure(4.0, 3.0)
    above, time = figure.subplots(2, 1)
    number_legs(above, plan, distance=7.0)
    marks = [mark for mark in leg_marks(plan) if np.any(mark.right)]
    assert [text.get_text() for text in above.texts] == [str(mark.number) for mark in marks]
    np.testing.assert_allclose([text.xy for text in above.texts], [mark.middle[:2] for mark in marks])
    np.testing.assert_allclose([text.get_position() for text in above.texts], [7.0 * mark.right for mark in marks])
    ends = np.array([*plan.leg_times, plan.path.times[-1]])
    last = 0.5 * (ends[2] + ends[3])
    shade_legs(time, plan, last)
    shown_times = np.minimum(ends[:4], last)
    np.testing.assert_allclose(
        [text.xy for text in time.texts],
        [[time_of_number, 1.0] for time_of_number in 0.5 * (shown_times[1:] + shown_times[:-1])],
    )
    assert [text.get_text() for text in time.texts] == ["1", "2", "3"]
    assert all(text.get_position() == (0.0, 4.0) for text in time.texts)
    (second,) = time.patches
    assert (second.get_x(), second.get_width()) == pytest.approx((ends[1], ends[2] - ends[1]))
    shade_legs(above, plan, float(ends[-1]), height=0.3)
    assert [text.xy[1] for text in above.texts[len(marks) :]] == [0.3] * (len(ends) - 1)
    assert {text.get_position() for text in above.texts[len(marks) :]} == {(0.0, 0.0)}
    named = [leg.name for leg in plan.legs]
    assert [line.get_label() for line in leg_legend(plan)] == named
    for line in leg_legend(plan):
        extents = line.get_marker().get_extents()
        np.testing.assert_allclose([extents.x0 + extents.x1, extents.y0 + extents.y1], 0.0, atol=1e-6)


@pytest.fixture(scope="module")
def windy():
    return simulate(load_scenario("laboratory:nominal", ["duration=1.5", WIND_OVERRIDE]))


@pytest.mark.slow
def test_the_wind_at_the_vehicle_is_shown_over_time(windy):
    figure = plot_wind(windy)
    assert legends(figure) == ["reference", "flown", "X", "Y", "Z"]
    series = figure.axes[2]
    for axis, color in AXIS_COLORS.items():
        np.testing.assert_array_equal(curve(series, axis.upper()), [windy.time, getattr(windy.record("wind"), axis)])
        (line,) = [line for line in series.lines if line.get_label() == axis.upper()]
        assert to_hex(line.get_color()) == color.lower()


def cell_centres(mesh):
    """Return the horizontal and vertical coordinates of the centres of a mesh's cells, (rows, columns) each, m."""
    return np.moveaxis(0.5 * (mesh.get_coordinates()[:-1, :-1] + mesh.get_coordinates()[1:, 1:]), -1, 0)


def mean_speed(flight, x, y, z):
    """Return the speed of the steady wind and the fans at given positions, m/s."""
    rows = np.broadcast_arrays(x, y, z)
    zeros = np.zeros_like(rows[0])
    velocity = [zeros + part for part in (0.3, -0.2, 0.1)]
    for jet in jets(flight.scenario.laboratory.wind):
        speed, _ = jet_speed(State(*rows, *[zeros] * 9), jet)
        velocity = [each + speed * part for each, part in zip(velocity, jet.direction, strict=True)]
    return np.linalg.norm(velocity, axis=0)


@pytest.mark.slow
def test_maps_show_the_mean_wind_in_a_horizontal_and_a_vertical_plane(windy):
    """The fan blows along its axis; far from the fan, there is only the steady wind."""
    figure = plot_wind(windy)
    above, side, *_ = figure.axes
    reference, state = windy.record("reference"), windy.record("state")
    long, short = ("y", "x") if side.get_xlabel() == "Y (m)" else ("x", "y")
    assert (above.get_xlabel(), above.get_ylabel()) == ("X (m)", "Y (m)")
    assert (side.get_xlabel(), side.get_ylabel()) == (f"{long.upper()} (m)", "Z (m)")
    # The planes pass through the outlet of the fan.
    assert above.get_title(loc="left") == "From above: wind at Z = 1.1 m"
    level = {"x": -2.0, "y": 0.3}[short]
    assert side.get_title(loc="left") == f"From the side: wind at {short.upper()} = {level:.1f} m".replace("-", "−")
    tops = [float(axes.collections[0].get_array().max()) for axes in (above, side)]
    for axes, across, up in ((above, "x", "y"), (side, long, "z")):
        mesh = axes.collections[0]
        position = {"x": -2.0, "y": 0.3, "z": 1.1} | {across: cell_centres(mesh)[0], up: cell_centres(mesh)[1]}
        np.testing.assert_allclose(np.asarray(mesh.get_array()), mean_speed(windy, **position), atol=1e-9)
        assert (mesh.norm.vmin, mesh.norm.vmax) == (0.0, max(tops))
        np.testing.assert_array_equal(curve(axes, "reference"), [getattr(reference, across), getattr(reference, up)])
        np.testing.assert_array_equal(curve(axes, "flown"), [getattr(state, across), getattr(state, up)])
        # The map contains the path, the fan and a margin, but nothing below the ground.
        corners = mesh.get_coordinates()
        for position, axis in ((0, across), (1, up)):
            ends = [*getattr(state, axis), *getattr(reference, axis), {"x": -2.0, "y": 0.3, "z": 1.1}[axis]]
            low = max(min(ends) - 0.7, 0.0) if axis == "z" else min(ends) - 0.7
            assert corners[..., position].min() == pytest.approx(low, abs=0.02)
            assert corners[..., position].max() == pytest.approx(max(ends) + 0.7, abs=0.03)
    # The vertical plane contains the longer side of the region.
    lengths = np.ptp(above.collections[0].get_coordinates(), axis=(0, 1))
    assert long == "xy"[int(np.argmax(lengths))]
    # The figure is about as high as both maps in its full width.
    width, height = figure.get_size_inches()
    maps_height = sum(width * np.ptp(axes.get_ylim()) / np.ptp(axes.get_xlim()) for axes in (above, side))
    assert height == pytest.approx(maps_height, rel=0.15)


def test_a_fan_is_a_bar_across_its_direction(windy):
    above, *_ = plot_wind(windy).axes
    (bar,) = [line for line in above.lines if len(line.get_xdata()) == 2]
    ends = bar.get_xydata()
    np.testing.assert_allclose(ends.mean(axis=0), [-2.0, 0.3], atol=1e-9)
    along = np.diff(ends, axis=0)[0]
    assert np.linalg.norm(along) == pytest.approx(0.6)
    assert along @ [0.92106, 0.38942] == pytest.approx(0.0, abs=1e-9)


def test_arrows_have_the_direction_of_the_wind(windy):
    """Each arrow shows the velocity at its position. The longest arrow ends at the start of the next one."""
    above, *_ = plot_wind(windy).axes
    arrows, mesh = above.collections[1], above.collections[0]
    speeds = np.hypot(arrows.U, arrows.V)
    spacing = np.diff(np.unique(arrows.X)).min()
    wind_speeds = np.hypot(speeds, 0.1)
    np.testing.assert_allclose(wind_speeds, mean_speed(windy, x=arrows.X, y=arrows.Y, z=1.1))
    # There are no arrows where the wind is negligible. The other arrows are evenly spaced.
    assert wind_speeds.min() > 0.03 * mesh.get_array().max()
    assert len(np.unique(arrows.X)) == pytest.approx(30, abs=1)
    assert speeds.max() / arrows.scale == pytest.approx(spacing, rel=0.15)
    # Far from the fan, there is only the steady wind.
    far = np.argmin(speeds)
    assert (arrows.U[far], arrows.V[far]) == pytest.approx((0.3, -0.2), abs=0.05)


@pytest.mark.parametrize(
    ("velocity", "words", "plane"),
    [
        ((3.0, 4.0, 0.0), "5.0 m/s from 233° to 53° (0° is X, 90° is Y)", "xy"),
        ((0.0, -2.0, 0.0), "2.0 m/s from 90° to 270° (0° is X, 90° is Y)", "xy"),
        ((0.0, 0.0, -1.5), "1.5 m/s downwards", "xz"),
        ((1.0, 0.0, 2.0), "1.0 m/s from 180° to 0° (0° is X, 90° is Y) and 2.0 m/s upwards", "xz"),
    ],
)
def test_a_uniform_wind_is_drawn_as_arrows_with_its_speed_and_direction(velocity, words, plane):
    """There is no map, which would be an area of a single colour."""
    wind = f"laboratory.wind=[{{kind: steady, velocity: {list(velocity)}}}]"
    flight = simulate(load_scenario("hover", ["duration=0.2", wind]))
    figure = plot_wind(flight)
    assert figure.get_suptitle() == f"Uniform mean wind: {words}"
    path, series = figure.axes
    assert (path.get_xlabel(), path.get_ylabel()) == tuple(f"{axis.upper()} (m)" for axis in plane)
    (arrows,) = path.collections
    along = dict(zip("xyz", velocity, strict=True))
    np.testing.assert_array_equal(np.unique(arrows.U), along[plane[0]])
    np.testing.assert_array_equal(np.unique(arrows.V), along[plane[1]])
    state = flight.record("state")
    np.testing.assert_array_equal(curve(path, "flown"), [getattr(state, axis) for axis in plane])
    assert path.get_title(loc="left") == ("From above" if plane == "xy" else "From the side")
    assert series.get_title(loc="left") == "At the vehicle"


def test_views_from_above_have_x_to_the_right_and_y_up(flight):
    """This is also the case if the region is longer along Y."""
    fan = "laboratory.wind=[{kind: fan, position: [0, -5, 1], direction: [0, 1, 0], flow: 1.0, diameter: 0.6}]"
    tall = simulate(load_scenario("hover", ["duration=0.2", fan]))
    for axes in (plot_wind(tall).axes[0], plots.plot_path(flight).axes[1]):
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("X (m)", "Y (m)")
        assert axes.get_xlim()[0] < axes.get_xlim()[1]
        assert axes.get_ylim()[0] < axes.get_ylim()[1]


def test_a_flight_in_still_air_has_no_wind_map(flight):
    flight_without_wind = simulate(load_scenario("hover", ["duration=0.1"]))
    (axes,) = plot_wind(flight_without_wind).axes
    assert axes.get_ylim() == (-1.0, 1.0)
    np.testing.assert_array_equal(curve(axes, "X")[1], 0.0)
    # A wind with only negative components counts as wind.
    flight_with_wind = replace(
        flight_without_wind,
        signals={**flight_without_wind.signals, "wind": np.full_like(flight_without_wind["wind"], -3.0)},
    )
    (axes,) = plot_wind(flight_with_wind).axes
    assert axes.get_ylim()[0] < -3.0
