"""The flights of the replication: the cells of Table II, and the sweeps that the claims need besides.

All comparisons are paired: a sample has the same wind and the same noise, whichever controller flies it.
"""

import shutil
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.flight.flight import Flight
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_samples
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.duration import flight_duration
from drake_quad.replication.measures import LegMetrics, measures
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell
from drake_quad.replication.results import FAIR, MAPPED, cells_of, write_recorded
from drake_quad.replication.sweeps import (
    SLOPES,
    Sweep,
    best_gain_settings,
    fly_legs,
    fly_settings,
    gain_settings,
    noise_settings,
    num_settings,
    q_settings,
    slope_settings,
)
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.studies.monte_carlo import run_monte_carlo
from drake_quad.studies.processes import Workers
from drake_quad.studies.study import rows_of
from drake_quad.studies.study_folder import open_study

# Most vehicles of a fleet.
_VEHICLES = 1024


class Sizes(NamedTuple):
    """How much is flown.

    Attributes:
        cells: samples of each cell.
        recorded: samples of each cell of Table II that are recorded with all signals.
        sweep: samples of each setting of noise, q and λ.
        grid: gains along each side of a map.
        map: samples of each pair of gains of a map.
        legs: samples of each pair of gains whose errors are measured leg by leg.
    """

    cells: int = 1000
    recorded: int = 8
    sweep: int = 60
    grid: int = 16
    map: int = 4
    legs: int = 16

    @property
    def flights(self) -> int:
        """The number of flights."""
        sweeps = len(noise_settings()["noise"]) + len(q_settings()["q"]) + len(WINDS) * len(SLOPES)
        cells = len(cells_of((*CONTROLLERS, *FAIR))) * self.cells
        return cells + sweeps * self.sweep + (len(MAPPED) * self.map + self.legs) * self.grid**2


QUICK = Sizes(cells=4, recorded=4, sweep=4, grid=5, map=2, legs=2)


def fly_experiment(
    load: Callable[[Cell], Scenario],
    sizes: Sizes,
    folder: Path,
    workers: Workers,
    *,
    resume: bool = False,
    compiled: bool = True,
    progress: Callable[[str, int], None] | None = None,
) -> dict[Cell, Flight]:
    """Flies the experiment, and writes its numbers to a folder, from which `read_experiment` reads them.

    Args:
        load: loads the scenario of a cell.
        sizes: of the experiment.
        folder: for the numbers; cells that an earlier experiment left there are replaced.
        workers: that fly.
        compiled: whether diagrams are compiled to machine code; else they fly as they are wired.
        resume: whether to keep the cells that are in the folder, and to fly only what they lack.
        progress: called with the name of what was flown, and how many of `sizes.flights` flights are done.

    Returns:
        The flight of sample 0 of each cell of Table II, for figures.

    Raises:
        RuntimeError: a sample could not be flown.
    """
    jobs = _Jobs(workers)
    record_cell, fly_cell = partial(_record_cell, compiled=compiled), partial(_fly_cell, compiled=compiled)
    recorded = {}
    for cell in cells_of((*CONTROLLERS, *FAIR)):
        target = folder / "cells" / cell.scenario
        if target.exists() and not resume:
            shutil.rmtree(target)
        study = load(cell), sizes.cells, target
        if cell.controller in CONTROLLERS:
            recorded[cell] = jobs.submit(cell.scenario, sizes.cells, record_cell, *study, sizes.recorded)
        else:
            jobs.submit(cell.scenario, sizes.cells, fly_cell, *study)
    network = load(Cell("no_wind", "pd_t2fnn"))
    sweeps = {
        "noise": (network, noise_settings(), sizes.sweep),
        "q": (network, q_settings(), sizes.sweep),
        **{f"slope_{wind}": (load(Cell(wind, "pd_t2fnn")), slope_settings(), sizes.sweep) for wind in WINDS},
        **{f"map_{name}": (load(Cell("no_wind", name)), gain_settings(sizes.grid), sizes.map) for name in MAPPED},
    }
    parts = {name: _submit_sweep(jobs, name, *sweep, compiled=compiled) for name, sweep in sweeps.items()}
    pd, gains = load(Cell("no_wind", "pd")), best_gain_settings(sizes.grid)
    fly = partial(fly_legs, compiled=compiled)
    legs = [jobs.submit("legs", sizes.grid**2, fly, pd, gains, [sample]) for sample in range(sizes.legs)]

    jobs.work(progress)
    write_recorded(folder / "recorded.csv", {cell: job.result.measures for cell, job in recorded.items()})
    for name, (_, settings, count) in sweeps.items():
        metrics = Metrics(*_joined(parts[name], axis=0))
        Sweep(settings, np.arange(count), metrics).save(folder / f"{name}.csv")
    Sweep(gains, np.arange(sizes.legs), LegMetrics(*_joined(legs, axis=1))).save(folder / "legs.csv")
    return {cell: job.result.first for cell, job in recorded.items()}


def _fly_cell(scenario: Scenario, count: int, folder: Path, *, compiled: bool) -> None:
    """Flies what is missing of a cell's study, within one worker, since large fleets fly faster.

    Args:
        scenario: of the cell.
        count: of samples.
        folder: of the study.
        compiled: whether the diagram is compiled.

    Raises:
        RuntimeError: a sample could not be flown.
    """
    with ThreadPoolExecutor(1) as executor:
        study = run_monte_carlo(
            scenario, count, folder=folder, resume=True, num_workers=1, executor=executor, compiled=compiled
        )
    if study.failures:
        sample, reason = next(iter(study.failures.items()))
        raise RuntimeError(f"sample {sample} of {scenario.name} could not be flown: {reason}")


class _Recorded(NamedTuple):
    """What is kept of the recorded samples of a cell.

    Attributes:
        first: the flight of sample 0.
        measures: (recorded,) values by name.
    """

    first: Flight
    measures: dict[str, np.ndarray]


def _record_cell(scenario: Scenario, count: int, folder: Path, recorded: int, *, compiled: bool) -> _Recorded:
    """Flies a cell as `_fly_cell` does, its first samples with all signals.

    Args:
        scenario: of the cell.
        count: of samples.
        folder: of the study.
        recorded: how many of them are flown with all signals.
        compiled: whether the diagram is compiled.
    """
    flights = simulate_samples(scenario, range(recorded), compiled=compiled)
    with open_study(
        folder, scenario, count, _duration(scenario), UserSystems(), compiled=compiled, resume=True
    ) as rows:
        new = [sample for sample in rows.missing if sample < recorded]
        if new:
            metrics = Metrics(*np.transpose([flights[sample].metrics for sample in new]))
            rows.add_rows(rows_of(Batch.draw(scenario, new), metrics))
    _fly_cell(scenario, count, folder, compiled=compiled)
    numbers = [measures(flight) for flight in flights]
    return _Recorded(flights[0], {name: np.array([each[name] for each in numbers]) for name in numbers[0]})


def _duration(scenario: Scenario) -> float:
    """The duration of a flight, s."""
    return flight_duration(scenario, plan_route(scenario))


def _joined(jobs: Sequence["_Job"], axis: int) -> list[np.ndarray]:
    """Joins each of the arrays that jobs returned along an axis."""
    return [np.concatenate(values, axis) for values in zip(*(job.result for job in jobs), strict=True)]


def _submit_sweep(
    jobs: "_Jobs", name: str, scenario: Scenario, settings: Mapping[str, np.ndarray], count: int, *, compiled: bool
) -> list["_Job"]:
    """Adds the jobs that fly a sweep, each a fleet with some of the settings on all samples, in order."""
    total = num_settings(settings)
    at_once = max(_VEHICLES // count, 1)
    return [
        jobs.submit(
            name,
            count * min(at_once, total - first),
            partial(fly_settings, compiled=compiled),
            scenario,
            {number: values[first : first + at_once] for number, values in settings.items()},
            range(count),
        )
        for first in range(0, total, at_once)
    ]


@dataclass
class _Job:
    """A job for a worker.

    Attributes:
        what: it flies, in a word.
        flights: how many it flies.
        call: does the job.
        result: that the call returned, once the job is done.
    """

    what: str
    flights: int
    call: Callable[[], Any]
    result: Any = None


class _Jobs:
    """Jobs that workers do in their order.

    Args:
        workers: that do them.
    """

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self._jobs: list[_Job] = []

    def submit(self, what: str, flights: int, function: Callable[..., Any], *arguments: Any) -> _Job:
        """Adds a job, which calls a function with these arguments."""
        self._jobs.append(_Job(what, flights, partial(function, *arguments)))
        return self._jobs[-1]

    def work(self, progress: Callable[[str, int], None] | None) -> None:
        """Has the workers do all jobs.

        Args:
            progress: called after each job with its `what`, and the number of flights that are done.

        Raises:
            RuntimeError: a job failed.
        """
        waiting, under_way, done = deque(enumerate(self._jobs)), 0, 0
        while waiting or under_way:
            while waiting and under_way < self._workers.capacity:
                number, job = waiting.popleft()
                self._workers.begin(_call, (number, job.call))
                under_way += 1
            for outcome in self._workers.finished():
                under_way -= 1
                if outcome.reason:
                    raise RuntimeError(outcome.reason)
                job = self._jobs[outcome.given[0]]
                job.result, done = outcome.result, done + job.flights
                if progress is not None:
                    progress(job.what, done)


def _call(numbered: tuple[int, Callable[[], Any]]) -> Any:
    _, call = numbered
    return call()
