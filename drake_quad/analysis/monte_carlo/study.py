"""A study: a row of numbers for every sample, in memory and on disk."""

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from drake_quad.analysis.monte_carlo.results_file import read_rows
from drake_quad.errors import InputError
from drake_quad.laboratory.metrics import UNITS, Metrics
from drake_quad.scenario import Scenario, distributions_in, load_scenario
from drake_quad.scenario.description import description_at

RESULTS, SCENARIO, STUDY, FAILED = "results.csv", "scenario.yaml", "study.yaml", "failed.csv"
_VERSIONS = ("drake_quad", "drake", "numpy", "scipy", "numba")


@dataclass(frozen=True, repr=False)
class Study:
    """What samples of a scenario did.

    Attributes:
        scenario: of the study, with its distributions and its seed.
        duration: of a flight, s.
        samples: (n,) numbers of the samples flown, rising.
        parameters: (n,) numbers drawn for each field that holds a distribution.
        metrics: (n,) arrays; NaN where no tick counted.
        failures: why samples could not be flown, by their number.
        flown_time: seconds of flight that were flown just now, and not read from a file.
    """

    scenario: Scenario
    duration: float
    samples: np.ndarray
    parameters: Mapping[str, np.ndarray]
    metrics: Metrics
    failures: Mapping[int, str] = field(default_factory=dict)
    flown_time: float = 0.0

    @classmethod
    def of_rows(
        cls, scenario: Scenario, duration: float, rows: np.ndarray, failures: Mapping[int, str], flown_time: float
    ) -> "Study":
        """The study of a table with the columns of `columns_of`, by rising samples."""
        columns = dict(zip(columns_of(scenario), rows.T, strict=True))
        return cls(
            scenario,
            duration,
            columns["sample"].astype(int),
            {path: columns[path] for path in distributions_in(scenario)},
            Metrics(*(columns[name] for name in Metrics._fields)),
            dict(failures),
            flown_time,
        )

    def __repr__(self) -> str:
        """A line of text."""
        crashed, flown = int(self.metrics.crashed.sum()), len(self.samples)
        failed = f", {len(self.failures)} not flown" if self.failures else ""
        numbers = ", ".join(self.parameters) or "nothing"
        return f"<Study of {self.scenario.name}: {flown} samples, {crashed} crashed{failed}; drawn are {numbers}>"

    @property
    def flight_time(self) -> np.ndarray:
        """(n,) seconds that each sample flew, until the end or its crash."""
        return np.minimum(self.metrics.crash_time, self.duration)


def columns_of(scenario: Scenario) -> list[str]:
    """The columns of a study's table: the sample, every field that is drawn, and every metric."""
    return ["sample", *distributions_in(scenario), *Metrics._fields[:-1], "crashed", "crash_time"]


def rows_of(samples: Sequence[int], numbers: Mapping[str, np.ndarray], metrics: Metrics) -> np.ndarray:
    """The (n, columns) table of some samples, their drawn numbers and their metrics."""
    *others, crash_time = metrics
    return np.column_stack([samples, *numbers.values(), *others, metrics.crashed, crash_time])


def read_study(folder: Path | str) -> Study:
    """Reads the results of a study, also of one that is under way or was interrupted.

    Raises:
        InputError: there is no study, or its files do not belong together.
    """
    folder = Path(folder)
    record, scenario = load_record(folder), load_scenario(folder / SCENARIO)
    _, rows = read_rows(folder / RESULTS, columns_of(scenario))
    return Study.of_rows(scenario, float(record["duration"]), rows[np.argsort(rows[:, 0])], {}, 0.0)


def record_of(
    scenario: Scenario, num_samples: int, duration: float, own: Mapping[str, Callable[..., Any] | None]
) -> dict[str, Any]:
    """What is written of a study beside its scenario.

    Args:
        scenario: of the study, under its seed.
        num_samples: of it.
        duration: of a flight, s.
        own: functions that make controllers or wind of one's own, if given.
    """
    return {
        "samples": num_samples,
        "seed": scenario.seed,
        "duration": duration,
        **{name: _called(function) for name, function in own.items() if function is not None},
        "versions": [{"python": platform.python_version(), **{name: version(name) for name in _VERSIONS}}],
        "columns": {name: meaning(scenario, name) for name in columns_of(scenario)},
    }


def load_record(folder: Path) -> dict[str, Any]:
    """Reads what `record_of` made of a study.

    Raises:
        InputError: it is not there, or is something else.
    """
    path = folder / STUDY
    try:
        record = YAML(typ="safe", pure=True).load(path)
    except (OSError, YAMLError):
        raise InputError(f"{path} cannot be read, or is not YAML") from None
    if not isinstance(record, dict) or not {"samples", "seed", "duration", "versions"} <= record.keys():
        raise InputError(f"{path} is not the record of a study")
    return record


def _called(function: Callable[..., Any]) -> str:
    """The name by which a function can be imported."""
    function = getattr(function, "func", function)
    return f"{function.__module__}:{function.__qualname__}"


def meaning(scenario: Scenario, column: str) -> str:
    """What stands in a column of a study's table, with its unit."""
    own = {"sample": "number of the sample", "crashed": "1 if the vehicle crashed, else 0"}
    if column in own:
        return own[column]
    return f"metric ({UNITS[column]})" if column in UNITS else description_at(scenario, column)
