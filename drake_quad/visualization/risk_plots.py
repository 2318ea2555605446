"""Plots of rare events: probabilities of exceedance, and the random numbers of the samples at which an event occurs."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from drake_quad.laboratory.metrics import metric_definitions
from drake_quad.studies.risk import Risk
from drake_quad.visualization.panels import name_rows, new_panels
from drake_quad.visualization.style import BLUE, VERMILION

_NUM_THRESHOLDS = 120  # number of points on the exceedance curve
_MAX_COORDINATES = 12  # largest number of random numbers in a chart


def plot_exceedance(risk: Risk) -> Figure:
    """Plot the probability that the metric is beyond a threshold, with its 95 % band, over the threshold.

    A marker with an error bar shows the probability of the event whose risk was estimated.
    """
    definition = metric_definitions(risk.scenarios[0].metrics_type)[risk.event.metric]
    first = risk.event.value(np.concatenate([run.history[0] for run in risk.runs]))
    finite = first[np.isfinite(first)]
    best = float(finite.min() if risk.event.sign > 0.0 else finite.max())
    thresholds = np.linspace(best, risk.event.bound, _NUM_THRESHOLDS)
    value, low, high = np.transpose(risk.exceedance(thresholds))
    with new_panels(6.5, 4.0) as (figure, axes):
        axes.fill_between(thresholds, low, high, color=BLUE, alpha=0.25, linewidth=0.0, label="95 % interval")
        axes.semilogy(thresholds, value, color=BLUE, label="estimate")
        interval = risk.probability
        axes.errorbar(
            [risk.event.bound],
            [interval.value],
            [[interval.value - interval.low], [interval.high - interval.value]],
            color=VERMILION,
            fmt="o",
            capsize=3.0,
            label=str(risk.event),
        )
        unit, size = definition.unit, 1.0
        if definition.display is not None:
            unit, size, _ = definition.display
        axes.xaxis.set_major_formatter(FuncFormatter(lambda number, _: f"{number / size:g}"))
        word = "above" if risk.event.sign > 0.0 else "below"
        axes.set(
            xlabel=f"{definition.label} ({unit})",
            ylabel=f"probability of a {definition.label} {word} (1)",
            title=f"Rare events, from {len(risk.runs)} runs with {risk.num_flights:,} flights",
        )
        axes.legend()
        return figure


def plot_coordinates(risk: Risk) -> Figure:
    """Plot mean and standard deviation of the most important random numbers, over samples at which the event occurs.

    Over all samples, each random number has a standard normal distribution.
    """
    drawn = risk.coordinates[:_MAX_COORDINATES]
    rows = np.arange(len(drawn))
    means = np.array([each.mean.value for each in drawn])
    deviations = np.array([each.deviation for each in drawn])
    with new_panels(8.0, 1.4 + 0.3 * len(drawn)) as (figure, axes):
        axes.axvspan(-1.0, 1.0, color="0.93", zorder=0, label="all samples, mean ± one standard deviation")
        axes.axvline(0.0, color="0.6", linewidth=0.8)
        axes.errorbar(means, rows, xerr=deviations, color=VERMILION, fmt="o", capsize=3.0, label=f"with {risk.event}")
        name_rows(axes, [each.name for each in drawn])
        axes.set(xlabel="random number, in standard deviations from its median (1)")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return figure
