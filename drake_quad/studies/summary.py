"""Summaries of a study as tables of texts."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from drake_quad.laboratory.metrics import METRICS, UNITS
from drake_quad.statistics.estimates import positive, quantile_interval, share_interval
from drake_quad.statistics.interval import Interval
from drake_quad.studies.statistics import compare_studies, crash_probability, metric_mean, of_survivors, with_crashes
from drake_quad.studies.study import Study

_QUANTILES = (0.05, 0.5, 0.95)


class Summary(NamedTuple):
    """Table of texts, with remarks that are needed to read it.

    Attributes:
        headings: headings of the columns.
        rows: rows with one cell for each column.
        remarks: remarks on the table.
    """

    headings: tuple[str, ...]
    rows: list[tuple[str, ...]]
    remarks: list[str]


def crashes_of(study: Study) -> str:
    """Return the number and probability of crashes as text, and those of crashes into obstacles if there are any."""
    crashes = f"{int(study.metrics.crashed.sum()):,} crashed, {crash_probability(study.metrics).percent()}"
    touched = sum(study.touches.values())
    if study.touched is None:
        return crashes
    return f"{crashes}; {touched:,} of them into obstacles, {share_interval(touched, len(study.samples)).percent()}"


def touches_of(study: Study) -> Summary:
    """Return the number and probability of the crashes into each obstacle, the most frequent obstacle first."""
    ordered = sorted(study.touches.items(), key=lambda each: -each[1])
    rows: list[tuple[str, ...]] = [
        (name, f"{count:,}", share_interval(count, len(study.samples)).percent()) for name, count in ordered if count
    ]
    return Summary(("crashed into", "samples", "share"), rows, [])


def summary_of(study: Study) -> Summary:
    """Return the means, deviations and quantiles of a study's metrics, with their 95 % intervals.

    Crashed samples are excluded from means, and count as worse than any error in quantiles.
    """
    metrics = study.metrics
    crashed, count = int(metrics.crashed.sum()), len(study.samples)
    beyond = "crash" if crashed else "∞"
    rows: list[tuple[str, ...]] = []
    for metric, definition in METRICS.items():
        if definition.display is None:
            continue
        size = definition.display.size
        values, everyone = of_survivors(metrics, metric), with_crashes(metrics, metric)
        spread = float(np.std(values, ddof=1)) if len(values) > 1 else math.nan
        quantiles = (_quantile(everyone, share) for share in _QUANTILES)
        rows.append(
            (
                definition.label,
                metric_mean(metrics, metric).text(size=size),
                Interval(spread, math.nan, math.nan).text(size=size),
                *(quantile.text(size=size, infinite=beyond) for quantile in quantiles),
                definition.display.unit,
            )
        )
    names = ("median" if share == 0.5 else f"{100.0 * share:.0f} % quantile" for share in _QUANTILES)
    return Summary(("", "mean", "std. dev.", *names, ""), rows, _remarks(crashed, count))


def _quantile(values: np.ndarray, probability: float) -> Interval:
    """Return a quantile of a nonnegative metric; if it is finite, its interval has no negative part."""
    found = quantile_interval(values, probability)
    return positive(found) if math.isfinite(found.value) else found


def _remarks(crashed: int, count: int) -> list[str]:
    if not crashed:
        return []
    if crashed == count:
        return ["no sample flew to the end: there is nothing to average"]
    survivors = "one sample" if count - crashed == 1 else f"{count - crashed:,} samples"
    return [
        f"means and deviations are of the {survivors} that flew to the end; quantiles are of all, a crash being worse"
        " than any error"
    ]


def comparison_of(studies: Mapping[str, Study], metric: str) -> Summary:
    """Compare each controller with the first one, on the samples on which neither crashed.

    Args:
        studies: studies with the same seed, by the name of the controller.
        metric: name of a metric for which smaller values are better.
    """
    (_, baseline), *others = studies.items()
    display = METRICS[metric].display
    unit, size = (UNITS[metric], 1.0) if display is None else display[:2]
    rows: list[tuple[str, ...]] = []
    for name, study in others:
        found = compare_studies(study, baseline, metric)
        alone = found.crashed + found.baseline_crashed
        rows.append(
            (
                name,
                found.difference.text(signed=True, size=size),
                found.share.percent(),
                found.better.percent(),
                f"{found.num_pairs:,}",
                f"{found.crashed:,} : {found.baseline_crashed:,}",
                f"p = {found.crash_significance:.2g}" if alone else "",
            )
        )
    crashed = any(study.metrics.crashed.any() for study in studies.values())
    remark = ["differences and shares are of the pairs, the samples that both controllers flew to the end"]
    headings = (
        "",
        f"difference of {METRICS[metric].label} ({unit})",
        "ratio of the means",
        "better in (% of pairs)",
        "pairs",
        "crashed only here : only baseline",
        "",
    )
    return Summary(headings, rows, remark if crashed else [])
