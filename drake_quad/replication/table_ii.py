"""Table II of the replication, beside the printed one.

Each number stands there as in the paper, of three runs, and as the mean of all samples with its interval.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.files import write_table
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell, Runs, printed_table
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import Interval, of_survivors
from drake_quad.studies.study import Study

# The metrics that are the columns of Table II, and what a report calls them.
QUANTITIES = {"rmse": "RMSE (m)", "effort_x": "control effort on X (m²/s⁴)", "effort_y": "control effort on Y (m²/s⁴)"}


class Entry(NamedTuple):
    """A number of Table II.

    Attributes:
        cell: of controller and wind.
        quantity: one of `QUANTITIES`.
        printed: what the paper prints.
        runs: the first three samples and their mean.
        mean: of all samples that flew to the end.
        crashed: the number of samples that crashed.
    """

    cell: Cell
    quantity: str
    printed: Runs
    runs: Runs
    mean: Interval
    crashed: int

    @property
    def off(self) -> float:
        """The difference of the mean from the printed one, as a share of that; NaN where none is printed."""
        return self.mean.value / self.printed.mean - 1.0


def table_entries(cells: Mapping[Cell, Study]) -> list[Entry]:
    """Every number of Table II, from the studies of its cells; and those of the cells that the paper leaves out."""
    gap = Runs((math.nan, math.nan, math.nan), math.nan)
    printed = printed_table()
    entries = []
    for quantity in QUANTITIES:
        for wind in WINDS:
            for controller in CONTROLLERS:
                cell = Cell(wind, controller)
                study = cells[cell]
                values = np.where(study.metrics.crashed, np.nan, getattr(study.metrics, quantity))
                first, second, third = (float(value) for value in values[:3])
                entries.append(
                    Entry(
                        cell,
                        quantity,
                        getattr(printed[cell], quantity) if cell in printed else gap,
                        Runs((first, second, third), float(np.mean([first, second, third]))),
                        mean_interval(of_survivors(study.metrics, quantity)),
                        int(study.metrics.crashed.sum()),
                    )
                )
    return entries


def write_entries(path: Path, entries: Sequence[Entry]) -> Path:
    """Writes a row for each number, and returns the path."""
    columns: dict[str, list] = {
        "wind": [entry.cell.wind for entry in entries],
        "controller": [entry.cell.controller for entry in entries],
        "quantity": [entry.quantity for entry in entries],
    }
    for name, found in (("printed", [entry.printed for entry in entries]), ("ours", [entry.runs for entry in entries])):
        for number, values in enumerate(zip(*(each.runs for each in found), strict=True), start=1):
            columns[f"{name}_run{number}"] = list(values)
        columns[f"{name}_mean"] = [each.mean for each in found]
    for end, column in zip(Interval._fields, ("mean", "low", "high"), strict=True):
        columns[column] = [getattr(entry.mean, end) for entry in entries]
    return write_table(path, columns | {"crashed": [entry.crashed for entry in entries]})


def table_markdown(entries: Sequence[Entry], quantity: str) -> str:
    """Return the numbers of one quantity as a table in Markdown."""
    lines = [
        "| | | printed: three runs | mean | ours: three runs | mean | all samples, 95 % | off |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for entry in entries:
        if entry.quantity == quantity:
            lines.append(
                f"| {WINDS[entry.cell.wind]} | {CONTROLLERS[entry.cell.controller]} | {_runs(entry.printed)}"
                f" | {_number(entry.printed.mean)} | {_runs(entry.runs)} | {_number(entry.runs.mean)}"
                f" | {entry.mean.text()} | {_percent(entry.off)} |"
            )
    return "\n".join(lines)


def _runs(runs: Runs) -> str:
    return ", ".join(_number(value) for value in runs.runs)


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.3f}"


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100.0 * share:+.1f} %"
