"""Table II of the replication, compared with the printed table.

For each cell and quantity, the table contains the values and the mean of three runs, as in the paper, and the mean of
all samples with its interval.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, Runs, published_table
from drake_quad.replication.results import select_cells
from drake_quad.reports.page import row
from drake_quad.reports.results import write_rows
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import Interval, values_without_crashes
from drake_quad.studies.study import Study

# Headings of the quantities of Table II in a report, keyed by the name of the metric.
QUANTITIES = {"rmse": "RMSE (m)", "effort_x": "control effort on X (m²/s⁴)", "effort_y": "control effort on Y (m²/s⁴)"}
_TABLE_HEADER = """\
| | | printed: three runs | mean | ours: three runs | mean | all samples, 95 % | deviation |
|---|---|---|---|---|---|---|---|"""


class TableEntry(NamedTuple):
    """Printed and replicated values of a quantity of Table II.

    Attributes:
        cell: wind and controller.
        quantity: name of the quantity, a key of `QUANTITIES`.
        printed: printed runs and their mean.
        runs: values of the first three samples and their mean.
        mean: mean of all samples without a crash.
        crashed: number of samples that crashed.
    """

    cell: Cell
    quantity: str
    printed: Runs
    runs: Runs
    mean: Interval
    crashed: int

    @property
    def deviation(self) -> float:
        """Relative difference between our mean and the printed mean; NaN if no mean is printed."""
        return self.mean.value / self.printed.mean - 1.0


def table_entries(cells: Mapping[Cell, Study]) -> list[TableEntry]:
    """Return an entry for each quantity and each cell, from the studies of the cells.

    If the paper does not print a cell, its printed values are NaN.
    """
    missing = Runs((math.nan, math.nan, math.nan), math.nan)
    printed = published_table()
    entries = []
    for quantity in QUANTITIES:
        for cell in select_cells(CONTROLLERS):
            metrics = cells[cell].metrics
            first, second, third = map(float, np.where(metrics.crashed, np.nan, getattr(metrics, quantity))[:3])
            entries.append(
                TableEntry(
                    cell,
                    quantity,
                    getattr(printed[cell], quantity) if cell in printed else missing,
                    Runs((first, second, third), float(np.mean([first, second, third]))),
                    mean_interval(values_without_crashes(metrics, quantity)),
                    int(metrics.crashed.sum()),
                )
            )
    return entries


def write_entries(path: Path, entries: Sequence[TableEntry]) -> Path:
    """Write a row for each entry, and return the path."""
    rows = []
    for entry in entries:
        columns: dict[str, Any] = {**entry.cell._asdict(), "quantity": entry.quantity}
        for name, (runs, mean) in (("printed", entry.printed), ("ours", entry.runs)):
            columns |= {f"{name}_run{number}": run for number, run in enumerate(runs, start=1)} | {f"{name}_mean": mean}
        rows.append(columns | dict(zip(("mean", "low", "high"), entry.mean, strict=True)) | {"crashed": entry.crashed})
    return write_rows(path, rows)


def table_markdown(entries: Sequence[TableEntry], quantity: str) -> str:
    """Return the entries of one quantity as a Markdown table."""
    rows = (
        (
            WINDS[entry.cell.wind],
            CONTROLLERS[entry.cell.controller],
            _runs(entry.printed),
            number_or_dash(entry.printed.mean),
            _runs(entry.runs),
            number_or_dash(entry.runs.mean),
            entry.mean.text(),
            percent_or_dash(entry.deviation),
        )
        for entry in entries
        if entry.quantity == quantity
    )
    return "\n".join([_TABLE_HEADER, *map(row, rows)])


def _runs(runs: Runs) -> str:
    return ", ".join(map(number_or_dash, runs.runs))


def number_or_dash(value: float) -> str:
    """Return a number with three decimals, or a dash if it is NaN."""
    return "–" if math.isnan(value) else f"{value:.3f}"


def percent_or_dash(fraction: float) -> str:
    """Return a relative difference in per cent, or a dash if it is NaN."""
    return "–" if math.isnan(fraction) else f"{100.0 * fraction:+.1f} %"
