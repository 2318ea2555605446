"""Flights of a search, whose values are stored in a file so that the search can be resumed.

A search chooses its next points from the values of earlier flights. If it is repeated with the same seed, it asks for
the same flights in the same order. A resumed search therefore runs again from its beginning, reads the values of its
earlier flights from the file, and flies only the missing ones.
"""

import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_atomically
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.models import Scenario
from drake_quad.studies.evaluator import Evaluator
from drake_quad.studies.results_file import ResultsFile, RowFormat, StoredRows, write_results
from drake_quad.studies.study import STUDY_FILE, Record
from drake_quad.studies.study_folder import open_rows, report_saved_results

FLIGHTS_FILE = "flights.csv"
_COLUMNS = {
    "flight": "index of the flight in the order of the search",
    "value": "value that the search uses",
    "point": "CRC-32 of the point and of the numbers that determine wind and noise",
}


class StoredFlights:
    """Function that maps points of the unit cube, and integers that determine wind and noise, to one value per flight.

    Args:
        evaluator: evaluator that flies the points.
        value: function that returns the values (n,) of metrics.
        progress: function that is called with the number of flights of each finished batch.
        file: results file to which new rows are appended; None if nothing is stored.
        stored: content of the results file; None if there is no file.

    Attributes:
        evaluator: evaluator that flies the points.
        num_flights: number of flights so far, including those whose values were stored.
    """

    def __init__(
        self,
        evaluator: Evaluator,
        value: Callable[[Metrics], np.ndarray],
        *,
        progress: Callable[[int], None] | None = None,
        file: ResultsFile | None = None,
        stored: StoredRows | None = None,
    ) -> None:
        self.evaluator, self.num_flights = evaluator, 0
        self._value, self._progress, self._file = value, progress, file
        self._rows: dict[int, tuple[float, float, float]] = {}
        if stored is not None:
            self._rows = {int(row[0]): (row[0], row[1], row[2]) for row in stored.rows.tolist()}

    @property
    def rows(self) -> np.ndarray:
        """Rows (n, 3) of all known flights, with the columns of the flights file, sorted by flight."""
        return np.array([self._rows[flight] for flight in sorted(self._rows)]).reshape(-1, len(_COLUMNS))

    @property
    def saved(self) -> str:
        """Text for messages that says how many flights are on disk."""
        if self._file is None:
            return "nothing was written"
        return f"{len(self._rows):,} flights are in {self._file.path}, and --resume continues from there"

    def __call__(self, points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Return the value (n,) of each flight. Flights whose values are stored are not flown again.

        Args:
            points: (n, d) points of the unit cube.
            noise: (n,) or (n, num_periods) integers that determine wind and noise.

        Raises:
            InputError: if a stored flight had another point, or other wind and noise.
            RuntimeError: if a point cannot be flown.
        """
        numbers = noise.reshape(len(points), -1)
        flights = self.num_flights + np.arange(len(points))
        checks = [
            zlib.crc32(number.tobytes(), zlib.crc32(point.tobytes()))
            for point, number in zip(points, numbers, strict=True)
        ]
        self.num_flights += len(points)
        for flight, check in zip(flights.tolist(), checks, strict=True):
            if flight in self._rows and self._rows[flight][2] != check:
                raise InputError(
                    f"the search cannot be resumed, since flight {flight} of the earlier run had other random numbers;"
                    " other versions of the libraries may be the reason; choose another folder"
                )
        missing = np.array([flight not in self._rows for flight in flights.tolist()])
        self._report(len(points) - int(missing.sum()))
        if missing.any():
            chosen, chosen_checks = flights[missing], np.array(checks)[missing]
            for indices, metrics in self.evaluator.batches(points[missing], numbers[missing]):
                rows = np.column_stack([chosen[indices], self._value(metrics), chosen_checks[indices]])
                if self._file is not None:
                    self._file.append(rows)
                self._rows |= {int(row[0]): (row[0], row[1], row[2]) for row in rows.tolist()}
                self._report(len(rows))
        return np.array([self._rows[flight][1] for flight in flights.tolist()])

    def _report(self, count: int) -> None:
        if count and self._progress is not None:
            self._progress(count)


@contextmanager
def stored_flights(
    evaluator: Evaluator,
    value: Callable[[Metrics], np.ndarray],
    scenario: Scenario,
    settings: Mapping[str, Any],
    *,
    max_flights: int,
    user_systems: UserSystems,
    compiled: bool,
    folder: Path | str | None,
    resume: bool,
    progress: Callable[[int], None] | None,
) -> Iterator[StoredFlights]:
    """Begin or resume a search, and yield its flights.

    Args:
        evaluator: evaluator that flies the points.
        value: function that returns the values (n,) of metrics.
        scenario: scenario of the search, with its distributions and its seed.
        settings: settings that determine points and values of the flights.
        max_flights: largest number of flights, which is written to study.yaml.
        user_systems: functions that create the user's systems for N vehicles.
        compiled: True if the diagram is compiled to machine code.
        folder: folder for the values of all flights, the scenario and study.yaml; None to write nothing.
        resume: True to continue a search that the folder already contains.
        progress: function that is called with the number of flights of each finished batch.

    Raises:
        InputError: if the folder cannot be written, or contains another search, or a search that must not be resumed.
        StudyInterrupted: if the user pressed Ctrl-C.
    """
    if folder is None:
        yield StoredFlights(evaluator, value, progress=progress)
        return
    path, texts = output_folder(Path(folder)) / FLIGHTS_FILE, {name: str(each) for name, each in settings.items()}
    record = Record.of(
        scenario,
        max_flights,
        flight_duration(scenario, evaluator.plan),
        user_systems,
        compiled=compiled,
        settings=texts,
        columns=_COLUMNS,
    )
    row_format = RowFormat(tuple(_COLUMNS), f"{scenario.model_dump_json()} {texts}", is_exact=True)
    with open_rows(path, scenario, record, row_format, resume=resume) as (record, file, stored):
        write_atomically(path.parent / STUDY_FILE, record.write)
        flights = StoredFlights(evaluator, value, progress=progress, file=file, stored=stored)
        with report_saved_results(lambda: flights.saved):
            yield flights
        write_results(path, row_format, flights.rows)
