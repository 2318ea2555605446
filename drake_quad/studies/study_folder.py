"""Rows of a study that is under way, which are written to its folder if it has one."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_atomically, write_table
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.models import Scenario
from drake_quad.studies.crew import Outcome
from drake_quad.studies.missing_samples import MissingSamples
from drake_quad.studies.results_file import Found, ResultsFile, open_results, write_results
from drake_quad.studies.study import (
    FAILED,
    PARQUET,
    RESULTS,
    SCENARIO,
    STUDY,
    Record,
    Study,
    columns_of,
    fitting,
    format_of,
    read_record,
)


class StudyRows:
    """Present rows of a study.

    Args:
        scenario: scenario with the seed of the study.
        num_samples: number of samples of the complete study.
        duration: duration of a flight, s.
        found: initial content of the results file; None if there is no file.
        file: results file to which new rows are appended; None if there is no file.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_samples: int,
        duration: float,
        *,
        found: Found | None = None,
        file: ResultsFile | None = None,
    ) -> None:
        self._scenario, self.num_samples, self._duration, self._file = scenario, num_samples, duration, file
        columns = columns_of(scenario)
        self._crash_time = columns.index("crash_time")
        self._parts = [np.empty((0, len(columns)))]
        self._misfits: list[int] = []
        if found is not None:
            self._parts.append(found.rows)
            self._misfits = sorted(found.misfits)
        self._count = sum(map(len, self._parts))
        self._flown_time = 0.0
        self.failures: dict[int, str] = {}

    def __len__(self) -> int:
        return self._count

    @property
    def missing(self) -> MissingSamples:
        """Indices of the samples that are still missing."""
        return MissingSamples(self.num_samples, np.concatenate([part[:, 0] for part in self._parts]))

    @property
    def rows(self) -> np.ndarray:
        """Rows (n, columns) of the present samples, sorted by sample."""
        self._parts = [np.concatenate(self._parts)]
        (rows,) = self._parts
        return rows[np.argsort(rows[:, 0])]

    @property
    def saved(self) -> str:
        """Text for messages that says which samples are on disk."""
        if self._file is None:
            return "nothing was written"
        return f"{len(self)} of {self.num_samples} samples are in {self._file.path}"

    def add(self, outcome: Outcome) -> None:
        """Add the outcome of a batch, and write its rows (n, columns) to the folder.

        Raises:
            OSError: the rows could not be written.
        """
        if outcome.reason:
            self.failures |= dict.fromkeys(outcome.given, outcome.reason)
            return
        rows = outcome.result
        if self._file is not None:
            self._file.append(rows)
        self._parts.append(rows)
        self._count += len(rows)
        self._flown_time += float(np.minimum(rows[:, self._crash_time], self._duration).sum())

    def study(self) -> Study:
        """Return the study with the present rows."""
        return Study.of_rows(
            self._scenario,
            self._duration,
            self.rows,
            failures=dict(sorted(self.failures.items())),
            flown_time=self._flown_time,
            misfits=self._misfits,
        )


@contextmanager
def open_study(
    folder: Path | str | None,
    scenario: Scenario,
    num_samples: int,
    duration: float,
    own: UserSystems,
    *,
    compiled: bool,
    resume: bool,
) -> Iterator[StudyRows]:
    """Begin or resume a study, yield its rows, and sort the rows in the folder at the end.

    Args:
        folder: folder of the study; None if nothing is to be written.
        scenario: scenario with the seed of the study.
        num_samples: number of samples of the complete study.
        duration: duration of a flight, s.
        own: functions that return the user's systems.
        compiled: True if the diagrams are compiled to machine code.
        resume: True to continue the study in the folder, if there is one.

    Raises:
        InputError: the folder cannot be written, or contains another study or one that is not to be resumed.
    """
    if folder is None:
        yield StudyRows(scenario, num_samples, duration)
        return
    folder, form = output_folder(Path(folder)), format_of(scenario)
    record = Record.of(scenario, num_samples, duration, own, compiled=compiled)
    if (folder / RESULTS).exists():
        record = _gone_on_with(folder, scenario, record, resume=resume)
    else:
        _check_vacant(folder, scenario)
        write_atomically(folder / SCENARIO, lambda path: save_scenario(scenario, path))
        write_atomically(folder / STUDY, record.write)
    with open_results(folder / RESULTS, form) as (file, whole):
        found = fitting(scenario, whole)
        if len(found.rows) and found.rows[:, 0].max() >= num_samples:
            raise InputError(
                f"{folder / RESULTS} holds sample {found.rows[:, 0].max():.0f} already, but the study is to have only"
                f" {num_samples} samples"
            )
        write_atomically(folder / STUDY, record.write)
        (folder / PARQUET).unlink(missing_ok=True)  # a table of an earlier run would have fewer rows
        rows = StudyRows(scenario, num_samples, duration, found=found, file=file)
        yield rows
        if rows.failures:
            samples = sorted(rows.failures)
            reasons = [rows.failures[sample] for sample in samples]
            write_table(folder / FAILED, {"sample": samples, "reason": reasons})
        else:
            (folder / FAILED).unlink(missing_ok=True)
        write_results(folder / RESULTS, form, rows.rows)


def _check_vacant(folder: Path, scenario: Scenario) -> None:
    """Check that a folder without results contains no files of another origin that the study would overwrite.

    Raises:
        InputError: the folder contains another scenario, or a record without a scenario.
    """
    if (folder / SCENARIO).exists():
        try:
            ours = load_scenario(folder / SCENARIO) == scenario
        except InputError:
            ours = False
        if not ours:
            raise InputError(f"{folder / SCENARIO} would be overwritten, and is no study's; choose another folder")
    elif (folder / STUDY).exists():
        raise InputError(f"{folder / STUDY} would be overwritten, and is no study's; choose another folder")


def _gone_on_with(folder: Path, scenario: Scenario, record: Record, *, resume: bool) -> Record:
    """Return the record of the resumed study, which lists the old and the new versions.

    Args:
        folder: folder of the study.
        scenario: scenario with the seed of the study.
        record: record of the new run.
        resume: True if the study may be resumed.

    Raises:
        InputError: the study may not be resumed, cannot be read, or is a different study.
    """
    if not resume:
        raise InputError(f"{folder} holds a study already; go on with it by --resume, or write elsewhere by --output")
    try:
        before = read_record(folder)
        saved = load_scenario(folder / SCENARIO)
    except InputError as error:
        raise InputError(f"{folder / RESULTS} cannot be gone on with: {error}") from None
    for name in ("seed", *UserSystems._fields):
        if getattr(before, name) != getattr(record, name):
            raise InputError(
                f"{folder / RESULTS} is of another study: its {name} is {getattr(before, name)}, not"
                f" {getattr(record, name)}"
            )
    difference = _difference(saved.model_dump(mode="json"), scenario.model_dump(mode="json"))
    if difference is not None:
        raise InputError(f"{folder / RESULTS} is of another scenario: {difference}")
    flown = [each for each in before.flown if each not in record.flown]
    versions = [each for each in before.versions if each not in record.versions]
    return record.model_copy(update={"flown": [*flown, *record.flown], "versions": [*versions, *record.versions]})


def _difference(before: Any, now: Any, path: str = "") -> str | None:
    """Return the first field in which two dumped scenarios differ as text; None if they are equal."""
    if isinstance(before, dict) and isinstance(now, dict) and before.keys() == now.keys():
        pairs = [(f"{path}.{key}".lstrip("."), before[key], now[key]) for key in now]
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = [(f"{path}.{i}", old, new) for i, (old, new) in enumerate(zip(before, now, strict=True))]
    else:
        return None if before == now else f"its {path} is {before}, not {now}"
    return next(filter(None, (_difference(old, new, where) for where, old, new in pairs)), None)
