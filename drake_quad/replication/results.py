"""Results of the replication, and the files that store them."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_quad.laboratory.metrics import Metrics
from drake_quad.replication.measures import LegMetrics
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell
from drake_quad.replication.sweeps import Sweep, load_sweep, num_rows
from drake_quad.reports.results import read_groups, write_groups
from drake_quad.studies.statistics import Comparison, compare_studies
from drake_quad.studies.study import Study, read_study

# Names of the controllers that the paper does not consider, which are flown for a fair comparison.
FAIR_CONTROLLERS = {
    "pd_retuned": "PD, retuned",
    "pid": "PID, retuned",
    "pd_feed_forward": "PD with feed-forward",
    "pd_feed_forward_t2fnn": "PD with feed-forward + T2FNN",
}
# Controllers whose error is mapped over the gains of the PD.
MAPPED_CONTROLLERS = ("pd", "pd_t2fnn")


@dataclass(frozen=True)
class Experiment:
    """Results of the replication of the paper's experiment. A cell is a controller and a wind of Table II.

    Attributes:
        cells: studies of the controllers of Table II and of `FAIR_CONTROLLERS` in each wind, keyed by cell.
        recorded: for each cell of Table II, the (samples,) values of the `measures`, keyed by name.
        noise: sweep of networks over the "noise" of the cameras (m) and the exponents "a1" and "a2", without wind.
        q: sweep of networks over "q" and the exponents "a1" and "a2", without wind.
        slopes: sweeps of PD+T2FNN over the "slope" λ (1/s), keyed by wind.
        maps: sweep over "k_p" (1/s²) and "k_d" (1/s) for each controller of `MAPPED_CONTROLLERS`, without wind.
        legs: sweep of the PD over "k_p" (1/s²) and "k_d" (1/s) around the best gains, without wind, leg by leg.
    """

    cells: Mapping[Cell, Study]
    recorded: Mapping[Cell, Mapping[str, np.ndarray]]
    noise: Sweep[Metrics]
    q: Sweep[Metrics]
    slopes: Mapping[str, Sweep[Metrics]]
    maps: Mapping[str, Sweep[Metrics]]
    legs: Sweep[LegMetrics]

    def comparison(self, cell: Cell, baseline: Cell, metric: str = "rmse") -> Comparison:
        """Compare two cells on the same samples."""
        return compare_studies(self.cells[cell], self.cells[baseline], metric)


def read_experiment(folder: Path) -> Experiment:
    """Read the results that `fly_experiment` wrote to a folder.

    Raises:
        InputError: if a file is missing or invalid.
    """
    cells = {
        cell: read_study(folder / "cells" / cell.scenario) for cell in select_cells((*CONTROLLERS, *FAIR_CONTROLLERS))
    }
    recorded = {Cell(*group): columns for group, columns in read_groups(folder / "recorded.csv", Cell._fields).items()}
    noise, q = (load_sweep(folder / f"{name}.csv", Metrics) for name in ("noise", "q"))
    slopes = {wind: load_sweep(folder / f"slope_{wind}.csv", Metrics) for wind in WINDS}
    maps = {name: load_sweep(folder / f"map_{name}.csv", Metrics) for name in MAPPED_CONTROLLERS}
    return Experiment(cells, recorded, noise, q, slopes, maps, load_sweep(folder / "legs.csv", LegMetrics))


def write_recorded(path: Path, recorded: Mapping[Cell, Mapping[str, np.ndarray]]) -> Path:
    """Write a row for each recorded sample, and return the path."""
    return write_groups(
        path,
        Cell._fields,
        {cell: {"sample": range(num_rows(values)), **values} for cell, values in recorded.items()},
    )


def select_cells(controllers: Collection[str], winds: Iterable[str] = WINDS) -> list[Cell]:
    """Return the cells of the given controllers, sorted by wind."""
    return [Cell(wind, controller) for wind in winds for controller in controllers]
