"""Sobol indices, which attribute the variance of a metric to the random numbers of a scenario.

The first-order index of a random number is the fraction of the variance that this number explains alone. Its total
index also contains its interactions with other numbers. The library SALib computes both (A. Saltelli et al., "Variance
based sensitivity analysis of model output", Computer Physics Communications, 2010).
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError, check_integer, lookup
from drake_quad.extras import import_extra
from drake_quad.laboratory.metrics import Metrics, metric_definitions
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.interval import Interval
from drake_quad.statistics.subset_simulation import NOISE_SEED_BOUND
from drake_quad.studies.evaluator import Evaluator
from drake_quad.studies.stored_flights import stored_flights
from drake_quad.studies.worker_pool import WorkerPool

CRASHED = "crashed"
"""Name for the fraction of crashes, whose variance can be attributed like that of a metric."""
NOISE = "wind and noise"
"""Name of the group of all random numbers of wind and noise."""

_NUM_VEHICLES = 1000  # largest number of vehicles in a fleet


class SobolIndex(NamedTuple):
    """Sobol indices of a random number.

    Attributes:
        name: path of the field, name of the shared variable, or `NOISE`.
        first_order: first-order index with its 95 % interval.
        total: total index with its 95 % interval.
    """

    name: str
    first_order: Interval
    total: Interval


def sobol_indices(
    scenario: Scenario,
    metric: str,
    *,
    num_points: int = 256,
    user_systems: UserSystems = UserSystems(),
    compiled: bool = True,
    pool: WorkerPool | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[SobolIndex, ...]:
    """Return the Sobol indices of all independent random numbers of a scenario, with the largest total index first.

    Wind and noise are one random number. Correlated fields are functions of independent random numbers, to which the
    variance is attributed.

    Args:
        scenario: scenario with distributions, whose seed determines all random numbers.
        metric: name of a metric, or `CRASHED`.
        num_points: number of points N, a power of two. For a scenario with d random numbers, (d + 3) N flights are
            simulated.
        user_systems: functions that create the user's systems for N vehicles.
        compiled: True to compile the diagram to machine code.
        pool: workers that fly the points; by default, one fleet in this process; see `Evaluator`.
        folder: folder for the values of all flights, with which an interrupted computation is resumed.
        resume: True to continue a computation that the folder already contains.
        progress: function that is called with the number of flights so far and the total number.

    Raises:
        InputError: if the scenario has no distribution, cannot be flown by a fleet, or has no such metric; if the
            metric is not finite in every flight, as after a crash; if it does not vary; or if the folder contains
            another study.
        ImportError: if the library SALib is not installed.
        RuntimeError: if workers cannot fly a point.
        StudyInterrupted: if the user pressed Ctrl-C; finished batches are saved in the folder.
    """
    if metric != CRASHED:
        lookup(metric_definitions(scenario.metrics_type), metric, "metric")
    check_integer(num_points, "num_points", minimum=8)
    if num_points & (num_points - 1):
        raise InputError(f"num_points is {num_points}, but must be a power of two")
    sample, analyze = (import_extra(f"SALib.{name}.sobol", "robustness") for name in ("sample", "analyze"))
    evaluator = Evaluator(scenario, num_vehicles=_NUM_VEHICLES, user_systems=user_systems, compiled=compiled, pool=pool)
    names = [*evaluator.names, NOISE]
    problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    points = sample.sample(problem, num_points, calc_second_order=False, seed=scenario.seed)
    noise = np.minimum(points[:, -1] * NOISE_SEED_BOUND, NOISE_SEED_BOUND - 1).astype(np.int64)
    num_done = 0

    def show(count: int) -> None:
        nonlocal num_done
        num_done += count
        if progress is not None:
            progress(num_done, len(points))

    def value(metrics: Metrics) -> np.ndarray:
        if metric == CRASHED:
            return metrics.crashed.astype(float)
        if metrics.crashed.any():
            raise InputError(
                f"some flights crashed, so the variance of {metric} is not defined; use {CRASHED} as the metric, or"
                " narrower distributions"
            )
        values = np.asarray(getattr(metrics, metric))
        if not np.all(np.isfinite(values)):
            raise InputError(f"{metric} is not finite in every flight")
        return values

    with stored_flights(
        evaluator,
        value,
        scenario,
        {"search": "sobol", "metric": metric, "points": num_points},
        max_flights=len(points),
        user_systems=user_systems,
        compiled=compiled,
        folder=folder,
        resume=resume,
        progress=show,
    ) as flights:
        values = flights(points[:, :-1], noise)
    if not values.std() > 0.0:
        raise InputError(f"{metric} does not vary")
    # SALib standardises the values, and estimates the intervals by resampling. It ignores a seed of 0, so the seed is
    # increased by 1.
    found = analyze.analyze(problem, values, calc_second_order=False, seed=scenario.seed + 1)
    indices = [SobolIndex(name, *(_interval(found, kind, i) for kind in ("S1", "ST"))) for i, name in enumerate(names)]
    return tuple(sorted(indices, key=lambda each: -each.total.value))


def _interval(found: dict[str, np.ndarray], kind: str, index: int) -> Interval:
    value, half_width = float(found[kind][index]), float(found[f"{kind}_conf"][index])
    if not math.isfinite(half_width):
        return Interval(value, math.nan, math.nan)
    return Interval(value, value - half_width, value + half_width)
