"""Plots of Monte Carlo studies: distributions, convergence, and influences of random parameters."""

from collections.abc import Iterable, Mapping
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator, PercentFormatter
from matplotlib.transforms import ScaledTranslation

from drake_quad.errors import InputError
from drake_quad.scenario.description import unit_at
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

_LINE_STYLES = [(BLUE, "-"), (VERMILION, "--"), (GREEN, "-."), (PURPLE, ":"), (ORANGE, "-"), (SKY, "--"), (BLACK, "-.")]
# Largest number of parameters in a tornado chart.
_MAX_FIELDS = 16
# Horizontal offset, in points, between the marks of successive controllers, which separates equal values.
_POINT_OFFSET = 3.0
# The axis of a metric that cannot be negative is logarithmic if the largest median exceeds the smallest by this factor.
_LOG_AXIS_RATIO = 10.0


def label_metric(axis: Axis, studies: Iterable[Study], name: str, prefix: str = "") -> None:
    """Label an axis with a metric, and show the tick values in the unit that tables use.

    Args:
        axis: axis on which the metric is drawn in the unit of `Metrics`.
        studies: drawn studies, which all have the metric.
        name: name of the metric, or "crashed" for the fraction of crashes.
        prefix: words before the name of the metric.
    """
    if name == "crashed":
        axis.set_label_text("crashed samples")
        _in_percent(axis)
        return
    definition = next(iter(studies)).metrics.definitions[name]
    unit, size = definition.unit, 1.0
    if definition.display is not None:
        unit, size, _ = definition.display
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / size:g}"))
    axis.set_label_text(f"{prefix}{definition.label} ({unit})")


def plot_distribution(studies: Mapping[str, Study], name: str = "rmse") -> Figure:
    """Plot the empirical distribution function of a metric, with a line for each controller.

    A crashed sample counts as worse than every sample that did not crash. Infinite values are not drawn, but count.

    Each band contains the whole true distribution function with 95 % confidence, by the inequality of Dvoretzky,
    Kiefer, Wolfowitz and Massart.

    Args:
        studies: study of each controller, by name.
        name: name of the metric.
    """
    with new_panels(7.0, 4.2) as (figure, axes):
        draw_distribution(axes, studies, name)
        return figure


def draw_distribution(axes: Axes, studies: Mapping[str, Study], name: str) -> None:
    """Draw the plot of `plot_distribution` in existing axes.

    Args:
        axes: axes to draw into.
        studies: study of each controller, by name.
        name: name of the metric.
    """
    for (controller, study), (color, style) in zip(studies.items(), cycle(_LINE_STYLES), strict=False):
        values = np.sort(values_with_crashes(study.metrics, name))
        n = len(values)
        is_finite = np.isfinite(values)
        finite, fraction = values[is_finite], np.arange(1, n + 1)[is_finite] / n
        half_width = np.sqrt(np.log(2.0 / 0.05) / (2.0 * n))
        label = controller
        if study.metrics.crashed.any():
            label += f" ({crash_probability(study.metrics, study.replicates).without_interval().percent()} crashed)"
        axes.step(finite, fraction, where="post", color=color, linestyle=style, label=label)
        axes.fill_between(
            finite,
            np.maximum(fraction - half_width, 0.0),
            np.minimum(fraction + half_width, 1.0),
            step="post",
            color=color,
            alpha=0.15,
            linewidth=0.0,
        )
    axes.set(ylabel="cumulative share of samples", ylim=(0.0, 1.02))
    survivors = [values_without_crashes(study.metrics, name) for study in studies.values()]
    medians = [median for values in survivors if len(values) and 0.0 < (median := np.median(values)) < np.inf]
    can_be_logarithmic = all(study.metrics.definitions[name].is_nonnegative for study in studies.values())
    if can_be_logarithmic and medians and max(medians) > _LOG_AXIS_RATIO * min(medians):
        axes.set_xscale("log")
    label_metric(axes.xaxis, studies.values(), name)
    _in_percent(axes.yaxis)
    axes.set_title(f"{_num_samples_text(studies)}; bands: 95 % confidence", loc="left")
    axes.legend(loc="lower right")


def plot_convergence(studies: Mapping[str, Study], name: str = "rmse") -> Figure:
    """Plot the mean of a metric and the fraction of crashes over the number of samples.

    If no sample crashed, the 95 % quantile of the metric is plotted instead of the fraction of crashes.

    Args:
        studies: study of each controller, by name.
        name: name of the metric.
    """
    crashes = any(study.metrics.crashed.any() for study in studies.values())
    with new_panels(9.0, 3.8, 1, 2) as (figure, ((left, right),)):
        for (controller, study), (color, style) in zip(studies.items(), cycle(_LINE_STYLES), strict=False):
            count, mean, low, high = _running_mean(study, name)
            left.plot(count, mean, color=color, linestyle=style, label=controller)
            left.fill_between(count, low, high, color=color, alpha=0.15, linewidth=0.0)
            stops = np.unique(np.geomspace(min(20, len(study.samples)), len(study.samples), 60).astype(int))
            values = study.metrics.crashed if crashes else getattr(study.metrics, name)
            first = [(study.replicates.take(slice(stop)), values[:stop]) for stop in stops]
            estimates = [each.proportion(part) if crashes else each.quantile(part, 0.95) for each, part in first]
            intervals = np.array(estimates)
            value, low, high = np.where(np.isfinite(intervals), intervals, np.nan).T
            right.plot(stops, value, color=color, linestyle=style, label=controller)
            right.fill_between(stops, low, high, color=color, alpha=0.15, linewidth=0.0)
        left.set_title("mean over the flights without a crash", loc="left")
        label_metric(left.yaxis, studies.values(), name)
        right.set_title("crashes" if crashes else "95 % quantile", loc="left")
        label_metric(right.yaxis, studies.values(), "crashed" if crashes else name)
        for axes in (left, right):
            # Matplotlib cannot scale an empty axis logarithmically.
            drawn = any(np.isfinite(line.get_ydata()).any() for line in axes.lines)
            axes.set(xscale="log" if drawn else "linear", xlabel="number of samples; bands: 95 % confidence")
            if drawn:
                axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axes.xaxis.set_minor_locator(NullLocator())
                axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
            else:
                axes.set(xticks=[], yticks=[])
                axes.text(0.5, 0.5, "no finite value", transform=axes.transAxes, ha="center", va="center")
        left.legend(loc="best")
        return figure


def _running_mean(study: Study, name: str) -> tuple[np.ndarray, ...]:
    """Return numbers n of flights without a crash, the mean over the first n, and the ends of the 95 % interval."""
    used = ~(study.metrics.crashed | np.isnan(getattr(study.metrics, name)))
    count, *means = study.replicates.take(used).running_mean(getattr(study.metrics, name)[used])
    # The first few points are left out, because their wide intervals would dominate the axis.
    drawn = count >= min(10, len(used.nonzero()[0]))
    return count[drawn], *(each[drawn] for each in means)


def plot_influences(study: Study, name: str = "rmse") -> Figure:
    """Plot a tornado chart: the mean of a metric in the lowest and in the highest tenth of each random parameter.

    If the metric depends more on the distance of a parameter from its median than on the parameter itself, the rank
    correlation with this distance is also given.

    Args:
        study: study of a scenario with distributions.
        name: name of the metric, or "crashed" for the fraction of crashes.
    """
    ranking = influences(study, name)
    with new_panels(11.0, 1.4 + 0.34 * max(min(len(ranking), _MAX_FIELDS), 1)) as (figure, axes):
        mean = float(
            np.mean(study.metrics.crashed if name == "crashed" else values_without_crashes(study.metrics, name))
        )
        for row, influence in enumerate(ranking[:_MAX_FIELDS]):
            for end, color, offset in ((influence.low, SKY, -0.18), (influence.high, ORANGE, 0.18)):
                axes.barh(row + offset, end.value - mean, 0.36, left=mean, color=color)
                axes.plot([end.low, end.high], [row + offset] * 2, color="0.25", linewidth=1.0)
            rho = influence.correlation
            text = rho.text(signed=True)
            if influence.partial != rho and np.isfinite(influence.partial.value):
                text += f"; partial {influence.partial.value:+.2f}"
            if influence.strongest != rho and influence.is_significant:
                text += f"; of the distance {influence.distance.value:+.2f}"
            axes.annotate(text, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=8.5)
        labels = [_field_label(study, influence.path) for influence in ranking[:_MAX_FIELDS]]
        name_rows(axes, labels)
        axes.set_axisbelow(True)
        label_metric(axes.xaxis, [study], name)
        axes.axvline(mean, color="0.3", linewidth=1.0)
        bars = [Patch(color=color) for color in (SKY, ORANGE)]
        axes.legend(
            bars,
            ["lowest tenth of the parameter", "highest tenth"],
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=2,
            borderaxespad=0.2,
        )
        axes.annotate(
            "rank correlation [95 % interval]; of the\ndistance from the median if it is larger",
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
    """Plot the probability of a crash over a random parameter, with 95 % confidence intervals.

    The samples are divided into bins of equal size. Each point is at the median of a bin, and its horizontal line spans
    the bin; see `crash_bins`. Thin horizontal lines are the probabilities over all samples.

    Args:
        studies: study, or several studies by controller; the parameter must be random in all of them.
        path: path of the parameter; by default the parameter with the largest influence on crashes.
        num_bins: number of bins; None for the default of `crash_bins`.

    Raises:
        InputError: if the studies have no random parameter, or no random parameter at this path.
    """
    studies = {studies.scenario.name: studies} if isinstance(studies, Study) else studies
    path = path or most_influential_path(studies.values())
    if path is None:
        raise InputError("the crash probability cannot be plotted: this study has no random parameter")
    with new_panels(7.0, 4.2) as (figure, axes):
        for index, ((controller, study), (color, style)) in enumerate(
            zip(studies.items(), cycle(_LINE_STYLES), strict=False)
        ):
            levels = crash_bins(study, path, num_bins=num_bins)
            if not levels:
                continue
            middle = np.array([level.middle for level in levels])
            value, low, high = np.transpose([level.probability for level in levels])
            half_widths = np.array([[level.middle - level.low, level.high - level.middle] for level in levels]).T
            overall = crash_probability(study.metrics, study.replicates)
            label = f"{controller}: {overall.percent()} of {len(study.samples):,} samples"
            vertical_bars = axes.errorbar(
                middle, value, [value - low, high - value], fmt="none", ecolor=color, capsize=2.5
            )
            horizontal_bars = axes.errorbar(middle, value, xerr=half_widths, fmt="none", ecolor=color, alpha=0.5)
            points = axes.plot(middle, value, color=color, linestyle=style, marker="o", markersize=4.0, label=label)
            # The offset separates controllers with equal values. It does not change the limits of the axis.
            offset = _POINT_OFFSET * (index - 0.5 * (len(studies) - 1)) / 72.0
            shifted = axes.transData + ScaledTranslation(offset, 0.0, figure.dpi_scale_trans)
            for artist in (*vertical_bars.get_children(), *horizontal_bars.get_children(), *points):
                artist.set_transform(shifted)
            if np.all(middle == np.round(middle)) and not half_widths.any():
                axes.xaxis.set_major_locator(MaxNLocator(integer=True))
            axes.axhline(overall.value, color=color, linewidth=0.7)
        axes.set(xlabel=_field_label(next(iter(studies.values())), path), ylabel="crash probability")
        axes.set_ylim(bottom=0.0)
        _in_percent(axes.yaxis)
        axes.set_title("bins of equal size; bars: 95 % confidence", loc="left")
        if axes.lines:
            axes.legend(loc="best")
        return figure


def _in_percent(axis: Axis) -> None:
    axis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))


def _field_label(study: Study, path: str) -> str:
    """Return the label of a random parameter: its short name with its unit."""
    unit = unit_at(study.scenario, path)
    return f"{short_name(path)} ({unit})" if unit not in ("", "1") else short_name(path)


def _num_samples_text(studies: Mapping[str, Study]) -> str:
    """Return the number of samples of the studies as text."""
    counts = {len(study.samples) for study in studies.values()}
    return (
        f"{counts.pop():,} samples each"
        if len(counts) == 1 and len(studies) > 1
        else " and ".join(f"{count:,} samples" for count in sorted(counts))
    )
