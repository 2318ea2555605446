"""What the replication leaves in its folder, and reading it back."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.analysis.monte_carlo import Study, read_study
from drake_quad.analysis.replication.columns import read_columns, write_columns
from drake_quad.analysis.replication.legs import LegErrors
from drake_quad.analysis.replication.printed import CONTROLLERS, WINDS, Cell
from drake_quad.analysis.replication.sweeps import Sweep

# Controllers that the paper does not have, for a fair comparison.
FAIR = {
    "pid": "PID",
    "pd_feed_forward": "PD with feed-forward",
    "pd_feed_forward_t2fnn": "PD with feed-forward + T2FNN",
}
# PD's whose gains are mapped, in files of these names.
MAPPED = ("pd", "pd_t2fnn")
_TUNED_ON = ("straight", "curved")


class TunedLegs(NamedTuple):
    """A PD tuned on straight lines and one tuned on curves.

    Attributes:
        k_p: of the two, 1/s².
        k_d: 1/s.
        samples: that both flew, and that they were not tuned on.
        errors: (2, samples).
    """

    k_p: np.ndarray
    k_d: np.ndarray
    samples: np.ndarray
    errors: LegErrors

    def save(self, path: Path) -> Path:
        """Writes a row for each of the two and each sample."""
        count = len(self.samples)
        table = {"tuned_on": np.repeat(_TUNED_ON, count)}
        table |= {name: np.repeat(values, count) for name, values in (("k_p", self.k_p), ("k_d", self.k_d))}
        table |= {"sample": np.tile(self.samples, 2)}
        return write_columns(path, table | {name: np.ravel(values) for name, values in self.errors._asdict().items()})

    @classmethod
    def load(cls, path: Path) -> "TunedLegs":
        """Reads what `save` wrote.

        Raises:
            InputError: the file cannot be read.
        """
        table = read_columns(path)
        count = len(table["sample"]) // 2
        errors = LegErrors(*(table[name].reshape(2, count) for name in LegErrors._fields))
        return cls(table["k_p"][::count], table["k_d"][::count], table["sample"][:count].astype(int), errors)


@dataclass(frozen=True)
class Experiment:
    """Everything that was flown, in numbers.

    Attributes:
        cells: study of each cell, of the controllers of Table II and of `FAIR`.
        recorded: of some samples of each cell of Table II, (samples,) values of each of `measures`.
        noise: networks without wind over the noise of the cameras: numbers "noise" (m), "a1", "a2".
        shares: the same over "q" at the paper's noise.
        integrals: PID without wind over "k_i" (1/s³).
        maps: each of `MAPPED` without wind over "k_p" (1/s²) and "k_d" (1/s).
        legs: the PD's with the gains that are best on straight legs, and with those that are best on curved ones.
    """

    cells: Mapping[Cell, Study]
    recorded: Mapping[Cell, Mapping[str, np.ndarray]]
    noise: Sweep
    shares: Sweep
    integrals: Sweep
    maps: Mapping[str, Sweep]
    legs: TunedLegs


def read_experiment(folder: Path) -> Experiment:
    """Reads what `fly_experiment` left in a folder.

    Raises:
        InputError: something is missing, or is something else.
    """
    cells = {cell: read_study(folder / "cells" / cell.scenario) for cell in cells_of((*CONTROLLERS, *FAIR))}
    table = read_columns(folder / "recorded.csv")
    whose = np.char.add(np.char.add(table.pop("wind"), "_"), table.pop("controller"))
    recorded = {
        cell: {name: values[whose == cell.scenario] for name, values in table.items()} for cell in cells_of(CONTROLLERS)
    }
    noise, shares, integrals = (Sweep.load(folder / f"{name}.csv") for name in ("noise", "q", "integral"))
    maps = {name: Sweep.load(folder / f"map_{name}.csv") for name in MAPPED}
    return Experiment(cells, recorded, noise, shares, integrals, maps, TunedLegs.load(folder / "legs.csv"))


def write_recorded(path: Path, recorded: Mapping[Cell, Mapping[str, np.ndarray]]) -> Path:
    """Writes a row for each recorded sample."""
    rows = [
        {"wind": cell.wind, "controller": cell.controller, "sample": sample}
        | {name: column[sample] for name, column in values.items()}
        for cell, values in recorded.items()
        for sample in range(len(next(iter(values.values()))))
    ]
    return write_columns(path, {name: [row[name] for row in rows] for name in rows[0]})


def cells_of(controllers: Mapping[str, str] | tuple[str, ...]) -> list[Cell]:
    """The cells of some controllers, wind by wind."""
    return [Cell(wind, controller) for wind in WINDS for controller in controllers]
