"""Plots of the search for a worst case, and of the worst flight beside the nominal one."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drake_quad.flight.flight import Flight
from drake_quad.laboratory.metrics import metric_definitions
from drake_quad.studies.falsification import WorstCase
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import BLUE, VERMILION


def plot_worst_flight(worst: Flight, nominal: Flight) -> Figure:
    """Plot the position error and the tilt of the worst flight and of the nominal one over time."""
    with new_panels(7.5, 4.6, 2, 1, sharex=True) as (figure, ((upper,), (lower,))):
        for flight, color, label in ((nominal, BLUE, "nominal"), (worst, VERMILION, "worst case")):
            state, reference = flight.record("state"), flight.record("reference")
            error = np.linalg.norm([getattr(state, axis) - getattr(reference, axis) for axis in "xyz"], axis=0)
            tilt = np.degrees(np.arccos(np.clip(np.cos(state.roll) * np.cos(state.pitch), -1.0, 1.0)))
            upper.plot(flight.time, 100.0 * error, color=color, label=label)
            lower.plot(flight.time, tilt, color=color)
        if worst.metrics.crashed:
            for axes in (upper, lower):
                axes.axvline(float(worst.metrics.crash_time), color="0.4", linestyle=":")
        upper.set(ylabel="position error (cm)", title="Worst case beside the nominal flight")
        lower.set(ylabel="tilt (°)", xlabel="time (s)")
        upper.legend()
        return figure


def plot_search(found: WorstCase) -> Figure:
    """Plot the worst metric of each generation of the search, averaged over the samples of wind and noise."""
    definition = metric_definitions(found.scenario.metrics_type)[found.metric]
    unit, size = (definition.unit, 1.0) if definition.display is None else definition.display[:2]
    means = np.array(found.means)
    with new_panels(6.0, 3.4) as (figure, axes):
        generations = np.arange(1, len(means) + 1)
        axes.plot(generations, np.where(np.isfinite(means), means, np.nan) / size, "o-", color=BLUE, markersize=4.0)
        infinite = ~np.isfinite(means)
        if infinite.any():
            axes.axvspan(generations[infinite][0] - 0.5, generations[-1] + 0.5, color="0.9", zorder=0)
            label = "crash" if found.is_crash else "infinite"
            axes.annotate(label, (generations[infinite][0], 0.02), xycoords=("data", "axes fraction"))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(
            xlabel="generation (1)",
            ylabel=f"{definition.label} ({unit})",
            title="Worst candidate of each generation, mean over wind and noise",
        )
        return figure
