"""Overview figures of a flight and of studies, which return their axes so that a notebook can add to them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_quad.flight.flight import Flight
from drake_quad.statistics.estimates import mean_interval, proportion_interval
from drake_quad.studies.statistics import values_without_crashes
from drake_quad.studies.study import Study
from drake_quad.visualization.curves import dash_overlapping_curves
from drake_quad.visualization.panels import name_rows
from drake_quad.visualization.plots import draw_error, draw_from_above, draw_rotor_speeds
from drake_quad.visualization.study_plots import draw_distribution, label_metric
from drake_quad.visualization.style import AXIS_COLORS, BLACK, VERMILION, new_figure, use_style

_LEGEND_ABOVE_PANEL: Any = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97), "columnspacing": 0.8}


def plot_flight(flight: Flight) -> tuple[Figure, dict[str, Axes]]:
    """Plot the path, the position error, the commanded acceleration and the rotor speeds of a flight.

    Returns:
        The figure, and its axes by name: "path" shows the path from above; "error", "command" and "rotors" show
        signals over time.
    """
    with use_style():
        figure = new_figure(9.5, 6.6)
        axes = figure.subplot_mosaic([["path", "error"], ["path", "command"], ["path", "rotors"]], width_ratios=[2, 3])
        draw_from_above(axes["path"], flight)
        axes["path"].legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3)
        draw_error(axes["error"], flight)
        if "acceleration_command" in flight.signals:
            command = flight.record("acceleration_command")
            for axis, color in AXIS_COLORS.items():
                values = getattr(command, axis)
                axes["command"].plot(flight.time, values, color=color, linewidth=1.1, label=axis.upper())
            dash_overlapping_curves(axes["command"])
            axes["command"].legend(**_LEGEND_ABOVE_PANEL, ncols=3)
        axes["command"].set(xlabel="time (s)", ylabel="acceleration\ncommand (m/s²)")
        draw_rotor_speeds(axes["rotors"], flight)
        axes["rotors"].legend(**_LEGEND_ABOVE_PANEL, ncols=4)
        for name in ("error", "command"):
            axes[name].set_xlabel("")
            axes[name].sharex(axes["rotors"])
        return figure, axes


def plot_study(studies: Study | Mapping[str, Study], name: str = "rmse") -> tuple[Figure, dict[str, Axes]]:
    """Plot the distribution of a metric, its mean, and the fraction of crashes for one study or several.

    Args:
        studies: study, or several studies by their names in the figure; each contains at least one flight.
        name: name of the metric.

    Returns:
        The figure, and its axes by name: "distribution", and "mean" and "crashes" with 95 % confidence intervals.
    """
    study_by_name = {studies.scenario.name: studies} if isinstance(studies, Study) else dict(studies)
    with use_style():
        figure = new_figure(9.5, 3.4 + 0.25 * len(study_by_name))
        axes = figure.subplot_mosaic([["distribution", "mean"], ["distribution", "crashes"]], width_ratios=[3, 2])
        draw_distribution(axes["distribution"], study_by_name, name)
        means = [mean_interval(values_without_crashes(study.metrics, name)) for study in study_by_name.values()]
        crashes = [
            proportion_interval(int(study.metrics.crashed.sum()), len(study.samples))
            for study in study_by_name.values()
        ]
        for panel, intervals, color in (("mean", means, BLACK), ("crashes", crashes, VERMILION)):
            value, low, high = np.transpose(intervals)
            error_bars = np.abs([low - value, high - value])
            axes[panel].errorbar(value, range(len(study_by_name)), xerr=error_bars, fmt="o", color=color, capsize=3.0)
            name_rows(axes[panel], list(study_by_name))
        label_metric(axes["mean"].xaxis, study_by_name.values(), name, "mean ")
        label_metric(axes["crashes"].xaxis, study_by_name.values(), "crashed")
        return figure, axes
