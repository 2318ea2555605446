"""Tornado plot of the sensitivities of a metric."""

import numpy as np
from matplotlib.figure import Figure

from drake_quad.design.sensitivity import Sensitivities
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import BLUE, VERMILION


def plot_sensitivities(found: Sensitivities, metric: str) -> Figure:
    """Plot the change of a metric in per cent for an increase of each field by one per cent, largest at the top.

    A field that is zero has no relative change and is left out. If the metric is zero, all fields are left out.
    """
    elasticities = found.values * found.gradients[metric] / (found.metrics[metric] or np.nan)
    order = [i for i in np.argsort(np.abs(elasticities)) if found.values[i] != 0.0 and np.isfinite(elasticities[i])]
    shown = elasticities[order]
    with new_panels(7.0, 1.2 + 0.27 * max(len(order), 1)) as (figure, axes):
        axes.barh(range(len(order)), shown, color=np.where(shown > 0.0, VERMILION, BLUE))
        if not order:
            axes.annotate("nothing changes it to first order", (0.5, 0.5), xycoords="axes fraction", ha="center")
        axes.axvline(0.0, color="0.4", linewidth=0.8)
        axes.set_yticks(range(len(order)), [found.fields[i] for i in order])
        axes.set(xlabel="change of the metric for a change of the field by 1 % (%)", title=f"{metric}, first order")
        axes.grid(visible=False, axis="y")
        axes.set_axisbelow(True)
        return figure
