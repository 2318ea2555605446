"""Comparison of several definitions of control effort, which the paper does not define, with its printed ratios."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.replication.claims import printed_effort_ratios
from drake_quad.replication.measures import EFFORTS
from drake_quad.replication.printed import Cell, printed_table
from drake_quad.replication.results import Experiment
from drake_quad.reports.results import write_rows
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import Interval


class EffortMatch(NamedTuple):
    """Agreement of a definition of effort with the printed ratios of the networks' efforts to the PD's.

    Attributes:
        name: name of the definition in `EFFORTS`.
        ratio_x: effort of the networks divided by that of the PD on X, as the geometric mean over cells and samples.
        ratio_y: corresponding ratio on Y.
        distance: typical factor between a ratio and its printed value: the exponential of the RMS, over all printed
            ratios, of the logarithm of their quotient.
    """

    name: str
    ratio_x: float
    ratio_y: float
    distance: Interval


def effort_matches(found: Experiment) -> list[EffortMatch]:
    """Return the agreement of every definition, the closest one first, with intervals over the recorded samples."""
    printed = printed_effort_ratios()
    wanted = np.array([printed[cell] for cell in printed]).T
    matches = []
    for name in EFFORTS:
        ratios = np.array([[_ratio(found, cell, f"{name}_{axis}") for cell in printed] for axis in "xy"])
        ratios[~np.isfinite(wanted)] = np.nan
        off = np.nanmean(np.log(ratios / wanted[:, :, None]) ** 2, axis=(0, 1)) ** 0.5
        distance = mean_interval(off[np.isfinite(off)])
        x, y = np.exp(np.nanmean(np.log(ratios), axis=(1, 2)))
        matches.append(EffortMatch(name, float(x), float(y), Interval(*(math.exp(each) for each in distance))))
    return sorted(matches, key=lambda match: match.distance.value)


def write_efforts(path: Path, matches: Sequence[EffortMatch]) -> Path:
    """Write a row for each definition, and return the path."""
    columns = ("definition", "ratio_x", "ratio_y", "off_by_factor", "low", "high")
    rows = ((EFFORTS[match.name].words, match.ratio_x, match.ratio_y, *match.distance) for match in matches)
    return write_rows(path, [dict(zip(columns, row, strict=True)) for row in rows])


def printed_ratios() -> tuple[float, float]:
    """Return the geometric means of the printed ratios on X and on Y."""
    x, y = np.exp(np.nanmean(np.log(list(printed_effort_ratios().values())), axis=0))
    return float(x), float(y)


def printed_scatter() -> float:
    """Return the typical factor between a printed ratio and its expected value, due to the scatter of the runs.

    The ratio is that of two means of three runs each. The factor follows from the standard deviation of the logarithms
    of the printed runs, pooled over all lines that have three runs.
    """
    printed = [each.runs for line in printed_table().values() for each in (line.effort_x, line.effort_y)]
    variance = float(np.nanmean([np.var(np.log(runs), ddof=1) for runs in printed]))
    return math.exp(math.sqrt(2.0 * variance / 3.0))


def _ratio(found: Experiment, cell: Cell, name: str) -> np.ndarray:
    """Return the ratio (samples,) of a cell's effort to that of the PD in the same wind."""
    return np.asarray(found.recorded[cell][name] / found.recorded[Cell(cell.wind, "pd")][name])
