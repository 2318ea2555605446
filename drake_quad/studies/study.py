"""Results of a study in memory and on disk, with a row of numbers for each sample."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from ruamel.yaml import YAML

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError, join_names
from drake_quad.extras import import_extra
from drake_quad.files import read_table, write_atomically
from drake_quad.flight.remarks import flight_remarks
from drake_quad.laboratory.metrics import Metrics, metric_definitions, metric_unit
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.description import description_at, unit_at
from drake_quad.scenario.files.documents import parse_document
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.files.reading import read_text
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.statistics.replicates import INDEPENDENT, Replicates
from drake_quad.studies.provenance import provenance
from drake_quad.studies.results_file import CHECKSUM, RowFormat, StoredRows, read_results

if TYPE_CHECKING:
    import pandas as pd

RESULTS_FILE = "results.csv"
SCENARIO_FILE = "scenario.yaml"
STUDY_FILE = "study.yaml"
FAILED_FILE = "failed.csv"
PARQUET_FILE = "results.parquet"
_OBSTACLE_COLUMN = "obstacle"  # column with the number of the obstacle that a sample crashed into
_ROUNDING_TOLERANCE = 1e-11  # relative; numbers are written with twelve digits


@dataclass(frozen=True, repr=False)
class Study:
    """Results of n samples of a scenario.

    Attributes:
        scenario: scenario of the study, with its distributions and its seed.
        duration: duration of a flight, s.
        samples: (n,) indices of the flown samples, in increasing order.
        parameters: (n,) drawn numbers of each field that contains a distribution, by the path of the field.
        metrics: (n,) values of each metric; NaN if no tick counts for the metric.
        failures: reasons why samples could not be flown, by the index of the sample.
        simulated_time: total simulated time of the samples that were flown in this run and not read from a file, s.
        invalid_lines: line numbers of invalid rows in the results file, whose samples were flown again.
        obstacle_hit: (n,) number of the obstacle that each sample crashed into, from 1 on in the order of the scenario;
            0 if the sample did not crash into an obstacle. None if there are no obstacles.
    """

    scenario: Scenario
    duration: float
    samples: np.ndarray
    parameters: Mapping[str, np.ndarray]
    metrics: Metrics
    failures: Mapping[int, str] = field(default_factory=dict)
    simulated_time: float = 0.0
    invalid_lines: Sequence[int] = ()
    obstacle_hit: np.ndarray | None = None

    @classmethod
    def from_rows(
        cls,
        scenario: Scenario,
        duration: float,
        rows: np.ndarray,
        *,
        failures: Mapping[int, str] = {},
        simulated_time: float = 0.0,
        invalid_lines: Sequence[int] = (),
    ) -> "Study":
        """Return the study with the given rows.

        Args:
            scenario: scenario with the seed of the study.
            duration: duration of a flight, s.
            rows: (n, columns) rows with the columns of `study_columns`, sorted by sample.
            failures: reasons why samples could not be flown, by the index of the sample.
            simulated_time: total simulated time of the samples that were flown in this run, s.
            invalid_lines: line numbers of invalid rows in the results file.
        """
        columns = dict(zip(study_columns(scenario), rows.T, strict=True))
        return cls(
            scenario,
            duration,
            columns["sample"].astype(int),
            {path: columns[path] for path in distributions_in(scenario)},
            scenario.metrics_type(*(columns[name] for name in scenario.metrics_type._fields)),
            dict(failures),
            simulated_time,
            tuple(invalid_lines),
            columns[_OBSTACLE_COLUMN].astype(int) if _OBSTACLE_COLUMN in columns else None,
        )

    def __repr__(self) -> str:
        """Return a one-line description of the study."""
        crashed, num_samples = int(self.metrics.crashed.sum()), len(self.samples)
        failed = f", {len(self.failures)} not flown" if self.failures else ""
        fields = join_names([*self.parameters]) or "none"
        return (
            f"<Study of {self.scenario.name}: {num_samples} samples, {crashed} crashed{failed}; drawn fields: {fields}>"
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the scenario that matter for the interpretation of the results, see `flight_remarks`."""
        return flight_remarks(self.scenario)

    @property
    def replicates(self) -> Replicates:
        """Replicates to which the samples belong."""
        return sample_replicates(self.scenario, self.samples)

    @property
    def flight_time(self) -> np.ndarray:
        """Flight time (n,) of each sample until its end or crash, s."""
        return np.minimum(self.metrics.crash_time, self.duration)

    @property
    def crashes_by_obstacle(self) -> dict[str, int]:
        """Number of samples that crashed into each obstacle, by the name of the obstacle."""
        if self.obstacle_hit is None:
            return {}
        return {name: int((self.obstacle_hit == i).sum()) for i, name in enumerate(_obstacles(self.scenario), start=1)}

    def hit_obstacle_name(self, index: int) -> str | None:
        """Return the name of the obstacle that a sample crashed into; None if there is none.

        Args:
            index: position of the sample in `samples`.
        """
        number = 0 if self.obstacle_hit is None else int(self.obstacle_hit[index])
        return _obstacles(self.scenario)[number - 1] if number else None

    def to_frame(self) -> "pd.DataFrame":
        """Return the study as a pandas table with a row for each flown sample.

        The table is indexed by sample, so that the tables of controllers that flew the same samples can be joined. The
        columns are the drawn numbers by the path of their field, the metrics, `crashed` as True or False, and
        `crash_time`, which is NaN for a sample that did not crash. If there are obstacles, the column `obstacle`
        contains the name of the obstacle that the sample crashed into, or None. The metrics of a sample that crashed
        are computed over its flight until the crash.

        `frame.attrs` contains the `units` of the columns, the name of the `scenario`, the `seed`, the `duration` of a
        flight (s), and the `failures`: the reasons why samples without a row could not be flown, by their index.

        Raises:
            ImportError: if pandas is not installed; pip install 'drake_quad[tables]' installs it.
        """
        pandas = import_extra("pandas", "tables")
        columns = {**self.parameters, **self.metrics._asdict(), "crashed": self.metrics.crashed}
        columns["crash_time"] = np.where(self.metrics.crashed, self.metrics.crash_time, np.nan)
        if self.obstacle_hit is not None:
            names = np.array([None, *_obstacles(self.scenario)], dtype=object)
            columns[_OBSTACLE_COLUMN] = names[self.obstacle_hit]
        ordered = {name: columns[name] for name in study_columns(self.scenario)[1:]}
        frame = pandas.DataFrame(ordered, index=pandas.Index(self.samples, name="sample"))
        frame.attrs = {
            "units": {name: column_unit(self.scenario, name) for name in ordered},
            "scenario": self.scenario.name,
            "seed": self.scenario.seed,
            "duration": self.duration,
            "failures": {str(sample): reason for sample, reason in self.failures.items()},
        }
        return frame

    def to_parquet(self, path: Path | str) -> Path:
        """Write the table of `to_frame` with its attributes to a Parquet file atomically, and return the path.

        `pandas.read_parquet` reads the same table. A study can be resumed from its CSV file only.

        Raises:
            ImportError: if pandas or pyarrow is not installed; pip install 'drake_quad[tables]' installs them.
            OSError: if the file cannot be written.
        """
        import_extra("pyarrow", "tables")
        frame = self.to_frame()
        return write_atomically(Path(path), lambda target: frame.to_parquet(target, engine="pyarrow"))


def sample_replicates(scenario: Scenario, samples: Sequence[int] | np.ndarray) -> Replicates:
    """Return the replicates to which samples (n,) belong, as the scenario's field `draws` determines."""
    draws = scenario.draws
    return INDEPENDENT if draws is None else Replicates(draws.replicates(np.asarray(samples)))


def study_columns(scenario: Scenario) -> list[str]:
    """Return the columns of a study's results: the sample, drawn fields, metrics and, if any, the obstacle hit."""
    measured = [*metric_definitions(scenario.metrics_type)]
    obstacle = [_OBSTACLE_COLUMN] if _obstacles(scenario) else []
    return ["sample", *distributions_in(scenario), *measured, "crashed", "crash_time", *obstacle]


def _obstacles(scenario: Scenario) -> list[str]:
    """Return the names of a scenario's obstacles."""
    return [] if scenario.space is None else [*scenario.space.obstacles]


def study_rows(batch: Batch, metrics: Metrics, obstacle_hit: np.ndarray | None = None) -> np.ndarray:
    """Return the rows (n, columns) of the results table for a batch.

    Args:
        batch: batch of n samples that were flown.
        metrics: (n,) values of each metric.
        obstacle_hit: (n,) number of the obstacle that each sample crashed into, or 0; not used without obstacles.
    """
    columns = {"sample": batch.samples, **batch.varying, **metrics._asdict(), "crashed": metrics.crashed}
    columns[_OBSTACLE_COLUMN] = obstacle_hit
    return np.column_stack([columns[name] for name in study_columns(batch.scenario)])


def study_row_format(scenario: Scenario) -> RowFormat:
    """Return the format of the results file of a scenario's study."""
    # Results files of earlier versions remain valid: their checksums were computed without the field `draws`.
    left_out = {"draws"} if scenario.draws is None else None
    return RowFormat(study_columns(scenario), scenario.model_dump_json(exclude=left_out))


def check_draws(scenario: Scenario, stored: StoredRows) -> StoredRows:
    """Return the content of a results file. Rows whose drawn numbers do not follow from the seed become invalid."""
    if not len(stored.rows):
        return stored
    columns = dict(zip(study_columns(scenario), stored.rows.T, strict=True))
    drawn = Batch.draw(scenario, columns["sample"].astype(int).tolist()).varying
    fits = np.ones(len(stored.rows), dtype=bool)
    for path, numbers in drawn.items():
        fits &= np.isclose(columns[path], numbers, rtol=_ROUNDING_TOLERANCE, atol=0.0)
    return stored._replace(
        rows=stored.rows[fits],
        lines=stored.lines[fits],
        invalid_lines=[*stored.invalid_lines, *stored.lines[~fits]],
    )


def read_study(path: Path | str) -> Study:
    """Read the results of a study, which may still be running or may have been interrupted.

    Args:
        path: folder of the study, one of its files, or a folder that contains a single study.

    Raises:
        InputError: if there is no study or more than one, or its files do not belong together.
    """
    folders = study_folders(path)
    if len(folders) > 1:
        raise InputError(
            f"{path} contains {len(folders)} studies, {join_names([*folders])}; read one of these folders, or read all"
            " of them with read_studies"
        )
    return _read(next(iter(folders.values())))


def read_studies(path: Path | str) -> dict[str, Study]:
    """Read all studies in a folder, such as the studies of several controllers, and return them by folder name.

    Args:
        path: folder that contains the folders of the studies, or the path of a single study as for `read_study`.

    Raises:
        InputError: if there is no study, or the files of a study do not belong together.
    """
    return {name: _read(folder) for name, folder in study_folders(path).items()}


def study_folders(path: Path | str) -> dict[str, Path]:
    """Return the folders of the studies at a path by name: the folder itself, or its subfolders.

    Args:
        path: folder of a study, one of its files, or a folder that contains the folders of studies.

    Raises:
        InputError: if there is no study.
    """
    path = Path(path)
    names = (RESULTS_FILE, PARQUET_FILE, SCENARIO_FILE, STUDY_FILE, FAILED_FILE)
    folder = path.parent if path.is_file() and path.name in names else path
    if (folder / RESULTS_FILE).is_file():
        return {folder.resolve().name: folder}
    if not path.exists():
        raise InputError(f"{path} does not exist")
    subfolders = sorted(each.parent for each in folder.glob(f"*/{RESULTS_FILE}")) if folder.is_dir() else []
    if not subfolders:
        content = sorted(each.name for each in folder.iterdir()) if folder.is_dir() else []
        what = (
            f"it contains {join_names(content)}"
            if content
            else "it is empty"
            if folder.is_dir()
            else "it is another file"
        )
        raise InputError(
            f"{path} is not the folder of a study, which contains {RESULTS_FILE}, {SCENARIO_FILE} and {STUDY_FILE};"
            f" {what}"
        )
    return {each.name: each for each in subfolders}


def _read(folder: Path) -> Study:
    """Read the study in a folder.

    Raises:
        InputError: if a file cannot be read, or contains a row that was altered.
    """
    record, scenario = read_record(folder), load_scenario(folder / SCENARIO_FILE)
    stored = check_draws(scenario, read_results(folder / RESULTS_FILE, study_row_format(scenario)))
    if stored.invalid_lines:
        raise InputError(
            f"{folder / RESULTS_FILE}:{min(stored.invalid_lines)}: the row was altered; resume the study to fly the"
            " sample again"
        )
    rows = stored.rows[np.argsort(stored.rows[:, 0])]
    return Study.from_rows(scenario, record.duration, rows, failures=_read_failures(folder / FAILED_FILE))


def _read_failures(path: Path) -> dict[int, str]:
    """Return the reasons why samples could not be flown, by the index of the sample; empty if there is no file.

    Raises:
        InputError: if the file is not a table of failures.
    """
    if not path.exists():
        return {}
    try:
        table = read_table(path)
        return {int(sample): str(reason) for sample, reason in zip(table["sample"], table["reason"], strict=True)}
    except (KeyError, ValueError):
        raise InputError(f"{path} is not a table with the columns sample and reason") from None


class Record(BaseModel):
    """Content of the file study.yaml, which records how a study was made.

    Attributes:
        samples: number of samples of the complete study.
        seed: seed of the study.
        duration: duration of a flight, s.
        position_controller: name of the function that returns the user's position controller, if any.
        control: name of the function that returns the user's control cascade, if any.
        wind: name of the function that returns the user's additional wind, if any.
        policy: name of the function that returns the user's policy, if any.
        flown: kinds of simulated diagrams, "compiled" or "wired" (uncompiled), in the order of their last use.
        versions: versions and digests of the code that was used, in the order of their last use.
        settings: settings that determine the flights of a search, such as the event whose probability is estimated;
            None for a study of the first samples.
        columns: meaning of each column of the results.
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
    settings: dict[str, str] | None = None
    columns: dict[str, str]

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        num_samples: int,
        duration: float,
        user_systems: UserSystems,
        *,
        compiled: bool,
        settings: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
    ) -> "Record":
        """Return the record of a new study.

        Args:
            scenario: scenario with the seed of the study.
            num_samples: number of samples of the complete study.
            duration: duration of a flight, s.
            user_systems: functions that return the user's systems.
            compiled: True if the diagrams are compiled to machine code.
            settings: settings that determine the flights, if the record belongs to a search.
            columns: meaning of each column of the results, by name; by default, for the columns of `study_columns`.
        """
        if columns is None:
            columns = {name: column_description(scenario, name) for name in study_columns(scenario)}
        return cls(
            samples=num_samples,
            seed=scenario.seed,
            duration=duration,
            **{name: _import_path(function) for name, function in user_systems.specified.items()},
            flown=["compiled" if compiled else "wired"],
            versions=[provenance()],
            settings=None if settings is None else {**settings},
            columns={**columns, CHECKSUM: column_description(scenario, CHECKSUM)},
        )

    def write(self, path: Path) -> None:
        """Write the record of the study to a YAML file."""
        YAML().dump(self.model_dump(exclude_none=True), path)


def read_record(folder: Path) -> Record:
    """Read the record of the study in a folder.

    Raises:
        InputError: if the file cannot be read, or is not the record of a study.
    """
    path = folder / STUDY_FILE
    content = parse_document(read_text(path), str(path)).tree.to_python()
    try:
        return Record.model_validate(content)
    except ValidationError as error:
        field_path = ".".join(map(str, error.errors()[0]["loc"]))
        problem = f": {field_path} is missing or invalid" if field_path else ""
        raise InputError(f"{path} is not the record of a study{problem}") from None


def _import_path(function: Callable[..., Any]) -> str:
    """Return the import path of a function, `module:name`."""
    function = getattr(function, "func", function)
    return f"{function.__module__}:{function.__qualname__}"


def column_description(scenario: Scenario, column: str) -> str:
    """Return the meaning of a column of a study's results, with its unit."""
    meanings = {
        "sample": "index of the sample",
        "crashed": "1 if the vehicle crashed, else 0",
        _OBSTACLE_COLUMN: "number of the obstacle that the vehicle crashed into, from 1 on in the order of the"
        " scenario; 0 if there is none",
        CHECKSUM: "CRC-32 of the row and its study, which reveals rows that were altered",
    }
    if column in meanings:
        return meanings[column]
    if column in scenario.metrics_type._fields:
        return f"metric ({metric_unit(scenario.metrics_type, column)})"
    return description_at(scenario, column)


def column_unit(scenario: Scenario, column: str) -> str:
    """Return the unit of a column of a study's results; "" if the column has none."""
    if column in ("sample", "crashed", _OBSTACLE_COLUMN):
        return ""
    return (
        metric_unit(scenario.metrics_type, column)
        if column in scenario.metrics_type._fields
        else unit_at(scenario, column)
    )
