"""Figures of the report of the evaluation."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from drake_quad.evaluation.claims import CONTROLLER_NAMES, comparisons_by_laboratory, designs_by_sensitivity, lap_counts
from drake_quad.evaluation.entries import NETWORK_BASES, NETWORKS, POSITION_NETWORK_BASES
from drake_quad.evaluation.families import FAMILIES, FAMILY_OF
from drake_quad.evaluation.results import (
    SENSITIVITY_VARIANT_CONTROLLERS,
    SENSITIVITY_VARIANT_LABORATORY,
    Evaluation,
    Traits,
    laboratory_with_laps,
)
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reports.claims import reduction
from drake_quad.reports.figures import COLUMN_WIDTH, print_panels
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import Interval, values_without_crashes
from drake_quad.visualization.panels import legend_above, name_rows, plot_intervals
from drake_quad.visualization.style import BLACK, BLUE, GREEN, LIMIT, ORANGE, PURPLE, SKY, VERMILION

# Colours of the controllers in all figures. Markers distinguish the networks.
_COLORS = {
    "pd": BLACK,
    "pid": ORANGE,
    "geometric": "0.55",
    "disturbance_observer": GREEN,
    "l1": SKY,
    "indi": BLUE,
    "lqg": VERMILION,
    "mpc": PURPLE,
}
_USER_COLOR = "saddlebrown"  # colour of the user's controllers
_MARKERS = {"": "o", "t1fnn": "v", "t2fnn": "^", "t2fnn_adaptive": "D", "t2fnn_map": "s"}
_MAX_CRASH_FRACTION = 0.05  # markers of controllers with a larger fraction of crashes are hollow


def evaluation_figures(evaluation: Evaluation) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure of each plot for which the evaluation contains results."""
    yield "errors", errors_figure(evaluation)
    if reductions_by_network(evaluation):
        yield "networks", networks_figure(evaluation)
    if evaluation.flights.get(SENSITIVITY_VARIANT_LABORATORY):
        yield "margins", margins_figure(evaluation)
    mapped = [name for name in POSITION_NETWORK_BASES if lap_counts(evaluation, f"{name}_t2fnn_map")]
    if mapped:
        yield "laps", laps_figure(evaluation, mapped)


def base_and_network(controller: str) -> tuple[str, str]:
    """Return the name of the base controller and the kind of network; the kind is "" without a network."""
    if controller not in CONTROLLER_NAMES and "@" not in controller:  # a user's controller
        return controller, ""
    base = next(name for name in _COLORS if controller.startswith(name))
    return base, controller.removeprefix(base).removeprefix("_")


def errors_figure(evaluation: Evaluation) -> Figure:
    """Plot the mean error of every controller, with a panel for each laboratory and a row for each controller."""
    titles = {
        laboratory: name if name == laboratory else f"{name}\n{laboratory}" for laboratory, name in FAMILY_OF.items()
    }
    laboratories = [laboratory for laboratory in titles if laboratory in evaluation.flights]
    controllers = sorted(evaluation.controllers, key=[*CONTROLLER_NAMES, *evaluation.controllers].index)
    columns = min(len(laboratories), 5)
    rows = -(-len(laboratories) // columns)
    width, height = 1.5 + 1.35 * columns, 0.5 + rows * (0.65 + 0.145 * len(controllers))
    with print_panels(height, rows, columns, width=width, sharey=True) as (figure, grid):
        for axes, laboratory in zip(grid.flat, laboratories, strict=False):
            for row, name in enumerate(controllers):
                if name in evaluation.flights[laboratory]:
                    _plot_mean(axes, evaluation.flights[laboratory][name], row, name)
            _format_panel(axes, titles[laboratory])
        for axes in grid.flat[len(laboratories) :]:
            axes.set_visible(False)
        for row in grid:
            row[0].set_yticks(range(len(controllers)), [CONTROLLER_NAMES[name] for name in controllers])
            row[0].set_ylim(len(controllers) - 0.4, -0.6)
        figure.supxlabel("RMSE (cm)", fontsize=8)
        return figure


def _plot_mean(axes: Axes, metrics: Metrics, row: int, name: str) -> None:
    base, kind = base_and_network(name)
    mean = mean_interval(100.0 * values_without_crashes(metrics, "rmse"))
    if np.isfinite(mean.value):
        axes.plot([max(mean.low, 1e-3), mean.high], [row, row], color=_COLORS.get(base, _USER_COLOR), linewidth=1.6)
        fill = "none" if np.mean(metrics.crashed) > _MAX_CRASH_FRACTION else "full"
        axes.plot(mean.value, row, _MARKERS[kind], color=_COLORS.get(base, _USER_COLOR), markersize=4.2, fillstyle=fill)


def _format_panel(axes: Axes, title: str) -> None:
    """Set the title, and a logarithmic horizontal axis with ticks at round numbers."""
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    low, high = low / 1.3, high * 1.3
    axes.set_xlim(low, high)
    choices = (0.5, 1, 2, 3, 5, 10, 20, 50, 100, 200) if high < 20.0 * low else (0.3, 1, 3, 10, 30, 100, 300)
    ticks = [tick for tick in choices if low <= tick <= high]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_title(title)


def reductions_by_network(evaluation: Evaluation) -> dict[str, dict[str, Interval]]:
    """Return the relative error reduction by each network, by controller name and laboratory."""
    names = [f"pd_{kind}" for kind in NETWORKS] + [f"{name}_t2fnn" for name in NETWORK_BASES]
    names += [f"{name}_t2fnn_map" for name in POSITION_NETWORK_BASES[1:]]
    compared = {name: comparisons_by_laboratory(evaluation, name, base_and_network(name)[0]) for name in names}
    return {
        name: {laboratory: reduction(each.ratio) for laboratory, each in by_laboratory.items()}
        for name, by_laboratory in compared.items()
        if by_laboratory
    }


def networks_figure(evaluation: Evaluation) -> Figure:
    """Plot the error reduction that each network achieves: a row for each network, a marker for each laboratory."""
    reductions = reductions_by_network(evaluation)
    colors = dict(zip(FAMILIES, (BLUE, GREEN, ORANGE, VERMILION), strict=True))
    with print_panels(0.9 + 0.36 * len(reductions), width=1.75 * COLUMN_WIDTH) as (figure, axes):
        axes.axvline(0.0, **LIMIT)
        for row, by_laboratory in enumerate(reductions.values()):
            for offset, (laboratory, each) in zip(
                np.linspace(-0.33, 0.33, len(by_laboratory)), by_laboratory.items(), strict=True
            ):
                color = colors[FAMILY_OF[laboratory]]
                axes.plot([100.0 * each.low, 100.0 * each.high], [row + offset] * 2, color=color)
                axes.plot(100.0 * each.value, row + offset, "o", color=color, markersize=2.8)
        axes.set_xscale("symlog", linthresh=10.0)
        axes.set_xticks(
            [-100, -30, -10, -5, 0, 5, 10, 30, 100], ["-100", "-30", "-10", "-5", "0", "5", "10", "30", "100"]
        )
        axes.xaxis.set_minor_locator(NullLocator())
        ends = [
            100.0 * end for by_laboratory in reductions.values() for each in by_laboratory.values() for end in each[1:]
        ]
        ends = [end for end in ends if np.isfinite(end)]
        axes.set_xlim(max(min([-6.0, *ends]) * 1.15, -400.0), min(max([6.0, *ends]) * 1.15, 110.0))
        name_rows(axes, [CONTROLLER_NAMES[name] for name in reductions])
        axes.set_xlabel("reduction of the RMSE by the network (%)")
        handles = [
            Line2D([], [], color=color, marker="o", markersize=2.8, label=name) for name, color in colors.items()
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=4, columnspacing=1.0)
        return figure


def margins_figure(evaluation: Evaluation) -> Figure:
    """Plot the error in high wind over the peak sensitivity and over the tolerated delay."""
    plain = {
        name: (each, evaluation.flights[SENSITIVITY_VARIANT_LABORATORY][name])
        for name, each in evaluation.traits.get(FAMILY_OF[SENSITIVITY_VARIANT_LABORATORY], {}).items()
        if not base_and_network(name)[1]
    }
    with print_panels(2.7, 1, 2, width=1.75 * COLUMN_WIDTH, sharey=True) as (figure, (row,)):
        for axes, (measure, unit, label) in zip(row, _MEASURES, strict=True):
            for name in SENSITIVITY_VARIANT_CONTROLLERS:
                designs = designs_by_sensitivity(evaluation, name)
                if designs:
                    x, y = zip(*(_point(each, metrics, measure, unit) for each, metrics in designs), strict=True)
                    axes.plot(x, y, "-o", color=_COLORS[name], markersize=2.5, linewidth=0.8)
            for name, design in plain.items():
                axes.plot(
                    *_point(*design, measure, unit),
                    "o",
                    color=_COLORS.get(name, _USER_COLOR),
                    markersize=5.0,
                    label=CONTROLLER_NAMES[name],
                )
            axes.set_yscale("log")
            axes.set_xlabel(label)
        # The axis limits are wide, so that small differences between designs with the same limit are not exaggerated.
        row[0].set_xlim(min(1.5, row[0].get_xlim()[0]), max(3.1, row[0].get_xlim()[1]))
        row[1].set_xlim(0.0, max(100.0, row[1].get_xlim()[1]))
        low, high = row[0].get_ylim()
        ticks = [tick for tick in (1, 2, 3, 5, 10, 20, 50) if low <= tick <= high]
        row[0].set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        row[0].yaxis.set_minor_locator(NullLocator())
        row[0].set_ylabel(f"RMSE in {SENSITIVITY_VARIANT_LABORATORY} (cm)")
        legend_above(figure, row[0], 4, columnspacing=1.0)
        return figure


# Field of `Traits`, unit and axis label of each stability measure.
_MEASURES: Any = (
    ("sensitivity", 1.0, "peak sensitivity"),
    ("delay_flown", 1e-3, "tolerated additional delay (ms)"),
)


def _point(traits: Traits, metrics: Metrics, measure: str, unit: float) -> tuple[float, float]:
    number = float(getattr(traits, measure))
    error = 100.0 * float(np.mean(values_without_crashes(metrics, "rmse")))
    return (number / unit if np.isfinite(number) else np.nan), error


def laps_figure(evaluation: Evaluation, controllers: Sequence[str]) -> Figure:
    """Plot the error in each lap, with and without a network that has the position as input."""
    with print_panels(2.6, width=1.3 * COLUMN_WIDTH) as (figure, axes):
        for name in controllers:
            for controller, style in ((name, ":"), (f"{name}_t2fnn_map", "-")):
                counts = lap_counts(evaluation, controller)
                results = [evaluation.flights[laboratory_with_laps(count)][controller] for count in counts]
                means = [mean_interval(100.0 * values_without_crashes(metrics, "rmse")) for metrics in results]
                options: dict[str, Any] = {
                    "color": _COLORS[name],
                    "linestyle": style,
                    "markersize": 3.0,
                    "capsize": 2.0,
                }
                marker = _MARKERS[base_and_network(controller)[1]]
                plot_intervals(axes, counts, means, label=CONTROLLER_NAMES[controller], marker=marker, **options)
        axes.set_ylim(0.0, None)
        axes.set(xlabel="lap", ylabel="RMSE (cm)")
        axes.set_xticks(range(1, max(map(len, (lap_counts(evaluation, name) for name in controllers))) + 1))
        legend_above(figure, axes, 2, columnspacing=1.0)
        return figure
