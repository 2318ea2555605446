"""Comparison of possible definitions of control effort with printed effort ratios. The paper does not define effort."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.replication.claims import published_effort_ratios
from drake_quad.replication.measures import EFFORTS
from drake_quad.replication.published import Cell, published_table
from drake_quad.replication.results import Experiment
from drake_quad.reports.results import write_rows
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import Interval


class EffortMatch(NamedTuple):
    """Agreement of a definition of effort with the printed ratios of network effort to PD effort.

    Attributes:
        name: name of the definition in `EFFORTS`.
        ratio_x: effort of the networks on X divided by the PD's effort, as the geometric mean over cells and samples.
        ratio_y: effort of the networks on Y divided by the PD's effort, as the same mean.
        distance: typical factor between our ratios and the printed ratios: exp(RMS of log(ours / printed)) over all
            printed ratios.
    """

    name: str
    ratio_x: float
    ratio_y: float
    distance: Interval


def effort_matches(experiment: Experiment) -> list[EffortMatch]:
    """Compare each definition of control effort in `EFFORTS` with the printed effort ratios.

    Returns:
        A result for each definition, sorted by agreement, the best first. The intervals refer to the mean over the
        recorded samples.
    """
    printed = published_effort_ratios()
    printed_values = np.array([printed[cell] for cell in printed]).T
    matches = []
    for name in EFFORTS:
        ratios = np.array([[_ratio(experiment, cell, f"{name}_{axis}") for cell in printed] for axis in "xy"])
        ratios[~np.isfinite(printed_values)] = np.nan
        log_distances = np.nanmean(np.log(ratios / printed_values[:, :, None]) ** 2, axis=(0, 1)) ** 0.5
        distance = mean_interval(log_distances[np.isfinite(log_distances)])
        x, y = np.exp(np.nanmean(np.log(ratios), axis=(1, 2)))
        matches.append(EffortMatch(name, float(x), float(y), Interval(*(math.exp(each) for each in distance))))
    return sorted(matches, key=lambda match: match.distance.value)


def write_efforts(path: Path, matches: Sequence[EffortMatch]) -> Path:
    """Write a row for each definition, and return the path."""
    columns = ("definition", "ratio_x", "ratio_y", "off_by_factor", "low", "high")
    rows = ((EFFORTS[match.name].definition, match.ratio_x, match.ratio_y, *match.distance) for match in matches)
    return write_rows(path, [dict(zip(columns, row, strict=True)) for row in rows])


def published_ratios() -> tuple[float, float]:
    """Return the geometric means of the printed effort ratios on X and on Y."""
    x, y = np.exp(np.nanmean(np.log(list(published_effort_ratios().values())), axis=0))
    return float(x), float(y)


def published_scatter() -> float:
    """Return the geometric standard deviation of a printed effort ratio, which is due to the scatter of the runs.

    A printed ratio typically differs by this factor from its expected value. Both efforts in a ratio are means of three
    runs. The factor follows from the standard deviation of the logarithms of the printed runs, pooled over all lines of
    the table with three runs.
    """
    printed = [each.runs for line in published_table().values() for each in (line.effort_x, line.effort_y)]
    variance = float(np.nanmean([np.var(np.log(runs), ddof=1) for runs in printed]))
    return math.exp(math.sqrt(2.0 * variance / 3.0))


def _ratio(experiment: Experiment, cell: Cell, name: str) -> np.ndarray:
    """Return a recorded measure of a cell (samples,), divided by the PD's measure in the same wind."""
    return np.asarray(experiment.recorded[cell][name] / experiment.recorded[Cell(cell.wind, "pd")][name])
