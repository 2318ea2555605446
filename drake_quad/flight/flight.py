"""Recorded flights, and their files."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.extras import import_extra
from drake_quad.files import output_folder, read_arrays, read_table, write_atomically, write_table
from drake_quad.flight.mission import plan_route
from drake_quad.flight.remarks import flight_remarks
from drake_quad.framework.records import layout_of
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.routes import Leg
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.models import Scenario
from drake_quad.signals import SIGNALS, Quantity, quantities, row_names

if TYPE_CHECKING:
    import pandas as pd

# Exceptions that a damaged file causes while it is read, or while its arrays are converted to a plan.
_DAMAGE_ERRORS = (OSError, ValueError, KeyError, AttributeError, TypeError)
# File names in the folder of a flight.
ARRAYS = "flight.npz"
TABLE = "flight.csv"
SCENARIO = "scenario.yaml"
METRICS = "metrics.csv"
# Names of the arrays in `flight.npz` that are not signals: whether the diagram was compiled, the obstacle that the
# vehicle hit, the cause of the crash, and the arrays of the plan.
_COMPILED_KEY = "compiled"
_OBSTACLE_KEY = "touched"
_CAUSE_KEY = "cause"
_PLAN_PREFIX = "plan."


@dataclass(frozen=True, repr=False, eq=False)
class Flight(Mapping[str, np.ndarray]):
    """Simulated flight, a mapping from the names of its signals to their values.

    `flight["state"]` is an array (ticks, rows). `flight.keys()` are the names of the signals, and `flight.items()` are
    pairs of name and array.

    Attributes:
        scenario: scenario that was flown, with its seed and the index of the sample.
        plan: plan with the reference.
        time: (ticks,) times of the control ticks until the end of the flight or the crash, s.
        signals: (ticks, rows) values of each signal at the ticks; `record` names the rows.
        metrics: metrics of the flight; NaN for a metric that is not defined.
        compiled: True if a compiled diagram was simulated, False if the original diagram was.
        obstacle_hit: name of the obstacle that the vehicle hit; None otherwise.
        cause: sentence that names the first NaN or infinite value, if this value caused the crash.
    """

    scenario: Scenario
    plan: Plan
    time: np.ndarray
    signals: dict[str, np.ndarray]
    metrics: Metrics
    compiled: bool = False
    obstacle_hit: str | None = None
    cause: str | None = None

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the (ticks, rows) values of a signal."""
        if name not in self.signals:
            raise KeyError(f"{name} is not a signal of this flight; its signals are {', '.join(self.signals)}")
        return self.signals[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the recorded signals."""
        return iter(self.signals)

    def __len__(self) -> int:
        """Return the number of recorded signals."""
        return len(self.signals)

    # Flights are compared by identity, since a comparison of arrays has no single truth value.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def record(self, name: str) -> Any:
        """Return a signal as a NamedTuple of (ticks,) arrays, as in `record("state").roll`."""
        rows = list(self[name].T)
        return layout_of(SIGNALS[name], rows).build(rows)

    def columns(self) -> dict[str, tuple[Quantity, np.ndarray]]:
        """Return the quantity and the (ticks,) values of each row of each signal, keyed by the name `signal.row`."""
        return {
            f"{name}.{row}": (quantity, values[:, i])
            for name, values in self.signals.items()
            for i, (row, quantity) in enumerate(
                zip(row_names(name, values.shape[1]), quantities(name, values.shape[1]), strict=True)
            )
        }

    def to_frame(self) -> "pd.DataFrame":
        """Return the flight as a pandas DataFrame, with a row for each tick.

        The index is the `time` (s), and the columns are the rows of the signals, such as `state.roll` and `error.x`.
        `frame.attrs` contains the `units` and coordinate `frames` of the columns (W, B, or "" for columns without a
        direction), and the name of the `scenario`.

        Raises:
            ImportError: if pandas is not installed; the extra `tables` installs it.
        """
        pandas = import_extra("pandas", "tables")
        columns = self.columns()
        data = {name: values for name, (_, values) in columns.items()}
        frame = pandas.DataFrame(data, index=pandas.Index(self.time, name="time"))
        frame.attrs = {
            "units": {name: quantity.unit for name, (quantity, _) in columns.items()},
            "frames": {name: quantity.frame for name, (quantity, _) in columns.items()},
            "scenario": self.scenario.name,
        }
        return frame

    def __repr__(self) -> str:
        """Return a one-line description of the flight."""
        end = self.crash or f"{self.time[-1]:.2f} s"
        end = end if self.cause is None else f"{end}, since {self.cause}"
        compiled = ", compiled" if self.compiled else ""
        rmse = f"{100.0 * self.metrics.rmse:.4g} cm"
        return f"<Flight of {self.scenario.name}{compiled}: {end}, RMSE {rmse}; {', '.join(self.signals)}>"

    @property
    def crash(self) -> str:
        """Description of the crash; empty if the vehicle did not crash."""
        if not self.metrics.crashed:
            return ""
        obstacle = "" if self.obstacle_hit is None else f" into {self.obstacle_hit}"
        return f"crashed{obstacle} at {self.metrics.crash_time:.2f} s"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks that a user should read before using the results of the flight; see `flight_remarks`."""
        return flight_remarks(self.scenario, self.plan)

    @property
    def euclidean_error(self) -> np.ndarray:
        """(ticks,) distance of the vehicle from the reference, m."""
        reference, state = self.record("reference"), self.record("state")
        return np.hypot(np.hypot(reference.x - state.x, reference.y - state.y), reference.z - state.z)

    def save(self, folder: Path | str) -> list[Path]:
        """Write the flight to a folder, from which `read_flight` reads it.

        The signals are written as compressed NumPy arrays and as CSV, the metrics as CSV, and the scenario as YAML.

        Returns:
            The paths of the files.

        Raises:
            InputError: if the folder cannot be written, or contains a scenario that does not belong to a flight.
        """
        target = output_folder(Path(folder))
        if (target / SCENARIO).exists() and not (target / ARRAYS).exists():
            raise InputError(
                f"{target / SCENARIO} does not belong to a flight and would be overwritten; choose another folder"
            )
        names = {f"{name} ({quantity.unit})": values for name, (quantity, values) in self.columns().items()}
        metrics = {name: [value if math.isfinite(value) else ""] for name, value in self.metrics._asdict().items()}

        def save_arrays(path: Path) -> None:
            arrays: dict[str, Any] = {"time": self.time, **self.signals, _COMPILED_KEY: np.array(self.compiled)}
            texts = {_OBSTACLE_KEY: self.obstacle_hit, _CAUSE_KEY: self.cause}
            arrays |= {name: np.array(text, dtype=str) for name, text in texts.items() if text is not None}
            np.savez_compressed(path, **(arrays | _arrays_of(self.plan)))

        return [
            write_atomically(target / ARRAYS, save_arrays),
            write_table(target / TABLE, {"time (s)": self.time, **names}, digits=9),
            write_atomically(target / SCENARIO, lambda path: save_scenario(self.scenario, path)),
            write_table(target / METRICS, metrics),
        ]


def read_flight(path: Path | str) -> Flight:
    """Read a flight that `Flight.save` wrote, without loss of precision.

    Args:
        path: folder of the flight, or one of the files in it.

    Raises:
        InputError: if the folder does not contain a flight, or one of its files is damaged.
    """
    path = Path(path)
    folder = path.parent if path.is_file() and path.name in (ARRAYS, TABLE, SCENARIO, METRICS) else path
    if not (folder / ARRAYS).is_file():
        raise InputError(
            f"{path} is not the folder of a flight, which contains {ARRAYS}, {TABLE}, {SCENARIO} and {METRICS}"
        )
    scenario = load_scenario(folder / SCENARIO)
    try:
        with (folder / ARRAYS).open("rb") as file:
            arrays = read_arrays(file)
        time = arrays.pop("time")
        compiled = bool(arrays.pop(_COMPILED_KEY, False))
        obstacle_hit, cause = (
            str(arrays.pop(name)) if name in arrays else None for name in (_OBSTACLE_KEY, _CAUSE_KEY)
        )
        plan_arrays = {name: arrays.pop(name) for name in [*arrays] if name.startswith(_PLAN_PREFIX)}
        plan = _plan_of(plan_arrays) if plan_arrays else None
    except _DAMAGE_ERRORS:
        raise InputError(f"{folder / ARRAYS} is damaged, or is not the file of a flight") from None
    unexpected = [name for name, values in arrays.items() if name not in SIGNALS or values.shape[:1] != time.shape]
    if unexpected:
        raise InputError(
            f"{folder / ARRAYS} is not the file of a flight: {join_names(unexpected)} is not a signal with one row per"
            " tick"
        )
    metrics = _read_metrics(folder / METRICS, scenario.metrics_type)
    return Flight(scenario, plan or plan_route(scenario), time, arrays, metrics, compiled, obstacle_hit, cause)


def _read_metrics(path: Path, kind: type[Metrics]) -> Metrics:
    table = read_table(path)
    if [*table] != [*kind._fields] or any(values.shape != (1,) for values in table.values()):
        raise InputError(f"{path} is not the table of a flight's metrics")
    metrics = kind(*(float(values[0]) for values in table.values()))
    return metrics if math.isfinite(metrics.crash_time) else metrics._replace(crash_time=math.inf)


def _arrays_of(plan: Plan) -> dict[str, np.ndarray]:
    """Return the named arrays from which `_plan_of` restores a plan exactly."""
    arrays = {
        **{f"path.{name}": values for name, values in plan.path._asdict().items()},
        **{f"yaw.{name}": values for name, values in plan.yaw._asdict().items()},
        "legs": np.array([leg.name for leg in plan.legs], dtype=str),
        "leg_firsts": np.array([leg.first for leg in plan.legs], dtype=int),
        "laps": np.array(plan.laps, dtype=float),
    }
    return {f"{_PLAN_PREFIX}{name}": values for name, values in arrays.items()}


def _plan_of(arrays: Mapping[str, np.ndarray]) -> Plan:
    """Return the plan whose arrays `_arrays_of` returned."""
    path, yaw = (
        PolynomialPath(*(arrays[f"{_PLAN_PREFIX}{part}.{name}"] for name in PolynomialPath._fields))
        for part in ("path", "yaw")
    )
    legs = zip(arrays[f"{_PLAN_PREFIX}legs"].tolist(), arrays[f"{_PLAN_PREFIX}leg_firsts"].tolist(), strict=True)
    return Plan(path, yaw, tuple(Leg(*leg) for leg in legs), tuple(arrays[f"{_PLAN_PREFIX}laps"].tolist()))
