"""Control effort, which the paper does not define: which definitions come close to its printed ratios."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.studies.statistics import Interval, mean_interval
from drake_quad.replication.claims import printed_effort_shares
from drake_quad.files import write_table
from drake_quad.replication.measures import EFFORTS
from drake_quad.replication.printed import Cell, table_ii
from drake_quad.replication.results import Experiment


class EffortMatch(NamedTuple):
    """How close a definition comes to the printed ratios of networks to PD.

    Attributes:
        name: of the definition, in `EFFORTS`.
        shares: efforts of the networks over those of the PD, geometric means over cells, on X and on Y.
        distance: factor by which its ratios are typically off: the exponential of the root mean square of the logarithm
            of ratio over printed ratio, over all that are printed.
    """

    name: str
    shares: tuple[float, float]
    distance: Interval


def effort_matches(found: Experiment) -> list[EffortMatch]:
    """How close each definition comes, the closest first; the intervals are over recorded samples."""
    printed = printed_effort_shares()
    wanted = np.array([printed[cell] for cell in printed]).T
    matches = []
    for name in EFFORTS:
        shares = np.array([[_share(found, cell, f"{name}_{axis}") for cell in printed] for axis in "xy"])
        shares[~np.isfinite(wanted)] = np.nan
        off = np.nanmean(np.log(shares / wanted[:, :, None]) ** 2, axis=(0, 1)) ** 0.5
        distance = mean_interval(off[np.isfinite(off)])
        x, y = np.exp(np.nanmean(np.log(shares), axis=(1, 2)))
        matches.append(EffortMatch(name, (float(x), float(y)), Interval(*(math.exp(each) for each in distance))))
    return sorted(matches, key=lambda match: match.distance.value)


def write_efforts(path: Path, matches: Sequence[EffortMatch]) -> Path:
    """Writes a row for each definition and returns the path."""
    return write_table(
        path,
        {
            "definition": [EFFORTS[match.name].words for match in matches],
            "ratio_x": [match.shares[0] for match in matches],
            "ratio_y": [match.shares[1] for match in matches],
            "off_by_factor": [match.distance.value for match in matches],
            "low": [match.distance.low for match in matches],
            "high": [match.distance.high for match in matches],
        },
    )


def printed_shares() -> tuple[float, float]:
    """Geometric means of the printed ratios, on X and on Y."""
    x, y = np.exp(np.nanmean(np.log(list(printed_effort_shares().values())), axis=0))
    return float(x), float(y)


def printed_scatter() -> float:
    """Factor by which a printed ratio is off because its means are of three runs that differ.

    From the standard deviation of the logarithm of the printed runs, pooled over all lines with three of them.
    """
    printed = [each.runs for line in table_ii().values() for each in (line.effort_x, line.effort_y)]
    variance = float(np.nanmean([np.var(np.log(runs), ddof=1) for runs in printed]))
    return math.exp(math.sqrt(2.0 * variance / 3.0))


def _share(found: Experiment, cell: Cell, name: str) -> np.ndarray:
    """(samples,) efforts of a network over those of the PD in the same wind."""
    return np.asarray(found.recorded[cell][name] / found.recorded[Cell(cell.wind, "pd")][name])
