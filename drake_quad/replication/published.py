"""Values of Table II as printed in the paper."""

import csv
import math
from importlib.resources import files
from typing import NamedTuple

WINDS = {"no_wind": "no wind", "low_wind": "low wind", "high_wind": "high wind"}
CONTROLLERS = {
    "pd": "PD",
    "pd_t1fnn": "PD+T1FNN",
    "pd_t2fnn": "PD+T2FNN (1.2, 0.8)",
    "pd_t2fnn_wide": "PD+T2FNN (1.4, 0.6)",
}
# Key of `WINDS` for each value of the column `wind` in table_ii.csv.
_WINDS = {"none": "no_wind", "low": "low_wind", "high": "high_wind"}
# Key of `CONTROLLERS` for each controller and exponent `a1` in table_ii.csv. The paper does not print the exponents of
# PD+T2FNN in the rows without wind. They are assumed to be 1.2 and 0.8.
_CONTROLLERS = {
    ("PD", ""): "pd",
    ("PD+T1FNN", "1.0"): "pd_t1fnn",
    ("PD+T2FNN", ""): "pd_t2fnn",
    ("PD+T2FNN", "1.2"): "pd_t2fnn",
    ("PD+T2FNN", "1.4"): "pd_t2fnn_wide",
}


class Cell(NamedTuple):
    """Cell of Table II: a combination of wind and controller.

    Attributes:
        wind: name of the wind, a key of `WINDS`.
        controller: name of the controller, such as a key of `CONTROLLERS`.
    """

    wind: str
    controller: str

    @property
    def scenario(self) -> str:
        """Name of the scenario in diagrams/paper.yaml."""
        return f"{self.wind}_{self.controller}"

    @property
    def label(self) -> str:
        """Wind and controller of the cell, as text."""
        return f"{WINDS[self.wind]}, {CONTROLLERS[self.controller]}"


class Runs(NamedTuple):
    """Values of a quantity in three runs, and their mean. Values that are missing in the paper are NaN.

    Attributes:
        runs: value in each run.
        mean: mean of the three runs.
    """

    runs: tuple[float, float, float]
    mean: float


class PublishedRow(NamedTuple):
    """Values that the paper prints for a cell of Table II.

    Attributes:
        rmse: RMS of the Euclidean error, m.
        effort_x: control effort on X, in a unit that the paper does not give.
        effort_y: control effort on Y, in the same unit.
    """

    rmse: Runs
    effort_x: Runs
    effort_y: Runs


def published_table() -> dict[Cell, PublishedRow]:
    """Return the values that the paper prints for each cell of Table II."""
    lines = {}
    text = files(__package__).joinpath("table_ii.csv").read_text(encoding="utf-8")
    for row in csv.DictReader(text.splitlines()):
        cell = Cell(_WINDS[row["wind"]], _CONTROLLERS[row["controller"], row["a1"]])
        lines[cell] = PublishedRow(*(_runs(row, name) for name in ("rmse_m", "effort_x", "effort_y")))
    return lines


def _runs(row: dict[str, str], name: str) -> Runs:
    first, second, third, mean = (
        float(row[f"{name}_{which}"] or math.nan) for which in ("run1", "run2", "run3", "mean")
    )
    return Runs((first, second, third), mean)
