"""Tests that the figures of the replication show the results of invented experiments and short flights."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from invented_experiment import invented_experiment
from matplotlib.colors import to_hex

from drake_quad import load_scenario, simulate
from drake_quad.control.fuzzy.inference import elliptic_membership
from drake_quad.replication import figures
from drake_quad.replication.baseline_comparison import COMPARED_CONTROLLERS
from drake_quad.replication.claims import advantage
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, published_table
from drake_quad.replication.report import CAPTIONS
from drake_quad.replication.sweeps import NOISE_LEVELS, Q_VALUES
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import values_without_crashes
from drake_quad.visualization.leg_marks import leg_marks
from drake_quad.visualization.positions import positions

NUM_SAMPLES = 40  # samples of each cell of Table II


def load(cell, overrides=()):
    return load_scenario(f"diagrams/paper.yaml:{cell.scenario}", overrides)


@pytest.fixture(scope="module")
def experiment():
    experiment = invented_experiment(NUM_SAMPLES, crashes=0.1)
    for sweep in experiment.maps.values():
        sweep.metrics.crash_time[:] = np.inf
    scatter = np.random.default_rng(7).uniform(0.9, 1.1, 4)
    experiment.maps["pd"].metrics.rmse[:] = np.outer([0.2, 0.1, 0.4, 0.15, 0.8, 9.0], scatter)
    experiment.maps["pd"].metrics.crash_time[2, 3] = 4.0
    return experiment


@pytest.fixture(scope="module")
def flights():
    """Return flights of six seconds, one of which crashes in high wind after four seconds."""
    cells = [Cell("no_wind", name) for name in ("pd", "pd_t2fnn")] + [Cell("high_wind", name) for name in CONTROLLERS]
    flown = {cell: simulate(load(cell, ["duration=6"])) for cell in cells}
    crashed = Cell("high_wind", "pd_t2fnn_wide")
    full_flight = flown[crashed]
    signals = {name: rows[:200] for name, rows in full_flight.signals.items()}
    return flown | {crashed: replace(full_flight, time=full_flight.time[:200], signals=signals)}


def points_with_marker(axes, marker):
    """Return the points of each line with a marker."""
    return [line.get_xydata() for line in axes.lines if line.get_marker() == marker]


def legend_of(figure):
    """Return the handles of a figure's legend by their labels."""
    (legend,) = figure.legends
    return dict(zip((text.get_text() for text in legend.texts), legend.legend_handles, strict=True))


@pytest.mark.long
def test_figures_are_in_the_order_of_the_report(experiment, flights):
    every = flights | {Cell("low_wind", name): flights[Cell("high_wind", name)] for name in CONTROLLERS}
    drawn_figures = dict(figures.paper_figures(experiment, every))
    assert list(drawn_figures) == [*CAPTIONS]
    for number, wind in ((9, "no_wind"), (10, "low_wind"), (11, "high_wind")):
        error = drawn_figures[f"figure_{number}"].axes[0].lines[0].get_ydata()
        np.testing.assert_array_equal(error, every[Cell(wind, "pd")].euclidean_error)
    labels = {
        name: [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes] for name, figure in drawn_figures.items()
    }
    errors = [("", "Euclidean error (m)"), ("time (s)", "difference from\ntype 1 (mm)")]
    assert labels == {
        "table_ii": [("", ""), ("", ""), ("RMSE (m)", "")],
        "figure_4": [("", "membership"), ("", ""), ("(x - c) / d", "membership"), ("(x - c) / d", "")],
        "figure_7": [("X (m)", "Y (m)")],
        "figure_8": [("X (m)", "Y (m)")],
        "figure_9": [("time (s)", "Euclidean error (m)")],
        "figure_10": errors,
        "figure_11": errors,
        "figure_12": [("time (s)", "command on X (m/s²)")],
        "figure_13": [("time (s)", "command on Y (m/s²)")],
        "advantage": [("noise of the cameras (mm)", "reduction of the RMSE"), ("q", "")],
        "gains": [("$k_D$ (1/s)", "$k_P$ (1/s²)"), ("$k_D$ (1/s)", ""), ("", "RMSE (m)")],
        "fair": [("mean RMSE (m)", "")],
    }
    for name, figure in drawn_figures.items():
        labels_of_curves = figure.axes[0].get_legend_handles_labels()[1]
        assert name in ("table_ii", "gains") or list(legend_of(figure)) == labels_of_curves
        assert len(legend_of(figure)) >= 2


def test_the_figure_of_table_ii_shows_printed_runs_with_their_means_and_our_results(experiment):
    figure = figures.table_figure(experiment)
    for axes, (wind, words) in zip(figure.axes, WINDS.items(), strict=True):
        assert axes.get_title(loc="left") == words
        assert [text.get_text() for text in axes.get_yticklabels()] == list(CONTROLLERS.values())
        our_means, bars = points_with_marker(axes, "D"), [line for line in axes.lines if line.get_alpha()]
        runs, means = iter(points_with_marker(axes, "o")), iter(points_with_marker(axes, "s"))
        for row, name in enumerate(CONTROLLERS):
            errors = values_without_crashes(experiment.cells[Cell(wind, name)].metrics, "rmse")
            np.testing.assert_allclose(our_means[row], [[errors.mean(), row + 0.17]])
            low, high = np.sort(errors)[0], np.sort(errors)[-1]
            (x_low, y), (x_high, _) = bars[row].get_xydata()
            assert low <= x_low < errors.mean() < x_high <= high
            assert ((errors >= x_low) & (errors <= x_high)).mean() == pytest.approx(0.95, abs=1.5 / len(errors))
            assert y == row + 0.17
            if Cell(wind, name) in published_table():
                line = published_table()[Cell(wind, name)].rmse
                np.testing.assert_allclose(next(runs), [[run, row - 0.17] for run in line.runs])
                np.testing.assert_allclose(next(means), [[line.mean, row - 0.17]])
        assert next(runs, None) is next(means, None) is None
        assert axes.get_ylim() == (3.5, -0.5)
        # The axis contains all values that the paper prints, and all values of the committed report.
        assert axes.get_xlim() == (0.4, 1.1)
    handles = legend_of(figure)
    lines_by_marker = {line.get_marker(): line for line in figure.axes[0].lines}
    for words, marker in (("printed runs", "o"), ("printed mean", "s"), ("ours, mean", "D")):
        handle = handles.pop(words)
        assert handle.get_marker() == marker
        assert handle.get_color() == lines_by_marker[marker].get_color()
        assert handle.get_linestyle() == "None"
    (bar,) = handles.values()
    assert bar.get_color() == lines_by_marker["D"].get_color()


def test_memberships_of_an_elliptic_set_agree_with_the_paper_s_figure_4():
    figure = figures.figure_4()
    pairs = ((1.0, 1.0), (1.2, 0.8), (1.4, 0.6), (1.6, 0.4))
    for axes, (a1, a2) in zip(figure.axes, pairs, strict=True):
        upper, lower = axes.lines
        assert axes.get_title() == f"$a_1$ = {a1:g}, $a_2$ = {a2:g}"
        for line, a in ((upper, a1), (lower, a2)):
            u = line.get_xdata()
            np.testing.assert_allclose(line.get_ydata(), elliptic_membership(u, a))
            assert line.get_ydata().max() == pytest.approx(1.0)
            assert (line.get_ydata()[np.abs(u) >= 1.0] == 0.0).all()
            assert u.min() < -1.0
            assert u.max() > 1.0
        # The area between the lower and the upper membership is shaded.
        (area,) = axes.collections
        edge = area.get_paths()[0].vertices
        assert edge[:, 1].max() == pytest.approx(1.0)
        middle = np.abs(np.abs(edge[:, 0]) - 0.5) < 1e-9
        heights = np.unique(edge[middle, 1].round(9))
        np.testing.assert_allclose(
            heights, np.unique(elliptic_membership(np.array([0.5]), np.array([a2, a1])).round(9))
        )
    assert [line.get_text() for line in figure.legends[0].texts] == ["upper, $a_1$", "lower, $a_2$"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["membership", "", "membership", ""]
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "", "(x - c) / d", "(x - c) / d"]


def test_paths_without_wind_are_shown_in_space_and_from_above(flights):
    names = ["reference", CONTROLLERS["pd"], CONTROLLERS["pd_t2fnn"]]
    network_flight = flights[Cell("no_wind", "pd_t2fnn")]
    expected = [positions(network_flight.record("reference"))]
    expected += [positions(flights[Cell("no_wind", name)].record("state")) for name in ("pd", "pd_t2fnn")]
    space, above = figures.figure_7(flights), figures.figure_8(flights)
    for figure, count in ((space, 3), (above, 2)):
        (axes,) = figure.axes
        for line, path in zip(axes.lines, expected, strict=True):
            coordinates = line.get_data_3d() if count == 3 else line.get_data()
            np.testing.assert_allclose(coordinates, path.T[:count])
        assert list(legend_of(figure)) == names == [line.get_label() for line in axes.lines]
    assert above.axes[0].get_aspect() == 1.0
    # Vertical legs have no number in the view from above.
    leg_numbers = [str(mark.number) for mark in leg_marks(network_flight.plan) if np.any(mark.right)]
    assert [text.get_text() for text in above.axes[0].texts] == leg_numbers
    numbers = {text.get_text(): text.get_position_3d() for text in space.axes[0].texts}
    path = network_flight.plan.derivative(0)
    ends = [*network_flight.plan.leg_times, network_flight.plan.path.times[-1]]
    assert list(numbers) == [str(i) for i in range(1, len(ends))]
    for i, (start, end) in enumerate(pairwise(ends), start=1):
        offset = np.subtract(numbers[str(i)], path.value(0.5 * (start + end))[:, 0])
        assert offset[2] == 0.0
        assert np.linalg.norm(offset) == pytest.approx(0.35) or not offset.any()
    # The box has the proportions of the route, with at least 1.5 m on each side.
    aspect = space.axes[0]._box_aspect
    extent = np.maximum(np.ptp(expected[0], axis=0), 1.5)
    np.testing.assert_allclose(aspect / aspect[0], extent / extent[0])


def test_errors_in_wind_are_shown_until_the_crash_and_compared_with_type_1(flights):
    figure = figures.FLIGHT_FIGURES["figure_11"](flights)
    upper, lower = figure.axes
    errors = {name: flights[Cell("high_wind", name)].euclidean_error for name in CONTROLLERS}
    time = flights[Cell("high_wind", "pd")].time
    curves = {line.get_label(): line for line in upper.lines}
    assert len(errors["pd_t2fnn_wide"]) == 200
    for name, error in errors.items():
        np.testing.assert_allclose(curves[CONTROLLERS[name]].get_data(), [time[: len(error)], error])
    *differences, zero = lower.lines
    for line, name in zip(differences, ("pd_t2fnn", "pd_t2fnn_wide"), strict=True):
        count = len(errors[name])
        difference = 1000.0 * (errors[name] - errors["pd_t1fnn"][:count])
        np.testing.assert_allclose(line.get_data(), [time[:count], difference])
        assert line.get_color() == curves[CONTROLLERS[name]].get_color()
    assert set(zero.get_ydata()) == {0.0}
    assert (upper.get_xlabel(), lower.get_xlabel()) == ("", "time (s)")
    assert lower.get_xlim() == (0.0, time[-1])
    levels = [line for line in upper.lines if line.get_marker() == "<" and len(line.get_xdata())]
    printed = {name: published_table()[Cell("high_wind", name)].rmse.mean for name in CONTROLLERS}
    printed = {name: level for name, level in printed.items() if np.isfinite(level)}
    for line, (name, level) in zip(levels, printed.items(), strict=True):
        assert line.get_ydata()[0] == level
        assert line.get_color() == curves[CONTROLLERS[name]].get_color()
        assert line.get_xdata()[0] > 1.0
        assert level < upper.get_ylim()[1]
    # Markers of similar levels are drawn side by side.
    assert len({line.get_xdata()[0] for line in levels[1:]}) == len(printed) - 1 >= 2
    assert list(legend_of(figure)) == [*CONTROLLERS.values(), "mean RMSE in Table II"]


def test_errors_in_wind_are_shown_even_if_the_first_controller_crashes(flights):
    """The time axis covers the longest flight."""
    pd = Cell("high_wind", "pd")
    time = flights[pd].time
    signals = {name: rows[:100] for name, rows in flights[pd].signals.items()}
    figure = figures.FLIGHT_FIGURES["figure_11"](flights | {pd: replace(flights[pd], time=time[:100], signals=signals)})
    curves = {line.get_label(): line for line in figure.axes[0].lines}
    assert len(curves[CONTROLLERS["pd"]].get_xdata()) == 100
    np.testing.assert_array_equal(curves[CONTROLLERS["pd_t1fnn"]].get_xdata(), time)


def test_errors_without_wind_are_shown_with_the_printed_peaks(flights):
    figure = figures.FLIGHT_FIGURES["figure_9"](flights)
    (axes,) = figure.axes
    levels = [line for line in axes.lines if line.get_marker() == "<" and len(line.get_xdata())]
    assert [line.get_ydata()[0] for line in levels] == [1.3, 0.8]
    assert {line.get_xdata()[0] for line in levels} == {1.025}
    assert axes.get_ylim()[0] == 0.0
    assert axes.get_ylim()[1] > 1.3
    assert list(legend_of(figure))[-1] == "peak in the paper's Fig. 9"
    highest = max(flights[Cell("no_wind", name)].euclidean_error.max() for name in ("pd", "pd_t2fnn"))
    numbers = [text for text in axes.texts if text.get_text().isdigit()]
    assert len(numbers) >= 2
    for text in numbers:
        bottom, top = axes.get_ylim()
        assert bottom + text.xy[1] * (top - bottom) > highest


def test_commands_of_pd_and_network_add_up_to_the_command(flights):
    flight = flights[Cell("no_wind", "pd_t2fnn")]
    for name, axis in (("figure_12", "x"), ("figure_13", "y")):
        (axes,) = figures.FLIGHT_FIGURES[name](flights).axes
        pd, network = axes.lines[:2]
        command = getattr(flight.record("acceleration_command"), axis)
        np.testing.assert_allclose(pd.get_ydata() + network.get_ydata(), command, atol=1e-9)
        np.testing.assert_allclose(pd.get_ydata(), getattr(flight.record("pd"), axis))
        np.testing.assert_allclose(pd.get_xdata(), flight.time)
        assert (pd.get_label(), network.get_label()) == (r"PD, $\tau_c$", r"network, $-\tau_f$")


def test_bars_of_the_comparison_with_other_controllers_are_mean_errors(experiment):
    figure = figures.fair_figure(experiment)
    (axes,) = figure.axes
    heights = []
    for container, (wind, words) in zip(axes.containers, WINDS.items(), strict=True):
        assert container.get_label() == words
        for row, (name, bar) in enumerate(zip(COMPARED_CONTROLLERS, container, strict=True)):
            mean = mean_interval(values_without_crashes(experiment.cells[Cell(wind, name)].metrics, "rmse")).value
            assert bar.get_width() == pytest.approx(mean)
            heights.append((bar.get_y() + 0.5 * bar.get_height() - row, bar.get_height()))
            (text,) = (
                text for text in axes.texts if text.xy == (mean, pytest.approx(bar.get_y() + 0.5 * bar.get_height()))
            )
            assert text.get_text() == f"{mean:.2f}"
            assert mean < axes.get_xlim()[1]
    assert [text.get_text() for text in axes.get_yticklabels()] == list(COMPARED_CONTROLLERS.values())
    # The bars of a controller are in the order of the winds, and do not overlap the bars of the next controller.
    offsets = sorted({round(offset, 9) for offset, _ in heights})
    assert len(offsets) == 3
    height = heights[0][1]
    assert min(np.diff(offsets)) > height
    assert offsets[-1] - offsets[0] + height < 1.0
    assert axes.get_xlim()[0] == 0.0
    assert axes.get_ylim() == (len(COMPARED_CONTROLLERS) - 0.5, -0.5)
    colors = [container[0].get_facecolor() for container in axes.containers]
    assert len({to_hex(color) for color in colors}) == 3


def test_advantages_of_type_2_are_shown_with_their_intervals(experiment):
    figure = figures.advantage_figure(experiment)
    sweeps = (("noise", experiment.noise, NOISE_LEVELS, 1000.0), ("q", experiment.q, Q_VALUES, 1.0))
    for axes, (number, sweep, values, size) in zip(figure.axes, sweeps, strict=True):
        for container, name in zip(axes.containers, ("pd_t2fnn", "pd_t2fnn_wide"), strict=True):
            gains = [advantage(sweep, number, value, name) for value in values]
            curve, _, (bars,) = container
            assert container.get_label() == CONTROLLERS[name]
            x = size * np.array(values)
            np.testing.assert_allclose(curve.get_data(), [x, [gain.value for gain in gains]])
            for abscissa, bar, gain in zip(x, bars.get_segments(), gains, strict=True):
                np.testing.assert_allclose(bar, [[abscissa, gain.low], [abscissa, gain.high]])
        (band,) = axes.patches
        assert [band.get_y(), band.get_y() + band.get_height()] == pytest.approx([0.02, 0.07])
        assert any(set(line.get_ydata()) == {0.0} for line in axes.lines)
    markers = [container[0].get_marker() for container in figure.axes[0].containers]
    assert len(set(markers)) == 2
    left = figure.axes[0]
    assert left.yaxis.get_major_formatter()(0.05, 0).startswith("5")


def test_the_map_of_gains_is_grey_where_a_sample_crashes(experiment):
    figure = figures.gain_figure(experiment)
    *maps, bar = figure.axes
    rmse = experiment.maps["pd"].metrics.rmse.mean(axis=1).reshape(3, 2)
    rmse[1, 0] = np.nan
    for axes, name in zip(maps, ("pd", "pd_t2fnn"), strict=True):
        shades = axes.collections[0]
        if name == "pd":
            np.testing.assert_allclose(np.ma.filled(shades.get_array(), np.nan), rmse)
            # Each pair of gains is in its cell: k_D is horizontal, and k_P is vertical.
            corners = shades.get_coordinates()
            for edges, gains in ((corners[0, :, 0], [0.5, 1.0]), (corners[:, 0, 1], [1.0, 2.0, 4.0])):
                assert np.searchsorted(edges, gains).tolist() == [*range(1, len(edges))]
            min_rmse = np.nanmin(rmse)
            # The colour scale ends at sixteen times the smallest error.
            assert (shades.norm.vmin, shades.norm.vmax) == pytest.approx((min_rmse, 16.0 * min_rmse))
            contour = axes.collections[1]
            assert contour.levels == pytest.approx([1.2 * min_rmse])
        (star,) = (line for line in axes.lines if line.get_marker() == "*")
        position = load(Cell("no_wind", "pd")).control.position
        assert star.get_xydata().tolist() == [[position.k_d[0], position.k_p[0]]]
        assert axes.get_title() == CONTROLLERS[name]
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        for axis in (axes.xaxis, axes.yaxis):
            assert list(map(axis.get_major_formatter(), (0.5, 10.0))) == ["0.5", "10"]
            assert axis.get_ticklocs().tolist() == [0.5, 1.0, 2.0, 5.0, 10.0]
            assert not len(axis.get_minorticklocs())
    ticks = bar.get_yticks()
    np.testing.assert_allclose(ticks, [each for each in (0.1, 0.2, 0.5, 1.0) if min_rmse <= each <= 16.0 * min_rmse])
    assert len(ticks) >= 3
    assert not len(bar.yaxis.get_minorticklocs())
    assert bar.yaxis.get_major_formatter()(0.5) == "0.5"
    handles = legend_of(figure)
    assert list(handles) == ["within 20 % of the best", "calibrated", "crash"]
    assert handles["crash"].get_facecolor() == maps[0].get_facecolor()


def test_panels_share_their_axes(experiment, flights):
    grid = figures.figure_4().axes
    for figure, x, y in (
        (grid, True, True),
        (figures.table_figure(experiment).axes, True, False),
        (figures.FLIGHT_FIGURES["figure_11"](flights).axes, True, False),
        (figures.advantage_figure(experiment).axes, False, True),
        (figures.gain_figure(experiment).axes[:2], False, True),
    ):
        for one, other in pairwise(figure):
            assert one.get_shared_x_axes().joined(one, other) == x
            assert one.get_shared_y_axes().joined(one, other) == y


def test_bars_end_within_their_axis(experiment):
    (axes,) = figures.fair_figure(experiment).axes
    longest = max(bar.get_width() for container in axes.containers for bar in container)
    assert 1.05 * longest < axes.get_xlim()[1] < 1.4 * longest


def test_leg_numbers_are_centred_at_the_top(flights):
    flight = flights[Cell("no_wind", "pd_t2fnn")]
    last = flight.time[-1]
    ends = [*(time for time in flight.plan.leg_times if time < last), last]
    for figure in (figures.FLIGHT_FIGURES["figure_9"](flights), figures.FLIGHT_FIGURES["figure_12"](flights)):
        (axes,) = figure.axes
        numbers = [text for text in axes.texts if text.get_text().isdigit()]
        np.testing.assert_allclose([text.xy[0] for text in numbers], [0.5 * sum(pair) for pair in pairwise(ends)])
        assert all(0.88 < text.xy[1] < 1.0 for text in numbers)
        assert axes.get_xlim() == (0.0, last)
    # The leg numbers are in the top tenth of the axes. All curves stay below them.
    bottom, top = axes.get_ylim()
    highest = max(line.get_ydata().max() for line in axes.lines if len(line.get_ydata()) == len(flight.time))
    assert 0.82 < (highest - bottom) / (top - bottom) < 0.92
