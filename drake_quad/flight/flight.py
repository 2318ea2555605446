"""What a flight leaves behind."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_table, write_whole
from drake_quad.framework.records import layout_of
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario, save_scenario
from drake_quad.signals import SIGNALS, quantities, row_names


@dataclass(frozen=True, repr=False)
class Flight:
    """A flown scenario.

    Attributes:
        scenario: what was flown, with its seed and the number of the sample.
        plan: the reference.
        time: (ticks,) the ticks of the control, until the end or the crash, s.
        signals: (ticks, rows) values of each signal at the ticks; `record` gives the rows their names.
        metrics: of the flight; NaN where there is nothing to measure.
        compiled: whether it was flown in a compiled diagram; else in the diagram as it is wired.
    """

    scenario: Scenario
    plan: Plan
    time: np.ndarray
    signals: dict[str, np.ndarray]
    metrics: Metrics
    compiled: bool = False

    def __getitem__(self, name: str) -> np.ndarray:
        """The (ticks, rows) values of a signal."""
        if name not in self.signals:
            raise KeyError(f"{name} is no signal of this flight, which has {', '.join(self.signals)}")
        return self.signals[name]

    def record(self, name: str) -> Any:
        """A signal as the record of `drake_quad.signals`, of (ticks,) arrays: `record("state").roll` is the roll."""
        rows = list(self[name].T)
        return layout_of(SIGNALS[name], rows).build(rows)

    def __repr__(self) -> str:
        """A line of text."""
        end = f"crashed at {self.metrics.crash_time:.2f} s" if self.metrics.crashed else f"{self.time[-1]:.2f} s"
        how = ", compiled" if self.compiled else ""
        return (
            f"<Flight of {self.scenario.name}{how}: {end}, RMSE {self.metrics.rmse:.4g} m; {', '.join(self.signals)}>"
        )

    @property
    def euclidean_error(self) -> np.ndarray:
        """(ticks,) distance of the vehicle to the reference, m."""
        reference, state = self.record("reference"), self.record("state")
        return np.hypot(np.hypot(reference.x - state.x, reference.y - state.y), reference.z - state.z)

    def save(self, folder: Path | str) -> list[Path]:
        """Writes the signals as compressed NumPy and as CSV, the metrics as CSV, and the scenario as YAML to fly again.

        Returns:
            The files.

        Raises:
            InputError: the folder cannot be written, or holds a scenario of something else than a flight.
        """
        target = output_folder(Path(folder))
        if (target / "scenario.yaml").exists() and not (target / "flight.npz").exists():
            raise InputError(
                f"{target / 'scenario.yaml'} would be overwritten, and is no flight's; choose another folder"
            )
        names = {
            f"{name}.{row} ({quantity.unit})": values[:, i]
            for name, values in self.signals.items()
            for i, (row, quantity) in enumerate(
                zip(row_names(name, values.shape[1]), quantities(name, values.shape[1]), strict=True)
            )
        }

        metrics = {name: [value if math.isfinite(value) else ""] for name, value in self.metrics._asdict().items()}

        def save_arrays(path: Path) -> None:
            arrays: dict[str, Any] = {"time": self.time, **self.signals}
            np.savez_compressed(path, **arrays)

        return [
            write_whole(target / "flight.npz", save_arrays),
            write_table(target / "flight.csv", {"time (s)": self.time, **names}, digits=9),
            write_whole(target / "scenario.yaml", lambda path: save_scenario(self.scenario, path)),
            write_table(target / "metrics.csv", metrics, digits=12),
        ]
