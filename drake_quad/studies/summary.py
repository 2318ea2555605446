"""Tables of text that summarise and compare studies."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from drake_quad.laboratory.metrics import Display, Metric
from drake_quad.statistics.estimates import quantile_interval, without_negative_part
from drake_quad.statistics.interval import INFINITIES, Interval
from drake_quad.statistics.replicates import Replicates
from drake_quad.studies.statistics import (
    compare_studies,
    crash_probability,
    influences,
    metric_mean,
    requirement_probability,
    values_with_crashes,
    values_without_crashes,
)
from drake_quad.studies.study import Study

_QUANTILES = (0.05, 0.5, 0.95)  # probabilities of the quantiles in a table


class Summary(NamedTuple):
    """Table of text cells, with the remarks that a reader needs to interpret the table.

    Attributes:
        headings: headings of the columns.
        rows: rows with one cell for each column.
        remarks: remarks on the table.
    """

    headings: tuple[str, ...]
    rows: list[tuple[str, ...]]
    remarks: list[str]


def crash_text(study: Study) -> str:
    """Return the number and probability of all crashes and, if there are obstacles, of crashes into them, as text."""
    crashes = (
        f"{int(study.metrics.crashed.sum()):,} crashed, {crash_probability(study.metrics, study.replicates).percent()}"
    )
    if study.obstacle_hit is None:
        return crashes
    into_obstacles = sum(study.crashes_by_obstacle.values())
    probability = study.replicates.proportion(study.obstacle_hit > 0).percent()
    return f"{crashes}; {into_obstacles:,} of them into obstacles, {probability}"


def obstacle_table(study: Study) -> Summary:
    """Return the number and probability of the crashes into each obstacle, in the order of decreasing probability."""
    counts, obstacle_hit = study.crashes_by_obstacle, np.asarray(study.obstacle_hit)
    numbers = {name: number for number, name in enumerate(counts, start=1) if counts[name]}
    rows: list[tuple[str, ...]] = [
        (name, f"{counts[name]:,}", study.replicates.proportion(obstacle_hit == numbers[name]).percent())
        for name in sorted(numbers, key=lambda name: -counts[name])
    ]
    return Summary(("crashed into", "samples", "fraction"), rows, [])


def influence_table(study: Study, name: str, count: int = 3) -> Summary:
    """Return the random parameters with the largest influence on a metric, and their rank correlations with it.

    Only correlations whose 95 % interval does not contain zero are given.

    Args:
        study: study of a scenario with distributions.
        name: name of the metric, or "crashed" for the influence on crashes.
        count: largest number of parameters.
    """
    label = "crashes" if name == "crashed" else study.metrics.definitions[name].label
    found = [each for each in influences(study, name) if each.is_significant]
    kinds = ["" if each.strongest == each.correlation else "of the distance from its median" for each in found]
    rows: list[tuple[str, ...]] = [
        (each.path, each.strongest.text(signed=True), kind) for each, kind in zip(found, kinds, strict=True)
    ]
    remarks = [] if rows else [f"no random parameter has a significant influence on {label}"]
    return Summary((f"largest influences on {label}", "rank correlation", ""), rows[:count], remarks)


def metric_table(study: Study) -> Summary:
    """Return the means, deviations and quantiles of a study's metrics, with their 95 % intervals.

    Crashed samples are excluded from means, and count as worse than any error in quantiles.
    """
    metrics = study.metrics
    crashed, count = int(metrics.crashed.sum()), len(study.samples)
    rows: list[tuple[str, ...]] = []
    for metric, definition in metrics.definitions.items():
        if definition.display is None or metric in study.scenario.requirements:
            continue
        size = definition.display.size
        values, all_values = values_without_crashes(metrics, metric), values_with_crashes(metrics, metric)
        is_finite = bool(np.isfinite(values).all())
        spread = float(np.std(values, ddof=1)) if len(values) > 1 and is_finite else math.nan
        infinities = definition.infinities_with_crash if crashed and is_finite else INFINITIES
        quantiles = (_quantile(all_values, probability, definition, study.replicates) for probability in _QUANTILES)
        rows.append(
            (
                definition.label,
                metric_mean(metrics, metric, study.replicates).text(size=size),
                Interval(spread, math.nan, math.nan).text(size=size),
                *(quantile.text(size=size, infinities=infinities) for quantile in quantiles),
                definition.display.unit,
            )
        )
    names = ("median" if probability == 0.5 else f"{100.0 * probability:.0f} % quantile" for probability in _QUANTILES)
    return Summary(("", "mean", "std. dev.", *names, ""), rows, _remarks(crashed, count))


def requirement_table(study: Study) -> Summary:
    """Return the probability that each requirement is satisfied, and quantiles of its robustness."""
    metrics, rows = study.metrics, []
    for name in study.scenario.requirements:
        definition = metrics.definitions[name]
        display = definition.display
        assert display is not None
        infinities = definition.infinities_with_crash if metrics.crashed.any() else INFINITIES
        values = values_with_crashes(metrics, name)
        quantiles = (_quantile(values, probability, definition, study.replicates) for probability in _QUANTILES[:2])
        texts = [quantile.text(size=display.size, infinities=infinities) for quantile in quantiles]
        satisfied = requirement_probability(metrics, name, study.replicates)
        rows.append((name, satisfied.percent(), *texts, display.unit))
    return Summary(("requirement", "satisfied", "5 % quantile of robustness", "median", ""), rows, [])


def overview_table(studies: Mapping[str, Study]) -> Summary:
    """Return crashes, requirements and medians of additional metrics, with a row for each controller.

    A crash counts as worse than any value in the medians. The table has no rows if there are neither requirements nor
    additional metrics that all studies have.

    Args:
        studies: study of each controller, by name.
    """
    scenarios = [study.scenario for study in studies.values()]
    requirements = [name for name in scenarios[0].requirements if all(name in each.requirements for each in scenarios)]
    additional = scenarios[0].metrics.additional
    metrics = [name for name in additional if all(name in each.metrics.additional for each in scenarios)]
    if not requirements and not metrics:
        return Summary((), [], [])
    definitions = next(iter(studies.values())).metrics.definitions
    displays = {name: definitions[name].display or Display(definitions[name].unit, 1.0, 3) for name in metrics}
    rows = []
    for controller, study in studies.items():
        medians = []
        for name, display in displays.items():
            median = quantile_interval(values_with_crashes(study.metrics, name), 0.5).without_interval()
            has_crashes = study.metrics.crashed.any() and np.isfinite(values_without_crashes(study.metrics, name)).all()
            infinities = definitions[name].infinities_with_crash if has_crashes else INFINITIES
            medians.append(median.text(size=display.size, infinities=infinities))
        probabilities = [
            requirement_probability(study.metrics, name, study.replicates).percent() for name in requirements
        ]
        crashes = crash_probability(study.metrics, study.replicates).percent()
        rows.append((controller, crashes, *probabilities, *medians))
    headings = [f"median {definitions[name].label} ({display.unit})" for name, display in displays.items()]
    return Summary(("", "crashed", *requirements, *headings), rows, [])


def _quantile(values: np.ndarray, probability: float, definition: Metric, replicates: Replicates) -> Interval:
    """Return a quantile with its interval, which begins at 0 or above if the metric cannot be negative."""
    quantile, is_nonnegative = replicates.quantile(values, probability), definition.is_nonnegative
    return without_negative_part(quantile) if is_nonnegative and math.isfinite(quantile.value) else quantile


def _remarks(crashed: int, count: int) -> list[str]:
    if not crashed:
        return []
    if crashed == count:
        return ["every sample crashed, so there are no means"]
    survivors = "one sample" if count - crashed == 1 else f"{count - crashed:,} samples"
    return [
        f"means and standard deviations are taken over the {survivors} without a crash; quantiles are taken"
        " over all samples, where a crash counts as worse than any error"
    ]


def comparison_table(studies: Mapping[str, Study], metric: str) -> Summary:
    """Compare each controller with the first controller, on the samples on which neither crashed.

    Args:
        studies: studies with the same seed, by the name of the controller.
        metric: name of a metric for which smaller values are better.
    """
    (_, baseline), *others = studies.items()
    definition = baseline.metrics.definitions[metric]
    unit, size = (definition.unit, 1.0) if definition.display is None else definition.display[:2]
    rows: list[tuple[str, ...]] = []
    for name, study in others:
        comparison = compare_studies(study, baseline, metric)
        num_different = comparison.crashed + comparison.baseline_crashed
        rows.append(
            (
                name,
                comparison.difference.text(signed=True, size=size),
                comparison.ratio.percent(),
                comparison.better.percent(),
                f"{comparison.num_pairs:,}",
                f"{comparison.crashed:,} : {comparison.baseline_crashed:,}",
                f"p = {comparison.crash_significance:.2g}" if num_different else "",
            )
        )
    crashed = any(study.metrics.crashed.any() for study in studies.values())
    remark = ["differences and ratios are taken over the pairs: samples on which neither controller crashed"]
    headings = (
        "",
        f"difference of {definition.label} ({unit})",
        "ratio of the means",
        "better in (% of pairs)",
        "pairs",
        "crashed only here : only with baseline",
        "",
    )
    return Summary(headings, rows, remark if crashed else [])
