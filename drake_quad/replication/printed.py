"""Table II as the paper prints it."""

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
# What the table calls winds and controllers. It gives no exponents without wind; the narrower pair is assumed there.
_WINDS = {"none": "no_wind", "low": "low_wind", "high": "high_wind"}
_CONTROLLERS = {
    ("PD", ""): "pd",
    ("PD+T1FNN", "1.0"): "pd_t1fnn",
    ("PD+T2FNN", ""): "pd_t2fnn",
    ("PD+T2FNN", "1.2"): "pd_t2fnn",
    ("PD+T2FNN", "1.4"): "pd_t2fnn_wide",
}


class Cell(NamedTuple):
    """A line of Table II.

    Attributes:
        wind: one of `WINDS`.
        controller: one of `CONTROLLERS`.
    """

    wind: str
    controller: str

    @property
    def scenario(self) -> str:
        """The name of its scenario in diagrams/paper.yaml."""
        return f"{self.wind}_{self.controller}"

    @property
    def words(self) -> str:
        """The wind and the controller as text."""
        return f"{WINDS[self.wind]}, {CONTROLLERS[self.controller]}"


class Runs(NamedTuple):
    """A quantity in three repetitions, and its mean; NaN where the print has a gap.

    Attributes:
        runs: the value in each repetition.
        mean: of the three.
    """

    runs: tuple[float, float, float]
    mean: float


class Line(NamedTuple):
    """What is printed for a cell.

    Attributes:
        rmse: RMSE of the Euclidean error, m.
        effort_x: control effort on X, in a unit that the paper does not give.
        effort_y: control effort on Y, in that unit.
    """

    rmse: Runs
    effort_x: Runs
    effort_y: Runs


def printed_table() -> dict[Cell, Line]:
    """What is printed, by cell."""
    found = {}
    text = files(__package__).joinpath("table_ii.csv").read_text(encoding="utf-8")
    for row in csv.DictReader(text.splitlines()):
        cell = Cell(_WINDS[row["wind"]], _CONTROLLERS[row["controller"], row["a1"]])
        found[cell] = Line(*(_runs(row, name) for name in ("rmse_m", "effort_x", "effort_y")))
    return found


def _runs(row: dict[str, str], name: str) -> Runs:
    first, second, third, mean = (
        float(row[f"{name}_{which}"] or math.nan) for which in ("run1", "run2", "run3", "mean")
    )
    return Runs((first, second, third), mean)
