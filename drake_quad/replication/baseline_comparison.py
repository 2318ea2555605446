"""Comparison of the paper's PD and PD+T2FNN with simple controllers that the paper does not consider."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from drake_quad.replication.published import CONTROLLERS, Cell
from drake_quad.replication.results import FAIR_CONTROLLERS, Experiment, select_cells
from drake_quad.reports.results import write_rows
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import Interval, values_without_crashes

COMPARED_CONTROLLERS = {"pd": CONTROLLERS["pd"], "pd_t2fnn": CONTROLLERS["pd_t2fnn"], **FAIR_CONTROLLERS}


class FairEntry(NamedTuple):
    """Result of a controller in a wind.

    Attributes:
        cell: controller and wind.
        rmse: mean RMSE, m.
        peak_error: mean peak error, m.
        effort_x: mean control effort on X, m²/s⁴.
        effort_y: mean control effort on Y, m²/s⁴.
        over_pd: ratio of the mean RMSE to the mean RMSE of the PD on the same samples.
        over_network: ratio of the mean RMSE to the mean RMSE of PD+T2FNN on the same samples.
    """

    cell: Cell
    rmse: Interval
    peak_error: Interval
    effort_x: Interval
    effort_y: Interval
    over_pd: Interval
    over_network: Interval


def fair_entries(experiment: Experiment) -> list[FairEntry]:
    """Return the results of all compared controllers, sorted by wind."""
    entries = []
    for cell in select_cells(COMPARED_CONTROLLERS):
        means = [
            mean_interval(values_without_crashes(experiment.cells[cell].metrics, name))
            for name in ("rmse", "peak_error", "effort_x", "effort_y")
        ]
        ratios = [experiment.comparison(cell, Cell(cell.wind, name)).ratio for name in ("pd", "pd_t2fnn")]
        entries.append(FairEntry(cell, *means, *ratios))
    return entries


def write_fair(path: Path, entries: Sequence[FairEntry]) -> Path:
    """Write a row for each entry, and return the path."""
    return write_rows(
        path, [entry.cell._asdict() | dict(zip(entry._fields[1:], entry[1:], strict=True)) for entry in entries]
    )
