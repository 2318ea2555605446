"""A study: a row of numbers for every sample, in memory and on disk."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError, listed
from drake_quad.extras import import_extra
from drake_quad.files import read_table, write_atomically
from drake_quad.flight.remarks import flight_remarks
from drake_quad.laboratory.metrics import UNITS, Metrics
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.description import description_at, unit_at
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.studies.provenance import provenance
from drake_quad.studies.results_file import CHECKSUM, Format, Found, read_results

if TYPE_CHECKING:
    import pandas as pd

RESULTS, SCENARIO, STUDY, FAILED = "results.csv", "scenario.yaml", "study.yaml", "failed.csv"
PARQUET = "results.parquet"
# The column of what samples crashed into.
_OBSTACLE = "obstacle"
# Of two numbers that are written with twelve digits.
_ROUNDING = 1e-11


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
        misfits: numbers of the lines of the results file that were not as they had been written, and whose samples were
            flown again.
        touched: (n,) number of the obstacle that each sample crashed into, from 1 on in the scenario's order, 0 if it
            touched none; None without obstacles.
    """

    scenario: Scenario
    duration: float
    samples: np.ndarray
    parameters: Mapping[str, np.ndarray]
    metrics: Metrics
    failures: Mapping[int, str] = field(default_factory=dict)
    flown_time: float = 0.0
    misfits: Sequence[int] = ()
    touched: np.ndarray | None = None

    @classmethod
    def of_rows(
        cls,
        scenario: Scenario,
        duration: float,
        rows: np.ndarray,
        *,
        failures: Mapping[int, str] = {},
        flown_time: float = 0.0,
        misfits: Sequence[int] = (),
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
            tuple(misfits),
            columns[_OBSTACLE].astype(int) if _OBSTACLE in columns else None,
        )

    def __repr__(self) -> str:
        """Return a one-line description."""
        crashed, flown = int(self.metrics.crashed.sum()), len(self.samples)
        failed = f", {len(self.failures)} not flown" if self.failures else ""
        numbers = listed([*self.parameters]) or "nothing"
        return f"<Study of {self.scenario.name}: {flown} samples, {crashed} crashed{failed}; drawn are {numbers}>"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks to read before using the results of the study, see `flight_remarks`."""
        return flight_remarks(self.scenario)

    @property
    def flight_time(self) -> np.ndarray:
        """(n,) seconds that each sample flew, until the end or its crash."""
        return np.minimum(self.metrics.crash_time, self.duration)

    @property
    def touches(self) -> dict[str, int]:
        """How many samples crashed into each obstacle, by its name."""
        if self.touched is None:
            return {}
        return {name: int((self.touched == i).sum()) for i, name in enumerate(_obstacles(self.scenario), start=1)}

    def obstacle_of(self, place: int) -> str | None:
        """The name of the obstacle that the sample in a place crashed into; None if it touched none."""
        number = 0 if self.touched is None else int(self.touched[place])
        return _obstacles(self.scenario)[number - 1] if number else None

    def to_frame(self) -> "pd.DataFrame":
        """The study as a table of pandas, with a row for each sample that was flown.

        Its index is the number of the sample, so that tables of controllers that flew the same samples join row by row.
        Its columns are every number that was drawn, by the path of its field, every metric, `crashed` as True or False,
        and `crash_time`, which is NaN for a sample that flew to the end. Where there are obstacles, `obstacle` is
        the name of that which it crashed into, if it did. The metrics of a sample that crashed are those until then.
        `frame.attrs` has the `units` of the columns, the `scenario`'s name, the `seed`, the `duration` of a
        flight (s), and, by their numbers, the `failures`: why samples could not be flown, which have no row.

        Raises:
            ImportError: pandas is not installed; the extra `tables` has it.
        """
        pandas = import_extra("pandas", "tables")
        columns = {**self.parameters, **self.metrics._asdict(), "crashed": self.metrics.crashed}
        columns["crash_time"] = np.where(self.metrics.crashed, self.metrics.crash_time, np.nan)
        if self.touched is not None:
            names = np.array([None, *_obstacles(self.scenario)], dtype=object)
            columns[_OBSTACLE] = names[self.touched]
        ordered = {name: columns[name] for name in columns_of(self.scenario)[1:]}
        frame = pandas.DataFrame(ordered, index=pandas.Index(self.samples, name="sample"))
        frame.attrs = {
            "units": {name: unit_of(self.scenario, name) for name in ordered},
            "scenario": self.scenario.name,
            "seed": self.scenario.seed,
            "duration": self.duration,
            "failures": {str(sample): reason for sample, reason in self.failures.items()},
        }
        return frame

    def to_parquet(self, path: Path | str) -> Path:
        """Writes the table of `to_frame`, with its attributes, as Parquet, whole, and returns the path.

        `pandas.read_parquet` reads it as it was; a study goes on from its CSV file alone.

        Raises:
            ImportError: pandas or pyarrow is not installed; the extra `tables` has them.
            OSError: the file cannot be written.
        """
        import_extra("pyarrow", "tables")
        frame = self.to_frame()
        return write_atomically(Path(path), lambda target: frame.to_parquet(target, engine="pyarrow"))


def columns_of(scenario: Scenario) -> list[str]:
    """The columns of a study's table: the sample, every field that is drawn, every metric, and the obstacle, if any."""
    measured = [name for name in Metrics._fields if name != "crash_time"]
    touched = [_OBSTACLE] if _obstacles(scenario) else []
    return ["sample", *distributions_in(scenario), *measured, "crashed", "crash_time", *touched]


def _obstacles(scenario: Scenario) -> list[str]:
    """The names of the obstacles."""
    return [] if scenario.space is None else [*scenario.space.obstacles]


def rows_of(batch: Batch, metrics: Metrics, touched: np.ndarray | None = None) -> np.ndarray:
    """The (n, columns) table of what a batch flew.

    Args:
        batch: of n vehicles.
        metrics: (n,) arrays.
        touched: (n,) number of the obstacle that each crashed into, or 0; nobody asks for it without obstacles.
    """
    columns = {"sample": batch.samples, **batch.varying, **metrics._asdict(), "crashed": metrics.crashed}
    columns[_OBSTACLE] = touched
    return np.column_stack([columns[name] for name in columns_of(batch.scenario)])


def format_of(scenario: Scenario) -> Format:
    """What the rows of a scenario's study look like on disk."""
    return Format(columns_of(scenario), scenario.model_dump_json())


def fitting(scenario: Scenario, found: Found) -> Found:
    """What a results file holds, without rows whose drawn numbers are not those that the seed gives."""
    if not len(found.rows):
        return found
    columns = dict(zip(columns_of(scenario), found.rows.T, strict=True))
    drawn = Batch.draw(scenario, columns["sample"].astype(int).tolist()).varying
    fits = np.ones(len(found.rows), dtype=bool)
    for path, numbers in drawn.items():
        fits &= np.isclose(columns[path], numbers, rtol=_ROUNDING, atol=0.0)
    return found._replace(rows=found.rows[fits], lines=found.lines[fits], misfits=[*found.misfits, *found.lines[~fits]])


def read_study(path: Path | str) -> Study:
    """Reads the results of a study, also of one that is under way or was interrupted.

    Args:
        path: the folder of the study, one of the files in it, or a folder in which it is the only study.

    Raises:
        InputError: there is no study, there are several, or its files do not belong together.
    """
    folders = study_folders(path)
    if len(folders) > 1:
        raise InputError(
            f"{path} holds {len(folders)} studies, {listed([*folders])}; read one of these folders, or all of them by"
            " read_studies"
        )
    return _read(next(iter(folders.values())))


def read_studies(path: Path | str) -> dict[str, Study]:
    """Reads all studies in a folder, such as those of several controllers, by the names of their folders.

    Args:
        path: a folder of studies; or of one, or a file in it, as for `read_study`.

    Raises:
        InputError: there is no study, or the files of one do not belong together.
    """
    return {name: _read(folder) for name, folder in study_folders(path).items()}


def study_folders(path: Path | str) -> dict[str, Path]:
    """The folders of the studies that a path leads to, by their names: its own, or those in it.

    Raises:
        InputError: there is none.
    """
    path = Path(path)
    own = path.parent if path.is_file() and path.name in (RESULTS, PARQUET, SCENARIO, STUDY, FAILED) else path
    if (own / RESULTS).is_file():
        return {own.resolve().name: own}
    if not path.exists():
        raise InputError(f"{path} does not exist")
    inside = sorted(each.parent for each in own.glob(f"*/{RESULTS}")) if own.is_dir() else []
    if not inside:
        there = sorted(each.name for each in own.iterdir()) if own.is_dir() else []
        holds = f"it holds {listed(there)}" if there else "it is empty" if own.is_dir() else "it is another file"
        raise InputError(f"{path} is no study, which has {RESULTS}, {SCENARIO} and {STUDY}; {holds}")
    return {each.name: each for each in inside}


def _read(folder: Path) -> Study:
    """Reads the study in a folder."""
    record, scenario = read_record(folder), load_scenario(folder / SCENARIO)
    found = fitting(scenario, read_results(folder / RESULTS, format_of(scenario)))
    if found.misfits:
        raise InputError(
            f"{folder / RESULTS}, line {min(found.misfits)}: is not as it was written; --resume flies it again"
        )
    rows = found.rows[np.argsort(found.rows[:, 0])]
    return Study.of_rows(scenario, record.duration, rows, failures=_read_failures(folder / FAILED))


def _read_failures(path: Path) -> dict[int, str]:
    """Why samples could not be flown, by their numbers; none if there is no file of them."""
    if not path.exists():
        return {}
    try:
        table = read_table(path)
        return {int(sample): str(reason) for sample, reason in zip(table["sample"], table["reason"], strict=True)}
    except (KeyError, ValueError):
        raise InputError(f"{path} is not the table of the samples that could not be flown") from None


class Record(BaseModel):
    """What is written of a study beside its scenario.

    Attributes:
        samples: how many there are to be.
        seed: from which they are drawn.
        duration: of a flight, s.
        position_controller: name of the function that makes it in place of the scenario's, if one is given.
        control: name of the function that makes it, if one is given.
        wind: name of the function that makes it, if one is given.
        policy: likewise.
        flown: how: in compiled diagrams, or as they are wired, or one after the other.
        versions: versions and sources with which it was flown, one after another.
        columns: what stands in each column of the results.
    """

    model_config = ConfigDict(strict=True, frozen=True)

    samples: int
    seed: int
    duration: float
    position_controller: str | None = None
    control: str | None = None
    wind: str | None = None
    policy: str | None = None
    flown: list[Literal["compiled", "wired"]] = ["wired"]
    versions: list[dict[str, str]]
    columns: dict[str, str]

    @classmethod
    def of(cls, scenario: Scenario, num_samples: int, duration: float, own: UserSystems, *, compiled: bool) -> "Record":
        """The record of a study that begins.

        Args:
            scenario: of the study, under its seed.
            num_samples: how many samples there are to be.
            duration: of a flight, s.
            own: functions that make systems of the user's.
            compiled: whether it is flown in compiled diagrams.
        """
        return cls(
            samples=num_samples,
            seed=scenario.seed,
            duration=duration,
            **{name: _called(function) for name, function in own.given.items()},
            flown=["compiled" if compiled else "wired"],
            versions=[provenance()],
            columns={name: meaning(scenario, name) for name in [*columns_of(scenario), CHECKSUM]},
        )

    def write(self, path: Path) -> None:
        """Writes the record as YAML."""
        YAML().dump(self.model_dump(exclude_none=True), path)


def read_record(folder: Path) -> Record:
    """Reads the record of the study in a folder.

    Raises:
        InputError: it is not there, or is something else.
    """
    path = folder / STUDY
    try:
        content = YAML(typ="safe", pure=True).load(path)
    except (OSError, YAMLError, ValueError):
        raise InputError(f"{path} cannot be read, or is not YAML") from None
    try:
        return Record.model_validate(content)
    except ValidationError as error:
        place = ".".join(map(str, error.errors()[0]["loc"]))
        raise InputError(f"{path} is not the record of a study" + (f": see its {place}" if place else "")) from None


def _called(function: Callable[..., Any]) -> str:
    """The name by which a function can be imported."""
    function = getattr(function, "func", function)
    return f"{function.__module__}:{function.__qualname__}"


def meaning(scenario: Scenario, column: str) -> str:
    """What stands in a column of a study's table, with its unit."""
    own = {
        "sample": "number of the sample",
        "crashed": "1 if the vehicle crashed, else 0",
        _OBSTACLE: "number of the obstacle that it crashed into, from 1 on as in the scenario; 0 if it touched none",
        CHECKSUM: "CRC-32 of the row and its study, by which a row that was altered is known",
    }
    if column in own:
        return own[column]
    return f"metric ({UNITS[column]})" if column in UNITS else description_at(scenario, column)


def unit_of(scenario: Scenario, column: str) -> str:
    """The unit of a column of a study's table; "" if it has none."""
    return UNITS.get(column, "") if column in ("sample", "crashed", _OBSTACLE, *UNITS) else unit_at(scenario, column)
