"""The flights of the replication: the cells of Table II, and what its claims need beyond them.

All are paired: a sample is the same wind and the same noise, whoever flies it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.analysis.monte_carlo import Study, run_monte_carlo
from drake_quad.analysis.monte_carlo.workers import Workers
from drake_quad.analysis.replication.legs import LegErrors, fly_legs
from drake_quad.analysis.replication.printed import CONTROLLERS, WINDS, Cell
from drake_quad.analysis.replication.sweeps import Sweep, fly_settings, gain_settings, noise_settings, share_settings
from drake_quad.flight import Flight, simulate_samples
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario import Scenario

# Controllers that the paper does not have, for a fair comparison.
FAIR = {"pid": "PID", "pd_feed_forward": "PD with feed-forward"}
_VEHICLES = 1024


class Sizes(NamedTuple):
    """How much is flown.

    Attributes:
        cells: samples of each cell.
        recorded: samples of each cell with all signals.
        sweep: samples of each setting of noise and network.
        grid: gains along each axis of the map.
        map: samples of each pair of gains.
    """

    cells: int = 1000
    recorded: int = 8
    sweep: int = 60
    grid: int = 14
    map: int = 4


QUICK = Sizes(cells=40, recorded=3, sweep=6, grid=6, map=2)


class TunedLegs(NamedTuple):
    """A PD tuned on straight lines and one tuned on curves.

    Attributes:
        k_p: of the two, 1/s².
        k_d: 1/s.
        errors: (2, samples) of both, on samples that they were not tuned on.
    """

    k_p: np.ndarray
    k_d: np.ndarray
    errors: LegErrors


@dataclass(frozen=True)
class Experiment:
    """Everything that was flown.

    Attributes:
        cells: study of each cell, of the controllers of Table II and of `FAIR`.
        flights: recorded samples of each cell of Table II.
        noise: networks without wind over the noise of the cameras: numbers "noise" (m), "a1", "a2".
        shares: the same over "q" at the paper's noise.
        maps: PD and PD+T2FNN without wind over "k_p" (1/s²) and "k_d" (1/s).
        legs: the PD's with the gains that are best on straight legs, and with those that are best on curved ones.
    """

    cells: Mapping[Cell, Study]
    flights: Mapping[Cell, Sequence[Flight]]
    noise: Sweep
    shares: Sweep
    maps: Mapping[str, Sweep]
    legs: TunedLegs


def run_experiment(
    load: Callable[[Cell], Scenario],
    sizes: Sizes,
    folder: Path,
    workers: Workers,
    *,
    resume: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> Experiment:
    """Flies everything.

    Args:
        load: gives the scenario of a cell.
        sizes: of it.
        folder: to which the rows of each cell go, each to one of its own.
        workers: that fly.
        resume: whether to go on with cells that are in the folder.
        progress: called with what is flown, and how many of how many samples are done.
    """

    def told(what: str) -> Callable[[int, int], None]:
        return lambda done, total: progress(what, done, total) if progress is not None else None

    cells = {}
    for wind in WINDS:
        for controller in (*CONTROLLERS, *FAIR):
            cell = Cell(wind, controller)
            cells[cell] = run_monte_carlo(
                load(cell),
                sizes.cells,
                folder=folder / cell.scenario,
                resume=resume,
                num_workers=workers.num_workers,
                executor=workers,
                progress=told(cell.scenario),
            )
    recorded = [Cell(wind, controller) for wind in WINDS for controller in CONTROLLERS]
    jobs = {cell: workers.submit(simulate_samples, load(cell), range(sizes.recorded)) for cell in recorded}
    flights = dict(_awaited(jobs, told("recorded flights")))
    network = load(Cell("no_wind", "pd_t2fnn"))
    samples = range(sizes.sweep)
    noise = _sweep(workers, network, noise_settings(), samples, told("noise"))
    shares = _sweep(workers, network, share_settings(), samples, told("q"))
    maps = {
        controller: _sweep(
            workers, load(Cell("no_wind", controller)), gain_settings(sizes.grid), range(sizes.map), told("gains")
        )
        for controller in ("pd", "pd_t2fnn")
    }
    told("legs")(0, 2)
    legs = _tuned_legs(workers, load(Cell("no_wind", "pd")), sizes)
    return Experiment(cells, flights, noise, shares, maps, legs)


def _tuned_legs(workers: Workers, scenario: Scenario, sizes: Sizes) -> TunedLegs:
    settings = gain_settings(sizes.grid // 2)
    found = workers.submit(fly_legs, scenario, settings, [0]).result()
    best = [int(np.nanargmin(errors[:, 0])) for errors in (found.straight, found.curved)]
    tuned = {name: values[best] for name, values in settings.items()}
    return TunedLegs(**tuned, errors=workers.submit(fly_legs, scenario, tuned, range(1, 1 + sizes.sweep // 3)).result())


def _sweep(
    workers: Workers,
    scenario: Scenario,
    settings: Mapping[str, np.ndarray],
    samples: Sequence[int],
    told: Callable[[int, int], None],
) -> Sweep:
    """Flies all settings on the same samples, in fleets."""
    count = len(next(iter(settings.values())))
    at_once = max(1, min(_VEHICLES // len(samples), -(-count // workers.num_workers)))
    jobs = {
        first: workers.submit(
            fly_settings,
            scenario,
            {name: values[first : first + at_once] for name, values in settings.items()},
            samples,
        )
        for first in range(0, count, at_once)
    }
    found = dict(_awaited(jobs, told))
    metrics = Metrics(*(np.concatenate(values) for values in zip(*found.values(), strict=True)))
    return Sweep(settings, metrics)


def _awaited(jobs: Mapping, told: Callable[[int, int], None]) -> Iterator:
    """The results of jobs, in their order."""
    for i, (name, job) in enumerate(jobs.items()):
        told(i, len(jobs))
        yield name, job.result()
    told(len(jobs), len(jobs))
