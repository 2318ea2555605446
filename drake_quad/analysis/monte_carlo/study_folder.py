"""The rows of a study as they come in, on disk if it has a folder."""

import csv
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from drake_quad.analysis.monte_carlo.results_file import ResultsFile, open_results, sort_results
from drake_quad.analysis.monte_carlo.study import (
    FAILED,
    RESULTS,
    SCENARIO,
    STUDY,
    Study,
    columns_of,
    load_record,
    record_of,
)
from drake_quad.analysis.monte_carlo.workers import Outcome
from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_whole
from drake_quad.scenario import Scenario, load_scenario, save_scenario


class StudyRows:
    """The rows of a study that are there.

    Args:
        scenario: of the study.
        num_samples: of the study.
        duration: of a flight, s.
        known: (m, columns) rows that are there from the beginning.
        file: to which new ones are appended, if any.
    """

    def __init__(
        self, scenario: Scenario, num_samples: int, duration: float, known: np.ndarray, file: ResultsFile | None
    ) -> None:
        self._scenario, self._num_samples, self._duration, self._file = scenario, num_samples, duration, file
        self._table = np.full((num_samples, len(columns_of(scenario))), np.nan)
        self._table[known[:, 0].astype(int)] = known
        self._count = len(known)
        self.failures: dict[int, str] = {}
        self._flown_time = 0.0

    def __len__(self) -> int:
        return self._count

    @property
    def missing(self) -> list[int]:
        """The samples that are not there."""
        missing: list[int] = np.flatnonzero(np.isnan(self._table[:, 0])).tolist()
        return missing

    @property
    def saved(self) -> str:
        """What is on disk, in words."""
        if self._file is None:
            return "nothing was written"
        return f"{len(self)} of {self._num_samples} samples are in {self._file.path}"

    def add(self, outcome: Outcome) -> None:
        """Takes in what became of a batch, and writes it.

        Raises:
            OSError: it could not be written.
        """
        if outcome.rows is None:
            self.failures |= dict.fromkeys(outcome.samples, outcome.reason)
            return
        if self._file is not None:
            self._file.append(outcome.rows)
        self._table[list(outcome.samples)] = outcome.rows
        self._count += len(outcome.samples)
        self._flown_time += float(np.minimum(outcome.rows[:, -1], self._duration).sum())

    def study(self) -> Study:
        """The study so far."""
        rows = self._table[~np.isnan(self._table[:, 0])]
        return Study.of_rows(self._scenario, self._duration, rows, self.failures, self._flown_time)


@contextmanager
def open_study(
    folder: Path | str | None,
    scenario: Scenario,
    num_samples: int,
    duration: float,
    own: Mapping[str, Callable[..., Any] | None],
    *,
    resume: bool,
) -> Iterator[StudyRows]:
    """Begins a study, or goes on with one; at the end its rows are in order.

    Args:
        folder: where it is written, if it is.
        scenario: of the study.
        num_samples: of it.
        duration: of a flight, s.
        own: functions that make controllers or wind of one's own, if given.
        resume: whether a study that is in the folder may be gone on with.

    Raises:
        InputError: the folder cannot be written, or holds another study or one that is not to be resumed.
    """
    columns = columns_of(scenario)
    if folder is None:
        yield StudyRows(scenario, num_samples, duration, np.empty((0, len(columns))), None)
        return
    folder = output_folder(Path(folder))
    record = record_of(scenario, num_samples, duration, own)
    if (folder / RESULTS).exists():
        record = _gone_on_with(folder, scenario, record, resume=resume)
    else:
        write_whole(folder / SCENARIO, lambda path: save_scenario(scenario, path))
        write_whole(folder / STUDY, lambda path: YAML().dump(record, path))
    with open_results(folder / RESULTS, columns) as (file, known):
        if len(known) and known[:, 0].max() >= num_samples:
            raise InputError(
                f"{folder / RESULTS} holds sample {known[:, 0].max():.0f} already, but the study is to have only"
                f" {num_samples} samples"
            )
        write_whole(folder / STUDY, lambda path: YAML().dump(record, path))
        rows = StudyRows(scenario, num_samples, duration, known, file)
        yield rows
    if rows.failures:
        write_whole(folder / FAILED, lambda path: _write_failures(path, rows.failures))
    else:
        (folder / FAILED).unlink(missing_ok=True)
    sort_results(folder / RESULTS)


def _gone_on_with(folder: Path, scenario: Scenario, record: dict[str, Any], *, resume: bool) -> dict[str, Any]:
    """The record of a study that a folder holds, when it is gone on with; raises InputError if it must not be."""
    if not resume:
        raise InputError(f"{folder} holds a study already; go on with it by --resume, or write elsewhere by --output")
    try:
        before = load_record(folder)
        saved = load_scenario(folder / SCENARIO)
    except InputError as error:
        raise InputError(f"{folder / RESULTS} cannot be gone on with: {error}") from None
    for name in ("seed", "position_controller", "control", "wind"):
        if before.get(name) != record.get(name):
            raise InputError(
                f"{folder / RESULTS} is of another study: its {name} is {before.get(name)}, not {record.get(name)}"
            )
    difference = _difference(saved.model_dump(mode="json"), scenario.model_dump(mode="json"))
    if difference is not None:
        raise InputError(f"{folder / RESULTS} is of another scenario: {difference}")
    versions = [each for each in before["versions"] if each not in record["versions"]]
    return {**record, "versions": [*versions, *record["versions"]]}


def _difference(before: Any, now: Any, path: str = "") -> str | None:
    """The first field in which two dumped scenarios differ, in words."""
    if isinstance(before, dict) and isinstance(now, dict) and before.keys() == now.keys():
        pairs = [(f"{path}.{key}".lstrip("."), before[key], now[key]) for key in now]
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = [(f"{path}[{i}]", old, new) for i, (old, new) in enumerate(zip(before, now, strict=True))]
    else:
        return None if before == now else f"its {path} is {before}, not {now}"
    return next(filter(None, (_difference(old, new, where) for where, old, new in pairs)), None)


def _write_failures(path: Path, failures: Mapping[int, str]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["sample", "reason"])
        writer.writerows(sorted(failures.items()))
