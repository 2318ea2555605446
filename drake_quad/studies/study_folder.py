"""Results of a running study, which are written to the study's folder if there is one."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_atomically, write_table
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.models import Scenario
from drake_quad.studies.missing_samples import MissingSamples
from drake_quad.studies.results_file import ResultsFile, RowFormat, StoredRows, open_results, write_results
from drake_quad.studies.study import (
    FAILED_FILE,
    PARQUET_FILE,
    RESULTS_FILE,
    SCENARIO_FILE,
    STUDY_FILE,
    Record,
    Study,
    check_draws,
    read_record,
    study_columns,
    study_row_format,
)
from drake_quad.studies.worker_pool import Outcome


class StudyRows:
    """Results of the samples that have been flown so far, with a row for each sample.

    Args:
        scenario: scenario with the seed of the study.
        num_samples: number of samples of the complete study.
        duration: duration of a flight, s.
        stored: initial content of the results file; None if there is no file.
        file: results file to which new rows are appended; None if there is no file.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_samples: int,
        duration: float,
        *,
        stored: StoredRows | None = None,
        file: ResultsFile | None = None,
    ) -> None:
        self._scenario, self.num_samples, self._duration, self._file = scenario, num_samples, duration, file
        columns = study_columns(scenario)
        self._crash_time = columns.index("crash_time")
        self._parts = [np.empty((0, len(columns)))]
        self._invalid_lines: list[int] = []
        if stored is not None:
            self._parts.append(stored.rows)
            self._invalid_lines = sorted(stored.invalid_lines)
        self._count = sum(map(len, self._parts))
        self._simulated_time = 0.0
        self.failures: dict[int, str] = {}

    def __len__(self) -> int:
        return self._count

    def missing(self, num_samples: int) -> MissingSamples:
        """Return which of the first `num_samples` samples have neither been flown nor failed in this run."""
        known = np.concatenate([*(part[:, 0] for part in self._parts), [*self.failures]])
        return MissingSamples(num_samples, known[known < num_samples])

    def metrics(self, num_samples: int) -> Metrics:
        """Return the metrics of the flown samples among the first `num_samples` samples."""
        study = self.study()
        return study.metrics.take(study.samples < num_samples)

    @property
    def rows(self) -> np.ndarray:
        """Rows (n, columns) of the flown samples, sorted by sample."""
        self._parts = [np.concatenate(self._parts)]
        (rows,) = self._parts
        return rows[np.argsort(rows[:, 0])]

    @property
    def saved(self) -> str:
        """Text for messages that says how many samples are on disk."""
        if self._file is None:
            return "nothing was written"
        return f"{len(self)} of {self.num_samples} samples are in {self._file.path}"

    def add(self, outcome: Outcome) -> None:
        """Add the outcome of a batch, and write its rows (n, columns) to the folder.

        Raises:
            OSError: if the rows could not be written.
        """
        if outcome.reason:
            self.failures |= dict.fromkeys(outcome.argument, outcome.reason)
            return
        rows = outcome.result
        if self._file is not None:
            self._file.append(rows)
        self._parts.append(rows)
        self._count += len(rows)
        self._simulated_time += float(np.minimum(rows[:, self._crash_time], self._duration).sum())

    def study(self) -> Study:
        """Return the study with the samples that have been flown so far."""
        return Study.from_rows(
            self._scenario,
            self._duration,
            self.rows,
            failures=dict(sorted(self.failures.items())),
            simulated_time=self._simulated_time,
            invalid_lines=self._invalid_lines,
        )


@contextmanager
def open_study(
    folder: Path | str | None,
    scenario: Scenario,
    num_samples: int,
    duration: float,
    user_systems: UserSystems,
    *,
    compiled: bool,
    resume: bool,
) -> Iterator[StudyRows]:
    """Begin or resume a study, yield its results, and sort the rows of its results file at the end.

    Args:
        folder: folder of the study; None if nothing is to be written.
        scenario: scenario with the seed of the study.
        num_samples: number of samples of the complete study.
        duration: duration of a flight, s.
        user_systems: functions that return the user's systems.
        compiled: True if the diagrams are compiled to machine code.
        resume: True to continue a study that the folder already contains.

    Raises:
        InputError: if the folder cannot be written, or contains another study, or a study that must not be resumed.
    """
    if folder is None:
        yield StudyRows(scenario, num_samples, duration)
        return
    path, row_format = output_folder(Path(folder)) / RESULTS_FILE, study_row_format(scenario)
    folder, record = path.parent, Record.of(scenario, num_samples, duration, user_systems, compiled=compiled)
    with open_rows(path, scenario, record, row_format, resume=resume) as (record, file, content):
        stored = check_draws(scenario, content)
        if len(stored.rows) and stored.rows[:, 0].max() >= num_samples:
            raise InputError(
                f"{folder / RESULTS_FILE} already contains sample {stored.rows[:, 0].max():.0f}, so the study cannot be"
                f" resumed with only {num_samples} samples"
            )
        write_atomically(folder / STUDY_FILE, record.write)
        (folder / PARQUET_FILE).unlink(missing_ok=True)  # the table of an earlier run would lack the new rows
        rows = StudyRows(scenario, num_samples, duration, stored=stored, file=file)
        yield rows
        if rows.failures:
            samples = sorted(rows.failures)
            reasons = [rows.failures[sample] for sample in samples]
            write_table(folder / FAILED_FILE, {"sample": samples, "reason": reasons})
        else:
            (folder / FAILED_FILE).unlink(missing_ok=True)
        write_results(path, row_format, rows.rows)


@contextmanager
def open_rows(
    path: Path, scenario: Scenario, record: Record, row_format: RowFormat, *, resume: bool
) -> Iterator[tuple[Record, ResultsFile, StoredRows]]:
    """Begin or resume a study, and yield its record, its results file, and the rows that the file contains.

    For a new study, this function writes the scenario and the record. For a resumed study, the caller must check these
    rows before it writes the record, which includes the versions of earlier runs.

    Args:
        path: results file in the folder of the study.
        scenario: scenario with the seed of the study.
        record: record of this run.
        row_format: format of the rows.
        resume: True to continue a study that the folder already contains.

    Raises:
        InputError: if the folder contains another study, or a study that must not be resumed.
    """
    folder = path.parent
    if path.exists():
        record = _resumed_record(folder, scenario, record, resume=resume)
    else:
        _check_no_foreign_files(folder, scenario, record)
        write_atomically(folder / SCENARIO_FILE, lambda path: save_scenario(scenario, path))
        write_atomically(folder / STUDY_FILE, record.write)
    with open_results(path, row_format) as (file, content):
        yield record, file, content


@contextmanager
def report_saved_results(describe_saved: Callable[[], str]) -> Iterator[None]:
    """Add a text on the saved results to the messages of errors and of an interruption by Ctrl-C.

    Args:
        describe_saved: function that returns the text, such as `StudyRows.saved`.

    Raises:
        StudyInterrupted: if the user pressed Ctrl-C.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise StudyInterrupted(f"interrupted: {describe_saved()}") from None
    except OSError as error:
        raise OSError(f"{error}; {describe_saved()}") from error
    except RuntimeError as error:
        raise RuntimeError(f"{error}; {describe_saved()}") from error
    except MemoryError as error:
        raise MemoryError(f"there is not enough memory; {describe_saved()}") from error


class StudyInterrupted(KeyboardInterrupt):
    """Interruption of a study by Ctrl-C, whose message says how many samples are saved."""


def _check_no_foreign_files(folder: Path, scenario: Scenario, record: Record) -> None:
    """Check that a folder without results contains no file of another study that this study would overwrite.

    Raises:
        InputError: if the folder contains another scenario, a record without a scenario, or the record of a search with
            other settings.
    """
    if (folder / SCENARIO_FILE).exists() and (folder / STUDY_FILE).exists():
        settings = record.settings
        with suppress(InputError):  # the file may be incomplete
            settings = read_record(folder).settings
        if settings != record.settings:
            raise _foreign_record_error(folder)
    if (folder / SCENARIO_FILE).exists():
        try:
            is_ours = load_scenario(folder / SCENARIO_FILE) == scenario
        except InputError:
            is_ours = False
        if not is_ours:
            raise InputError(
                f"{folder / SCENARIO_FILE} is a different scenario and is not overwritten; choose another folder"
            )
    elif (folder / STUDY_FILE).exists():
        raise _foreign_record_error(folder)


def _foreign_record_error(folder: Path) -> InputError:
    return InputError(f"{folder / STUDY_FILE} exists already and is not overwritten; choose another folder")


def _resumed_record(folder: Path, scenario: Scenario, record: Record, *, resume: bool) -> Record:
    """Return the record of a resumed study, which lists the versions of earlier runs and of this run.

    Args:
        folder: folder of the study.
        scenario: scenario with the seed of the study.
        record: record of the new run.
        resume: True if the study may be resumed.

    Raises:
        InputError: if the study may not be resumed, cannot be read, or is a different study.
    """
    if not resume:
        raise InputError(
            f"{folder} already contains a study; continue it with --resume, or choose another folder with --output"
        )
    try:
        before = read_record(folder)
        saved = load_scenario(folder / SCENARIO_FILE)
    except InputError as error:
        raise InputError(f"the study in {folder} cannot be resumed: {error}") from None
    old, new = ({name: getattr(each, name) for name in ("seed", *UserSystems._fields)} for each in (before, record))
    old, new = old | (before.settings or {}), new | (record.settings or {})
    for name in new | old:
        if old.get(name) != new.get(name):
            raise InputError(f"{folder} contains a different study: its {name} is {old.get(name)}, not {new.get(name)}")
    difference = _difference(saved.model_dump(mode="json"), scenario.model_dump(mode="json"))
    if difference is not None:
        raise InputError(f"{folder} contains a study of a different scenario: {difference}")
    earlier_modes = [each for each in before.flown if each not in record.flown]
    versions = [each for each in before.versions if each not in record.versions]
    return record.model_copy(
        update={"flown": [*earlier_modes, *record.flown], "versions": [*versions, *record.versions]}
    )


def _difference(before: Any, now: Any, path: str = "") -> str | None:
    """Return a description of the first field in which two dumped scenarios differ; None if they are equal."""
    if isinstance(before, dict) and isinstance(now, dict) and before.keys() == now.keys():
        pairs = [(f"{path}.{key}".lstrip("."), before[key], now[key]) for key in now]
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = [(f"{path}.{i}", old, new) for i, (old, new) in enumerate(zip(before, now, strict=True))]
    else:
        return None if before == now else f"its {path} is {before}, not {now}"
    return next(filter(None, (_difference(old, new, where) for where, old, new in pairs)), None)
