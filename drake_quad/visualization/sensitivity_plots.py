"""Charts of the sensitivities of a metric: derivatives, and fractions of the variance."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from drake_quad.design.sensitivity import Sensitivities
from drake_quad.laboratory.metrics import METRICS
from drake_quad.studies.sobol_indices import SobolIndex
from drake_quad.visualization.names import short_name
from drake_quad.visualization.panels import name_rows, new_panels
from drake_quad.visualization.style import BLUE, VERMILION

_MAX_INDICES = 14  # largest number of parameters in a chart of Sobol indices


def plot_sensitivities(sensitivities: Sensitivities, metric: str) -> Figure:
    """Plot the change of a metric in per cent for an increase of each field by 1 %, with the largest change at the top.

    Fields that are zero are left out, since 1 % of zero is no change. If the metric is zero, all fields are left out.
    """
    elasticities = sensitivities.values * sensitivities.gradients[metric] / (sensitivities.metrics[metric] or np.nan)
    order = [
        i for i in np.argsort(np.abs(elasticities)) if sensitivities.values[i] != 0.0 and np.isfinite(elasticities[i])
    ]
    drawn = elasticities[order]
    label = METRICS[metric].label if metric in METRICS else metric.replace("_", " ")
    with new_panels(7.0, 1.2 + 0.27 * max(len(order), 1)) as (figure, axes):
        axes.barh(range(len(order)), drawn, color=np.where(drawn > 0.0, VERMILION, BLUE))
        if not order:
            axes.annotate(
                "no field changes the metric to first order", (0.5, 0.5), xycoords="axes fraction", ha="center"
            )
        axes.axvline(0.0, color="0.4", linewidth=0.8)
        axes.set_yticks(range(len(order)), [short_name(sensitivities.fields[i]) for i in order])
        axes.set(
            xlabel="change of the metric if the field increases by 1 % (%)",
            title=f"Sensitivities of {label}",
        )
        axes.grid(visible=False, axis="y")
        axes.set_axisbelow(True)
        return figure


def plot_sobol_indices(indices: Sequence[SobolIndex], metric: str) -> Figure:
    """Plot the first-order and the total Sobol index of the random parameters with the largest total indices."""
    drawn = indices[:_MAX_INDICES]
    rows = np.arange(len(drawn))
    with new_panels(8.0, 1.4 + 0.32 * len(drawn)) as (figure, axes):
        for kind, color, label, offset in (
            ("first_order", BLUE, "first order", -0.15),
            ("total", VERMILION, "total", 0.15),
        ):
            value, low, high = np.transpose([getattr(each, kind) for each in drawn])
            errors = np.stack([value - low, high - value])
            axes.errorbar(value, rows + offset, xerr=errors, color=color, fmt="o", capsize=2.5, label=label)
        axes.axvline(0.0, color="0.4", linewidth=0.8)
        name_rows(axes, [each.name for each in drawn])
        axes.set(xlabel=f"fraction of the variance of {metric} (1)")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return figure
