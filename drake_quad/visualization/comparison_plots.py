"""Plots that compare several controllers on the same samples."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from drake_quad.laboratory.metrics import Metrics
from drake_quad.studies.statistics import values_without_crashes
from drake_quad.visualization.panels import name_rows, new_panels
from drake_quad.visualization.style import TEXT_BACKGROUND

_MARKERS = "osD^vPX*"


def plot_comparison(flights: Mapping[str, Mapping[str, Metrics]]) -> Figure:
    """Plot the RMSE of each sample and the mean, with a panel for each scenario and a row for each controller.

    Args:
        flights: metrics (N,) by scenario and controller. Crashed flights are counted in the label, not drawn.
    """
    controllers = list(
        dict.fromkeys(name for metrics_by_controller in flights.values() for name in metrics_by_controller)
    )
    size = 2.0 + 2.6 * len(flights), 1.3 + 0.42 * len(controllers)
    with new_panels(*size, 1, len(flights), sharex=True, sharey=True) as (figure, (row,)):
        for axes, (scenario, metrics_by_controller) in zip(row, flights.items(), strict=True):
            for height, name in enumerate(controllers):
                metrics = metrics_by_controller[name]
                errors = 100.0 * values_without_crashes(metrics, "rmse")
                offsets = np.linspace(-0.22, 0.22, len(errors)) if len(errors) > 1 else np.zeros(len(errors))
                axes.plot(errors, height + offsets, ".", color="0.6", markersize=3.0, zorder=2)
                label = ""
                if len(errors):
                    axes.plot(errors.mean(), height, _MARKERS[height % len(_MARKERS)], color="black", zorder=3)
                    label = f"{errors.mean():.0f} cm" if errors.mean() >= 10.0 else f"{errors.mean():.1f} cm"
                if metrics.crashed.any():
                    label = ", ".join(filter(None, [label, f"{int(metrics.crashed.sum())} crashed"]))
                position = (float(errors.mean()) if len(errors) else 0.0, height)
                axes.annotate(
                    label, position, (6, 0), textcoords="offset points", fontsize=8.5, va="center", bbox=TEXT_BACKGROUND
                )
            axes.set(title=scenario, xlabel="RMSE (cm)")
            name_rows(axes, controllers)
        # The panels share the axis, so its limits are set after all samples are drawn.
        row[0].set_xlim(0.0, 1.15 * row[0].get_xlim()[1])
        figure.suptitle("RMSE of each sample (grey) and their mean (black)", x=0.01, ha="left", fontsize=11)
        return figure
