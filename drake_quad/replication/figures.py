"""Figures of the replication's report: the paper's figures and further figures, each as wide as a journal column."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullLocator, PercentFormatter

from drake_quad.control.fuzzy.inference import elliptic_membership
from drake_quad.flight.flight import Flight
from drake_quad.replication.baseline_comparison import COMPARED_CONTROLLERS
from drake_quad.replication.claims import advantage
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, published_table
from drake_quad.replication.results import MAPPED_CONTROLLERS, Experiment
from drake_quad.replication.sweeps import NOISE_LEVELS, Q_VALUES, Sweep
from drake_quad.reports.figures import print_panels
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import values_without_crashes
from drake_quad.visualization.learning_plots import PAPER_EXPONENTS
from drake_quad.visualization.leg_marks import leg_marks, number_legs, shade_legs
from drake_quad.visualization.panels import legend_above, name_rows, plot_intervals
from drake_quad.visualization.positions import positions
from drake_quad.visualization.style import (
    BLACK,
    BLUE,
    GREEN,
    LIMIT,
    ORANGE,
    PURPLE,
    REFERENCE,
    VERMILION,
    shading,
)

Flights = Mapping[Cell, Flight]

_LINE_STYLES = {
    "pd": (BLUE, "-"),
    "pd_t1fnn": (GREEN, "-."),
    "pd_t2fnn": (VERMILION, "-"),
    "pd_t2fnn_wide": (PURPLE, "--"),
}
# Peak errors read from the paper's Fig. 9, m.
_PUBLISHED_PEAKS = {"pd": 1.3, "pd_t2fnn": 0.8}


def paper_figures(experiment: Experiment, flights: Flights) -> Iterator[tuple[str, Figure]]:
    """Draw the figures one after another.

    Args:
        experiment: results of the experiment.
        flights: sample 0 of each cell of Table II.

    Yields:
        The name of each figure in the report, and the figure.
    """
    yield "table_ii", table_figure(experiment)
    yield "figure_4", figure_4()
    for name, draw in FLIGHT_FIGURES.items():
        yield name, draw(flights)
    yield "advantage", advantage_figure(experiment)
    yield "gains", gain_figure(experiment)
    yield "fair", fair_figure(experiment)


def figure_4() -> Figure:
    """Plot the memberships of an elliptic set for four pairs of exponents."""
    u: Any = np.linspace(-1.2, 1.2, 481)
    with print_panels(2.9, 2, 2, sharex=True, sharey=True) as (figure, grid):
        for axes, (a1, a2) in zip(grid.flat, PAPER_EXPONENTS, strict=True):
            upper, lower = elliptic_membership(u, a1), elliptic_membership(u, a2)
            axes.fill_between(u, lower, upper, color=shading()(0.5), linewidth=0)
            axes.plot(u, upper, color=BLUE, label="upper, $a_1$")
            axes.plot(u, lower, color=VERMILION, linestyle="--", label="lower, $a_2$")
            axes.set_title(f"$a_1$ = {a1:g}, $a_2$ = {a2:g}")
        for axes in grid[1]:
            axes.set_xlabel("(x - c) / d")
        for axes in grid[:, 0]:
            axes.set_ylabel("membership")
        legend_above(figure, grid[0, 0], 2)
        return figure


def figure_7(flights: Flights) -> Figure:
    """Plot the paths of PD and PD+T2FNN without wind in three dimensions."""
    with print_panels(2.7, subplot_kw={"projection": "3d"}) as (figure, axes):
        reference = positions(_complete_flight(flights).record("reference")).T
        axes.plot(*reference, label="reference", **REFERENCE)
        for name in ("pd", "pd_t2fnn"):
            path = positions(flights[Cell("no_wind", name)].record("state")).T
            axes.plot(*path, **_style(name), label=CONTROLLERS[name])
        for number, position, normal in leg_marks(_complete_flight(flights).plan):
            x, y, z = position + 0.35 * np.array([*normal, 0.0])
            axes.text(x, y, z, str(number), color="0.2", fontsize=8, fontweight="bold", ha="center", va="center")
        axes.set(xlabel="X (m)", ylabel="Y (m)", zlabel="Z (m)")
        axes.set_box_aspect(np.maximum(np.ptp(reference, axis=1), 1.5), zoom=1.0)
        axes.view_init(elev=28.0, azim=-38.0)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_major_locator(MaxNLocator(4))
            axis.labelpad = -5.0
        axes.tick_params(pad=-2.0)
        axes.yaxis.labelpad = 0.0
        axes.zaxis.labelpad = -7.0
        legend_above(figure, axes, 3, columnspacing=1.0)
        return figure


def figure_8(flights: Flights) -> Figure:
    """Plot the paths of PD and PD+T2FNN without wind from above."""
    with print_panels(4.6) as (figure, axes):
        flight = _complete_flight(flights)
        reference = flight.record("reference")
        axes.plot(reference.x, reference.y, label="reference", **REFERENCE)
        for name in ("pd", "pd_t2fnn"):
            state = flights[Cell("no_wind", name)].record("state")
            axes.plot(state.x, state.y, **_style(name), label=CONTROLLERS[name])
        number_legs(axes, flight.plan, distance=17.0)
        axes.set(xlabel="X (m)", ylabel="Y (m)")
        axes.set_aspect("equal")
        axes.margins(0.08)
        legend_above(figure, axes, 3, columnspacing=1.0)
        return figure


def errors_figure(
    flights: Flights, wind: str, controllers: Sequence[str], levels: Mapping[str, float], caption: str
) -> Figure:
    """Plot errors over time. If type 1 is one of the controllers, plot the differences between type 2 and type 1, too.

    Args:
        flights: sample 0 of each cell of Table II.
        wind: name of the wind.
        controllers: names of the controllers.
        levels: printed error of each controller, m, which is marked next to the axes.
        caption: legend entry for the printed errors.
    """
    errors = {name: flights[Cell(wind, name)].euclidean_error for name in controllers}
    time = max((flights[Cell(wind, name)].time for name in controllers), key=len)
    is_compared = "pd_t1fnn" in errors
    grid: dict[str, Any] = {"sharex": True, "height_ratios": [2, 1] if is_compared else [2]}
    with print_panels(3.8 if is_compared else 2.6, 2 if is_compared else 1, 1, **grid) as (figure, column):
        (axes,), *more = column
        for name, error in errors.items():
            axes.plot(time[: len(error)], error, **_style(name), label=CONTROLLERS[name])
        # The markers are beside the axes and offset from each other, so that similar levels can be distinguished.
        transform = axes.get_yaxis_transform()
        for index, (name, level) in enumerate(levels.items()):
            x = 1.025 + (0.03 * (index - 1) if len(levels) > 2 and index else 0.0)
            axes.plot(x, level, "<", color=_LINE_STYLES[name][0], markersize=4, transform=transform, clip_on=False)
        axes.set(ylabel="Euclidean error (m)")
        axes.set_ylim(0.0, 1.02 * max(axes.get_ylim()[1], max(levels.values())))
        _shade_legs(axes, _complete_flight(flights))
        axes.plot([], [], linestyle="none", marker="<", color="0.4", markersize=4, label=caption)
        for (lower,) in more:
            for name in ("pd_t2fnn", "pd_t2fnn_wide"):
                count = min(len(errors[name]), len(errors["pd_t1fnn"]))
                difference = 1e3 * (errors[name][:count] - errors["pd_t1fnn"][:count])
                lower.plot(time[:count], difference, **_style(name))
            lower.axhline(0.0, **LIMIT)
            lower.set_ylabel("difference from\ntype 1 (mm)")
        figure.axes[-1].set_xlabel("time (s)")
        legend_above(figure, axes, 2, columnspacing=1.0)
        return figure


def errors_in_wind(flights: Flights, wind: str) -> Figure:
    """Plot the Euclidean errors of all controllers in a wind, with the mean RMSE of Table II."""
    means = {name: published_table()[Cell(wind, name)].rmse.mean for name in CONTROLLERS}
    levels = {name: mean for name, mean in means.items() if np.isfinite(mean)}
    return errors_figure(flights, wind, tuple(CONTROLLERS), levels, "mean RMSE in Table II")


def _style(name: str) -> dict[str, Any]:
    color, style = _LINE_STYLES[name]
    return {"color": color, "linestyle": style}


def commands_figure(flights: Flights, axis: str) -> Figure:
    """Plot the commands of PD and network on one axis, without wind."""
    with print_panels(2.6) as (figure, axes):
        flight = flights[Cell("no_wind", "pd_t2fnn")]
        pd, correction = (getattr(flight.record(name), axis) for name in ("pd", "correction"))
        axes.plot(flight.time, pd, color=BLUE, label=r"PD, $\tau_c$")
        axes.plot(flight.time, -correction, color=VERMILION, label=r"network, $-\tau_f$")
        axes.set(xlabel="time (s)", ylabel=f"command on {axis.upper()} (m/s²)")
        _shade_legs(axes, flight)
        legend_above(figure, axes, 2)
        return figure


# Functions that draw the paper's figures of single flights, keyed by the name of the figure.
FLIGHT_FIGURES: dict[str, Callable[[Flights], Figure]] = {
    "figure_7": figure_7,
    "figure_8": figure_8,
    "figure_9": partial(
        errors_figure,
        wind="no_wind",
        controllers=("pd", "pd_t2fnn"),
        levels=_PUBLISHED_PEAKS,
        caption="peak in the paper's Fig. 9",
    ),
    "figure_10": partial(errors_in_wind, wind="low_wind"),
    "figure_11": partial(errors_in_wind, wind="high_wind"),
    "figure_12": partial(commands_figure, axis="x"),
    "figure_13": partial(commands_figure, axis="y"),
}


def table_figure(experiment: Experiment) -> Figure:
    """Plot the errors of Table II: the printed runs and their mean, and the mean and 95 % range of our samples."""
    runs: Any = {"linestyle": "none", "marker": "o", "color": "0.6", "markersize": 3.2, "label": "printed runs"}
    mean: Any = {"linestyle": "none", "marker": "s", "color": BLACK, "markersize": 5.5, "fillstyle": "none"}
    ours: Any = {"linestyle": "none", "marker": "D", "color": VERMILION, "markersize": 4.5, "label": "ours, mean"}
    spread: Any = {"color": VERMILION, "linewidth": 5.0, "alpha": 0.35, "label": "ours, 95 % of the samples"}
    with print_panels(3.9, 3, 1, sharex=True) as (figure, column):
        for (axes,), (wind, title) in zip(column, WINDS.items(), strict=True):
            for row, name in enumerate(CONTROLLERS):
                cell = Cell(wind, name)
                errors = values_without_crashes(experiment.cells[cell].metrics, "rmse")
                axes.plot(np.quantile(errors, [0.025, 0.975]), [row + 0.17] * 2, zorder=2, **spread)
                axes.plot(errors.mean(), row + 0.17, zorder=3, **ours)
                if cell in published_table():
                    printed = published_table()[cell].rmse
                    axes.plot(printed.runs, [row - 0.17] * 3, zorder=2, **runs)
                    axes.plot(printed.mean, row - 0.17, zorder=3, **mean)
            name_rows(axes, list(CONTROLLERS.values()))
            axes.set_title(title, loc="left")
        axes.set_xlabel("RMSE (m)")
        axes.set_xlim(0.4, 1.1)
        handles = [Line2D([], [], **style) for style in (runs, {**mean, "label": "printed mean"}, ours, spread)]
        figure.legend(handles=handles, loc="outside upper center", ncols=2, columnspacing=1.0)
        return figure


def fair_figure(experiment: Experiment) -> Figure:
    """Plot the mean errors of the paper's PD and PD+T2FNN, and of controllers that the paper does not consider."""
    with print_panels(3.0) as (figure, axes):
        styles = zip(WINDS.items(), (BLUE, ORANGE, VERMILION), (-0.24, 0.0, 0.24), strict=True)
        for (wind, label), color, offset in styles:
            means = [
                mean_interval(values_without_crashes(experiment.cells[Cell(wind, name)].metrics, "rmse")).value
                for name in COMPARED_CONTROLLERS
            ]
            axes.barh(np.arange(len(COMPARED_CONTROLLERS)) + offset, means, 0.22, color=color, label=label)
            for row, mean in enumerate(means):
                text_position: Any = {"xytext": (2, 0), "textcoords": "offset points", "va": "center"}
                axes.annotate(f"{mean:.2f}", (mean, row + offset), fontsize=6.5, **text_position)
        name_rows(axes, list(COMPARED_CONTROLLERS.values()))
        axes.set_axisbelow(True)
        axes.set_xlim(0.0, 1.1 * axes.get_xlim()[1])
        axes.set_xlabel("mean RMSE (m)")
        legend_above(figure, axes, 3)
        return figure


def advantage_figure(experiment: Experiment) -> Figure:
    """Plot by how much type-2 networks reduce the RMSE relative to type-1 networks.

    The left panel varies the camera noise, and the right panel the weight q of the lower memberships.
    """
    with print_panels(2.3, 1, 2, sharey=True) as (figure, ((left, right),)):
        sweeps = (
            (left, experiment.noise, "noise", NOISE_LEVELS, 1e3, "noise of the cameras (mm)"),
            (right, experiment.q, "q", Q_VALUES, 1.0, "q"),
        )
        for axes, sweep, number, values, size, label in sweeps:
            axes.axhspan(0.02, 0.07, color="0.88", linewidth=0.0, label="claimed, 2 to 7 %")
            axes.axhline(0.0, **LIMIT)
            for name, marker in (("pd_t2fnn", "o"), ("pd_t2fnn_wide", "s")):
                gains = [advantage(sweep, number, value, name) for value in values]
                options = {**_style(name), "marker": marker, "markersize": 3.0, "capsize": 2.0}
                plot_intervals(axes, size * np.array(values), gains, label=CONTROLLERS[name], **options)
            axes.set_xlabel(label)
        left.set_ylabel("reduction of the RMSE")
        left.yaxis.set_major_formatter(PercentFormatter(1.0))
        legend_above(figure, left, 2, columnspacing=1.0)
        return figure


def gain_figure(experiment: Experiment) -> Figure:
    """Plot the error over the gains of the PD, with and without a network."""
    calibrated = experiment.cells[Cell("no_wind", "pd")].scenario.cascade.position.without_estimator()
    errors = {name: _mean_errors(experiment.maps[name]) for name in MAPPED_CONTROLLERS}
    finite = np.concatenate([error[np.isfinite(error)] for _, _, error in errors.values()])
    smallest, largest = float(finite.min()), float(min(finite.max(), 16.0 * finite.min()))
    with print_panels(2.5, 1, 2, sharey=True) as (figure, (row,)):
        for axes, name in zip(row, MAPPED_CONTROLLERS, strict=True):
            k_p, k_d, error = errors[name]
            axes.set_facecolor("0.8")
            norm = LogNorm(smallest, largest)
            shades = axes.pcolormesh(k_d, k_p, error, cmap=shading(), norm=norm, shading="nearest")
            axes.contour(k_d, k_p, error, [1.2 * np.nanmin(error)], colors=VERMILION, linewidths=1.2)
            gains = calibrated.k_d[0], calibrated.k_p[0]
            axes.plot(*gains, "*", color=BLACK, markersize=9, markeredgecolor="white", markeredgewidth=0.6)
            axes.set(xscale="log", yscale="log", xlabel="$k_D$ (1/s)", title=CONTROLLERS[name])
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter("{x:g}")
                axis.set_minor_locator(NullLocator())
                axis.set_ticks([0.5, 1.0, 2.0, 5.0, 10.0])
            axes.grid(visible=False)
        row[0].set_ylabel("$k_P$ (1/s²)")
        bar = figure.colorbar(shades, ax=list(row), label="RMSE (m)", fraction=0.06, pad=0.02, extend="max")
        bar.set_ticks([tick for tick in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0) if smallest <= tick <= largest])
        bar.ax.yaxis.set_major_formatter("{x:g}")
        bar.ax.yaxis.set_minor_locator(NullLocator())
        lines = [
            Line2D([], [], color=VERMILION, linewidth=1.2, label="within 20 % of the best"),
            Line2D([], [], color=BLACK, marker="*", linestyle="none", label="calibrated"),
            Patch(color="0.8", label="crash"),
        ]
        figure.legend(handles=lines, loc="outside upper center", ncols=3, columnspacing=1.0, handlelength=1.4)
        return figure


def _mean_errors(sweep: Sweep) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the gains k_P and k_D of a map, and the mean RMSE for each pair of gains, NaN if a sample crashed."""
    k_p, k_d = (np.unique(sweep.settings[name]) for name in ("k_p", "k_d"))
    rmse = np.where(sweep.metrics.crashed, np.nan, sweep.metrics.rmse).mean(axis=1)
    return k_p, k_d, rmse.reshape(len(k_p), len(k_d))


def _complete_flight(flights: Flights) -> Flight:
    """Return a flight without a crash, which therefore covers the whole route."""
    return flights[Cell("no_wind", "pd_t2fnn")]


def _shade_legs(axes: Axes, flight: Flight) -> None:
    """Shade the legs of the route, and write their numbers at the top of the axes."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.1 * (high - low))
    shade_legs(axes, flight.plan, float(flight.time[-1]), height=0.92)
    axes.set_xlim(0.0, flight.time[-1])
