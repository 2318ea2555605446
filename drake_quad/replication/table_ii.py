"""Table II again: three runs and their mean as the paper has, and the mean of all samples with its interval."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.studies import Study
from drake_quad.studies.statistics import Interval, mean_interval, of_survivors
from drake_quad.files import write_table
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell, Runs, table_ii

# Columns of Table II, and the metrics that stand for them.
QUANTITIES = {"rmse": "RMSE (m)", "effort_x": "control effort on X (m²/s⁴)", "effort_y": "control effort on Y (m²/s⁴)"}


class Entry(NamedTuple):
    """A number of Table II.

    Attributes:
        cell: whose it is.
        quantity: one of `QUANTITIES`.
        printed: by the paper.
        runs: the first three samples, and their mean.
        mean: of all samples that flew to the end.
        crashed: samples that did not.
    """

    cell: Cell
    quantity: str
    printed: Runs
    runs: Runs
    mean: Interval
    crashed: int

    @property
    def off(self) -> float:
        """By which share of the printed mean the mean of all samples differs; NaN where none is printed."""
        return self.mean.value / self.printed.mean - 1.0


def table_entries(cells: Mapping[Cell, Study]) -> list[Entry]:
    """Every number of Table II, from the studies of its cells; also those of cells that it does not have."""
    nothing = Runs((math.nan, math.nan, math.nan), math.nan)
    printed = table_ii()
    entries = []
    for quantity in QUANTITIES:
        place = {"rmse": 0, "effort_x": 1, "effort_y": 2}[quantity]
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
                        printed[cell][place] if cell in printed else nothing,
                        Runs((first, second, third), float(np.mean([first, second, third]))),
                        mean_interval(of_survivors(study.metrics, quantity)),
                        int(study.metrics.crashed.sum()),
                    )
                )
    return entries


def write_table(path: Path, entries: Sequence[Entry]) -> Path:
    """Writes a row for each number and returns the path."""
    columns: dict[str, list] = {
        "wind": [entry.cell.wind for entry in entries],
        "controller": [entry.cell.controller for entry in entries],
        "quantity": [entry.quantity for entry in entries],
    }
    for whose in ("printed", "runs"):
        name = "ours" if whose == "runs" else whose
        for i in range(3):
            columns[f"{name}_run{i + 1}"] = [getattr(entry, whose).runs[i] for entry in entries]
        columns[f"{name}_mean"] = [getattr(entry, whose).mean for entry in entries]
    for end, column in zip(Interval._fields, ("mean", "low", "high"), strict=True):
        columns[column] = [getattr(entry.mean, end) for entry in entries]
    return write_table(path, columns | {"crashed": [entry.crashed for entry in entries]})


def table_markdown(entries: Sequence[Entry], quantity: str) -> str:
    """One of the quantities as a table in Markdown."""
    lines = [
        "| | | printed: three runs | mean | ours: three runs | mean | all samples, 95 % | off |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for entry in entries:
        if entry.quantity == quantity:
            lines.append(
                f"| {WINDS[entry.cell.wind]} | {CONTROLLERS[entry.cell.controller]} | {_runs(entry.printed)}"
                f" | {_number(entry.printed.mean)} | {_runs(entry.runs)} | {_number(entry.runs.mean)}"
                f" | {entry.mean.value:.4f} [{entry.mean.low:.4f}, {entry.mean.high:.4f}] | {_percent(entry.off)} |"
            )
    return "\n".join(lines)


def _runs(runs: Runs) -> str:
    return ", ".join(_number(value) for value in runs.runs)


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.3f}"


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100.0 * share:+.1f} %"
