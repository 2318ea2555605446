"""Plots of studies: distributions, convergence, and the influence of random parameters."""

from collections.abc import Mapping
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator, PercentFormatter
from matplotlib.transforms import ScaledTranslation

from drake_quad.errors import InputError
from drake_quad.laboratory.metrics import METRICS, UNITS
from drake_quad.scenario.description import unit_at
from drake_quad.statistics.estimates import quantile_interval, running_mean, share_interval
from drake_quad.studies.statistics import (
    crash_bins,
    crash_probability,
    influences,
    most_influential_path,
    values_with_crashes,
    values_without_crashes,
)
from drake_quad.studies.study import Study
from drake_quad.visualization.names import short_name
from drake_quad.visualization.panels import name_rows, new_panels
from drake_quad.visualization.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

_LINES = [(BLUE, "-"), (VERMILION, "--"), (GREEN, "-."), (PURPLE, ":"), (ORANGE, "-"), (SKY, "--"), (BLACK, "-.")]
# Largest number of fields in a tornado chart.
_MAX_FIELDS = 16
# Horizontal distance between the points of one controller and the next, points.
_POINT_OFFSET = 3.0
_LOG_AXIS_RATIO = 10.0  # ratio of medians from which on the axis is logarithmic


def label_metric(axis: Axis, name: str, prefix: str = "") -> None:
    """Label an axis on which a metric is drawn in its own unit, with numbers in the unit of the tables.

    Args:
        axis: axis of a plot.
        name: name of the metric, or "crashed" for the share of crashes.
        prefix: words before the name.
    """
    if name == "crashed":
        axis.set_label_text("share of the samples that crashed")
        _in_percent(axis)
        return
    unit, size = UNITS[name], 1.0
    display = METRICS[name].display
    if display is not None:
        unit, size = display.unit, display.size
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / size:g}"))
    axis.set_label_text(f"{prefix}{METRICS[name].label} ({unit})")


def plot_distribution(studies: Mapping[str, Study], name: str = "rmse") -> Figure:
    """Plot the empirical distribution function of a metric, with a line for each controller.

    A crashed sample counts as worse than any value.

    The bands contain the whole true distribution with 95 % confidence, by the inequality of Dvoretzky, Kiefer,
    Wolfowitz and Massart.

    Args:
        studies: studies by the name of the controller.
        name: name of the metric.
    """
    with new_panels(7.0, 4.2) as (figure, axes):
        draw_distribution(axes, studies, name)
        return figure


def draw_distribution(axes: Axes, studies: Mapping[str, Study], name: str) -> None:
    """Draw the plot of `plot_distribution` into given axes.

    Args:
        axes: axes to draw into.
        studies: studies by the name of the controller.
        name: name of the metric.
    """
    for (controller, study), (color, style) in zip(studies.items(), cycle(_LINES), strict=False):
        values = np.sort(values_with_crashes(study.metrics, name))
        n = len(values)
        finite = values[np.isfinite(values)]
        share = np.arange(1, len(finite) + 1) / n
        reach = np.sqrt(np.log(2.0 / 0.05) / (2.0 * n))
        label = controller
        if study.metrics.crashed.any():
            label += f" ({crash_probability(study.metrics).without_interval().percent()} crashed)"
        axes.step(finite, share, where="post", color=color, linestyle=style, label=label)
        axes.fill_between(
            finite,
            np.maximum(share - reach, 0.0),
            np.minimum(share + reach, 1.0),
            step="post",
            color=color,
            alpha=0.15,
            linewidth=0.0,
        )
    axes.set(ylabel="share of the samples", ylim=(0.0, 1.02))
    survivors = [values_without_crashes(study.metrics, name) for study in studies.values()]
    known = [median for values in survivors if len(values) and (median := np.median(values)) > 0.0]
    if known and max(known) > _LOG_AXIS_RATIO * min(known):
        axes.set_xscale("log")
    label_metric(axes.xaxis, name)
    _in_percent(axes.yaxis)
    axes.set_title(f"{_count(studies)}; bands: 95 % confidence", loc="left")
    axes.legend(loc="lower right")


def plot_convergence(studies: Mapping[str, Study], name: str = "rmse") -> Figure:
    """Plot the mean of a metric and the share of crashes over the number of samples.

    If no sample crashed, the 95 % quantile replaces the share of crashes.

    Args:
        studies: studies by the name of the controller.
        name: name of the metric.
    """
    crashes = any(study.metrics.crashed.any() for study in studies.values())
    with new_panels(9.0, 3.8, 1, 2) as (figure, ((left, right),)):
        for (controller, study), (color, style) in zip(studies.items(), cycle(_LINES), strict=False):
            count, mean, low, high = _running(study, name)
            left.plot(count, mean, color=color, linestyle=style, label=controller)
            left.fill_between(count, low, high, color=color, alpha=0.15, linewidth=0.0)
            stops = np.unique(np.geomspace(min(20, len(study.samples)), len(study.samples), 60).astype(int))
            values = study.metrics.crashed if crashes else getattr(study.metrics, name)
            parts = [values[:stop] for stop in stops]
            shares = (share_interval(int(part.sum()), len(part)) for part in parts)
            found = np.array([*shares] if crashes else [quantile_interval(part, 0.95) for part in parts])
            value, low, high = np.where(np.isfinite(found), found, np.nan).T
            right.plot(stops, value, color=color, linestyle=style, label=controller)
            right.fill_between(stops, low, high, color=color, alpha=0.15, linewidth=0.0)
        left.set_title("mean of the flights that went to the end", loc="left")
        label_metric(left.yaxis, name)
        right.set_title("crashes" if crashes else "95 % quantile", loc="left")
        label_metric(right.yaxis, "crashed" if crashes else name)
        for axes in (left, right):
            # Matplotlib cannot scale an empty axis logarithmically.
            drawn = any(len(line.get_xdata()) for line in axes.lines)
            axes.set(xscale="log" if drawn else "linear", xlabel="samples; bands: 95 % confidence")
            if drawn:
                axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axes.xaxis.set_minor_locator(NullLocator())
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        left.legend(loc="best")
        return figure


def _running(study: Study, name: str) -> tuple[np.ndarray, ...]:
    """Return numbers n of completed flights, the mean over the first n, and the ends of its interval."""
    values = values_without_crashes(study.metrics, name)
    # The first few points are left out, because their wide intervals would dominate the axis.
    first = max(min(10, len(values)) - 1, 0)
    return np.arange(1, len(values) + 1)[first:], *(each[first:] for each in running_mean(values))


def plot_influences(study: Study, name: str = "rmse") -> Figure:
    """Plot a tornado chart of the mean of a metric in the lowest and the highest tenth of each random parameter.

    Args:
        study: study of a scenario with distributions.
        name: name of the metric, or "crashed" for the share of crashes.
    """
    found = influences(study, name)
    with new_panels(8.6, 1.4 + 0.34 * max(min(len(found), _MAX_FIELDS), 1)) as (figure, axes):
        mean = float(
            np.mean(study.metrics.crashed if name == "crashed" else values_without_crashes(study.metrics, name))
        )
        for place, each in enumerate(found[:_MAX_FIELDS]):
            for end, color, offset in ((each.low, SKY, -0.18), (each.high, ORANGE, 0.18)):
                axes.barh(place + offset, end.value - mean, 0.36, left=mean, color=color)
                axes.plot([end.low, end.high], [place + offset] * 2, color="0.25", linewidth=1.0)
            rho = each.correlation
            text = rho.text(signed=True)
            if each.partial != rho and np.isfinite(each.partial.value):
                text += f"; partial {each.partial.value:+.2f}"
            axes.annotate(text, (1.01, place), xycoords=("axes fraction", "data"), va="center", fontsize=8.5)
        labels = [_field_label(study, each.path) for each in found[:_MAX_FIELDS]]
        name_rows(axes, labels)
        axes.set_axisbelow(True)
        label_metric(axes.xaxis, name)
        axes.axvline(mean, color="0.3", linewidth=1.0)
        bars = [Patch(color=color) for color in (SKY, ORANGE)]
        axes.legend(
            bars,
            ["least tenth of the number", "largest tenth"],
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=2,
            borderaxespad=0.2,
        )
        axes.annotate(
            "rank correlation\nand its 95 % interval",
            (1.01, 1.0),
            xycoords="axes fraction",
            xytext=(0, 4),
            textcoords="offset points",
            fontsize=8.5,
        )
        return figure


def plot_crash_probability(
    studies: Study | Mapping[str, Study], path: str | None = None, *, num_bins: int | None = None
) -> Figure:
    """Plot the probability of a crash over a random parameter, with 95 % intervals.

    Each point is at the median of a bin of equally many samples, and its horizontal line spans the bin; see
    `crash_bins`. Thin lines are the probabilities over all samples.

    Args:
        studies: a study, or several by controller; the parameter is random in all of them.
        path: path of the parameter; by default the one with the largest influence on crashes.
        num_bins: as for `crash_bins`.

    Raises:
        InputError: no parameter is random, or not the one at this path.
    """
    studies = {studies.scenario.name: studies} if isinstance(studies, Study) else studies
    path = path or most_influential_path(studies.values())
    if path is None:
        raise InputError("no number is drawn in this study, over which the probability of a crash could be plotted")
    with new_panels(7.0, 4.2) as (figure, axes):
        for place, ((controller, study), (color, style)) in enumerate(
            zip(studies.items(), cycle(_LINES), strict=False)
        ):
            levels = crash_bins(study, path, num_bins=num_bins)
            if not levels:
                continue
            middle = np.array([level.middle for level in levels])
            value, low, high = np.transpose([level.probability for level in levels])
            aside = np.array([[level.middle - level.low, level.high - level.middle] for level in levels]).T
            whole = crash_probability(study.metrics)
            label = f"{controller}: {whole.percent()} of {len(study.samples):,} samples"
            upright = axes.errorbar(middle, value, [value - low, high - value], fmt="none", ecolor=color, capsize=2.5)
            across = axes.errorbar(middle, value, xerr=aside, fmt="none", ecolor=color, alpha=0.5)
            points = axes.plot(middle, value, color=color, linestyle=style, marker="o", markersize=4.0, label=label)
            # The offset separates controllers with equal values. It does not affect the limits of the axis.
            offset = _POINT_OFFSET * (place - 0.5 * (len(studies) - 1)) / 72.0
            there = axes.transData + ScaledTranslation(offset, 0.0, figure.dpi_scale_trans)
            for artist in (*upright.get_children(), *across.get_children(), *points):
                artist.set_transform(there)
            if np.all(middle == np.round(middle)) and not aside.any():
                axes.xaxis.set_major_locator(MaxNLocator(integer=True))
            axes.axhline(whole.value, color=color, linewidth=0.7)
        axes.set(xlabel=_field_label(next(iter(studies.values())), path), ylabel="probability of a crash")
        axes.set_ylim(bottom=0.0)
        _in_percent(axes.yaxis)
        axes.set_title("bins of equally many samples; bars: 95 % confidence", loc="left")
        if axes.lines:
            axes.legend(loc="best")
        return figure


def _in_percent(axis: Axis) -> None:
    axis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))


def _field_label(study: Study, path: str) -> str:
    """Return a short name of a field, with its unit."""
    unit = unit_at(study.scenario, path)
    short = path.removeprefix("laboratory.").replace("motion_capture.", "cameras: ").replace("command_link.", "link: ")
    for i, source in enumerate(study.scenario.laboratory.wind):
        short = short.replace(f"wind.{i}.", f"{source.kind} {i + 1}: ")
    short = short_name(short.removeprefix("vehicle."))
    return f"{short} ({unit})" if unit not in ("", "1") else short


def _count(studies: Mapping[str, Study]) -> str:
    """Return the number of samples of the studies as text."""
    counts = {len(study.samples) for study in studies.values()}
    return (
        f"{counts.pop():,} samples each"
        if len(counts) == 1 and len(studies) > 1
        else " and ".join(f"{count:,} samples" for count in sorted(counts))
    )
