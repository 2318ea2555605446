"""Flights of the replication: the cells of Table II, and the sweeps that the claims require.

All comparisons are paired: a sample has the same wind and noise for all controllers.
"""

import shutil
from collections import defaultdict
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_quad.flight.flight import Flight
from drake_quad.flight.simulation import simulate_samples
from drake_quad.replication.measures import measures
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell
from drake_quad.replication.results import FAIR_CONTROLLERS, MAPPED_CONTROLLERS, select_cells, write_recorded
from drake_quad.replication.sweeps import (
    BEST_GAIN_RANGES,
    NOISE_SETTINGS,
    Q_SETTINGS,
    SLOPE_SETTINGS,
    Sweep,
    fly_legs,
    fly_settings,
    gain_settings,
    num_rows,
)
from drake_quad.reports.jobs import Job, run_jobs
from drake_quad.scenario.models import Scenario
from drake_quad.studies.monte_carlo import run_monte_carlo
from drake_quad.studies.worker_pool import WorkerPool

_MAX_VEHICLES = 1024  # largest number of vehicles in a fleet
_MAX_RECORDED_VEHICLES = 256  # largest number of vehicles in a recorded fleet, which needs more memory


class ExperimentSizes(NamedTuple):
    """Numbers of Monte Carlo samples, and of parameter settings, in the experiment.

    Attributes:
        cells: number of samples of each combination of controller and wind, which is called a cell as in Table II.
        recorded: number of samples of each cell of Table II for which all signals are recorded.
        sweep: number of samples for each value of the noise, the weight q of the lower memberships or the slope λ.
        grid: number of gains along each side of a map.
        map: number of samples of each pair of gains in a map.
        legs: number of samples of each pair of gains in the sweep that computes errors leg by leg.
    """

    cells: int = 1000
    recorded: int = 8
    sweep: int = 60
    grid: int = 16
    map: int = 4
    legs: int = 16


QUICK = ExperimentSizes(cells=4, recorded=4, sweep=4, grid=5, map=2, legs=2)
"""Sizes of a quick experiment, which only shows that every part of the experiment runs."""


class SweepPlan(NamedTuple):
    """Plan of a parameter sweep of the experiment.

    Attributes:
        cell: cell whose scenario is flown.
        settings: (settings,) values of each varied parameter, keyed by name.
        num_samples: number of samples that are flown with each setting.
        fly: function that flies some of the settings in one fleet: `fly_settings` or `fly_legs`.
        max_vehicles: largest number of vehicles in a fleet.
    """

    cell: Cell
    settings: Mapping[str, np.ndarray]
    num_samples: int
    fly: Callable[..., Any] = fly_settings
    max_vehicles: int = _MAX_VEHICLES

    def jobs(self, name: str, scenario: Scenario, *, compiled: bool) -> list[Job]:
        """Return the jobs that simulate the sweep, each with as many settings as fit into a fleet.

        Args:
            name: name of the jobs.
            scenario: scenario of the cell.
            compiled: True to compile the diagrams to machine code; False to simulate the uncompiled diagrams.
        """
        total = num_rows(self.settings)
        step = max(self.max_vehicles // self.num_samples, 1)
        fly = partial(self.fly, scenario, samples=range(self.num_samples), compiled=compiled)
        parts = (slice(first, min(first + step, total)) for first in range(0, total, step))
        return [
            Job(
                name,
                self.num_samples * (part.stop - part.start),
                partial(fly, settings={number: values[part] for number, values in self.settings.items()}),
            )
            for part in parts
        ]


def sweep_plans(sizes: ExperimentSizes) -> dict[str, SweepPlan]:
    """Return the plans of all sweeps, keyed by the name of the results file."""
    network, pd = Cell("no_wind", "pd_t2fnn"), Cell("no_wind", "pd")
    slopes = {f"slope_{wind}": SweepPlan(Cell(wind, "pd_t2fnn"), SLOPE_SETTINGS, sizes.sweep) for wind in WINDS}
    gains = gain_settings(sizes.grid)
    return {
        "noise": SweepPlan(network, NOISE_SETTINGS, sizes.sweep),
        "q": SweepPlan(network, Q_SETTINGS, sizes.sweep),
        **slopes,
        **{f"map_{name}": SweepPlan(Cell("no_wind", name), gains, sizes.map) for name in MAPPED_CONTROLLERS},
        "legs": SweepPlan(
            pd, gain_settings(sizes.grid, BEST_GAIN_RANGES), sizes.legs, fly_legs, _MAX_RECORDED_VEHICLES
        ),
    }


def fly_experiment(
    load: Callable[[Cell], Scenario],
    sizes: ExperimentSizes,
    folder: Path,
    workers: WorkerPool | None = None,
    *,
    resume: bool = False,
    compiled: bool = True,
    progress: Callable[[int, int, str], object] = lambda *_: None,
) -> dict[Cell, Flight]:
    """Simulate the flights of the experiment, and write the results to a folder for `read_experiment`.

    Args:
        load: function that loads the scenario of a cell.
        sizes: sizes of the experiment.
        folder: folder for the results; results of an earlier experiment are replaced.
        workers: workers in which flights are simulated; by default, they are simulated in this process.
        resume: True to keep the cells in the folder and to fly only their missing samples.
        compiled: True to compile the diagrams to machine code; False to simulate the uncompiled diagrams.
        progress: called with the number of finished flights, their total number, and the name of the job.

    Returns:
        The flight of sample 0 of each cell of Table II, for figures.

    Raises:
        InputError: if a scenario cannot be flown.
        RuntimeError: if a sample could not be flown.
    """
    if (folder / "cells").exists() and not resume:
        shutil.rmtree(folder / "cells")
    jobs, plans = [], sweep_plans(sizes)
    for cell in select_cells((*CONTROLLERS, *FAIR_CONTROLLERS)):
        fly = partial(_fly_cell, load(cell), sizes.cells, folder / "cells" / cell.scenario, compiled=compiled)
        jobs.append(Job(cell.scenario, sizes.cells, fly))
    for cell in select_cells(CONTROLLERS):
        record = partial(_record_cell, load(cell), sizes.recorded, compiled=compiled)
        jobs.append(Job(f"recorded {cell.scenario}", sizes.recorded, record))
    for name, plan in plans.items():
        jobs += plan.jobs(name, load(plan.cell), compiled=compiled)
    results = defaultdict(list)
    for job, result in zip(jobs, run_jobs(jobs, workers, progress=progress), strict=True):
        results[job.name].append(result)

    recorded = {cell: results[f"recorded {cell.scenario}"][0] for cell in select_cells(CONTROLLERS)}
    write_recorded(folder / "recorded.csv", {cell: record.measures for cell, record in recorded.items()})
    for name, plan in plans.items():
        kind = type(results[name][0])
        metrics = kind(*(np.concatenate(parts) for parts in zip(*results[name], strict=True)))
        Sweep(plan.settings, np.arange(plan.num_samples), metrics).save(folder / f"{name}.csv")
    return {cell: record.first for cell, record in recorded.items()}


def _fly_cell(scenario: Scenario, num_samples: int, folder: Path, *, compiled: bool) -> None:
    """Simulate the missing samples of a cell's study.

    All samples fly in one fleet, since a large fleet takes less computing time per vehicle.

    Raises:
        RuntimeError: if a sample could not be flown.
    """
    with ThreadPoolExecutor(1) as executor:
        study = run_monte_carlo(
            scenario, num_samples, folder=folder, resume=True, num_workers=1, executor=executor, compiled=compiled
        )
    if study.failures:
        sample, reason = next(iter(study.failures.items()))
        raise RuntimeError(f"sample {sample} of {scenario.name} could not be flown: {reason}")


class RecordedCell(NamedTuple):
    """Results of the recorded samples of a cell of Table II.

    Attributes:
        first: flight of sample 0.
        measures: (samples,) values of each measure, keyed by name.
    """

    first: Flight
    measures: dict[str, np.ndarray]


def _record_cell(scenario: Scenario, num_samples: int, *, compiled: bool) -> RecordedCell:
    """Simulate the first samples of a cell, record all signals, and return the measures of these flights."""
    flights = simulate_samples(scenario, range(num_samples), compiled=compiled)
    numbers = [measures(flight) for flight in flights]
    return RecordedCell(flights[0], {name: np.array([each[name] for each in numbers]) for name in numbers[0]})
