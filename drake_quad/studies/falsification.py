"""Search for the worst case of a scenario by the evolution strategy CMA-ES.

The search space is standard normal space, with a coordinate for each independent random number of the scenario. It is
limited to a given number of standard deviations (N. Hansen, "The CMA evolution strategy: a tutorial", 2016).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError, check_integer, lookup
from drake_quad.extras import import_extra
from drake_quad.laboratory.metrics import Metrics, metric_definitions
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in, value_at
from drake_quad.statistics.subset_simulation import NOISE_SEED_BOUND
from drake_quad.studies.evaluator import Evaluator
from drake_quad.studies.stored_flights import stored_flights
from drake_quad.studies.worker_pool import WorkerPool

# The search maximises the badness of a flight: the metric, or its negative if smaller values are worse.
_CRASH_BADNESS = 1e9  # badness of a crash at the end of a flight, which exceeds the badness of any metric
_MAX_METRIC = 0.5e9  # larger metrics, also infinite ones, are replaced with this magnitude
# A mean over several flights with a larger magnitude is reported as infinite. If the metric of one of 100 flights is
# infinite, its replacement `_MAX_METRIC` alone contributes 5e6 to the mean.
_MAX_MEAN_METRIC = 4e6
MIN_FLIGHTS = 250
"""Smallest number of candidates of a generation. Large generations are cheap in fleets, and ignore local optima."""
_INITIAL_STEP = 1.0  # initial step size of CMA-ES, standard deviations


@dataclass(frozen=True)
class WorstCase:
    """Worst case of a scenario.

    Attributes:
        metric: name of the metric.
        is_maximised: True if a larger metric is worse.
        value: metric of the worst case; infinite for a crash.
        is_crash: True if the worst case is a crash.
        names: names of the d random numbers.
        point: (d,) random numbers of the worst case, in standard deviations.
        values: nominal value and worst value of each field with a distribution, by path.
        scenario: scenario of the worst case, with its wind and noise.
        nominal: scenario with the median of each distribution, and with the same wind and noise.
        means: for each generation, the mean metric of the worst candidate over the samples of wind and noise; infinite
            if one of these flights crashes, or if its metric is infinite.
        num_flights: number of flights.
    """

    metric: str
    is_maximised: bool
    value: float
    is_crash: bool
    names: tuple[str, ...]
    point: np.ndarray
    values: Mapping[str, tuple[float, float]]
    scenario: Scenario
    nominal: Scenario
    means: tuple[float, ...]
    num_flights: int


def find_worst_case(
    scenario: Scenario,
    metric: str,
    *,
    maximise: bool = True,
    sigma: float = 3.0,
    max_flights: int = 20_000,
    num_noise: int = 4,
    user_systems: UserSystems = UserSystems(),
    compiled: bool = True,
    pool: WorkerPool | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    progress: Callable[[int, str], None] | None = None,
) -> WorstCase:
    """Search for the random numbers, within some standard deviations, that give the worst metric.

    Each candidate flies with the same few samples of wind and noise, and is rated by the mean of the metric. The worst
    of these flights is the result. A crash is worse than any value, and an early crash is worse than a late one.

    Args:
        scenario: scenario with distributions, whose seed determines all random numbers.
        metric: name of the metric, which may be the robustness of a requirement.
        maximise: True if a larger metric is worse, False if a smaller one is.
        sigma: largest distance of a random number from its median, in standard deviations.
        max_flights: number of flights after which the search ends.
        num_noise: number of samples of wind and noise.
        user_systems: functions that create the user's systems for N vehicles.
        compiled: True to compile the diagram to machine code.
        pool: workers that fly the candidates; by default, one fleet in this process; see `Evaluator`.
        folder: folder for the values of all flights, with which an interrupted search is resumed.
        resume: True to continue a search that the folder already contains.
        progress: function that is called after each batch with its number of flights and a description.

    Raises:
        InputError: if the scenario has no distribution, cannot be flown by a fleet, or has no such metric; if there are
            too few flights for one generation; if the metric is the same in all flights; or if the folder contains
            another study.
        ImportError: if the library cma is not installed.
        RuntimeError: if workers cannot fly a candidate.
        StudyInterrupted: if the user pressed Ctrl-C; finished batches are saved in the folder.
    """
    lookup(metric_definitions(scenario.metrics_type), metric, "metric")
    check_integer(num_noise, "num_noise", minimum=1)
    check_integer(max_flights, "max_flights", minimum=MIN_FLIGHTS * num_noise)
    if not 0.0 < sigma <= 8.0:
        raise InputError(f"sigma is {sigma:g}, but must be above 0 and at most 8")
    cma = import_extra("cma", "robustness")
    evaluator = Evaluator(scenario, num_vehicles=1000, user_systems=user_systems, compiled=compiled, pool=pool)
    # The scenario's seed selects wind and noise, so that searches with different seeds are independent.
    noise = np.random.default_rng(scenario.seed).integers(NOISE_SEED_BOUND, size=num_noise)
    sign = 1.0 if maximise else -1.0
    duration = flight_duration(scenario, evaluator.plan)

    def badness(metrics: Metrics) -> np.ndarray:
        values = sign * np.asarray(getattr(metrics, metric))
        if np.isnan(values[~metrics.crashed]).any():
            raise InputError(f"{metric} is not defined in every flight")
        remaining = 1.0 - np.minimum(metrics.crash_time, duration) / duration
        limited = np.clip(values, -_MAX_METRIC, _MAX_METRIC)
        return np.where(metrics.crashed, _CRASH_BADNESS * (1.0 + remaining), limited)

    worst: tuple[float, np.ndarray, int] = (-math.inf, np.zeros(len(evaluator.names)), 0)
    smallest_badness = math.inf
    means: list[float] = []
    settings = {"search": "falsify", "metric": metric, "maximise": maximise, "sigma": sigma, "noise": num_noise}

    def show(count: int) -> None:
        if progress is not None:
            progress(count, f"{metric} {means[-1]:.4g}" if means else "")

    with stored_flights(
        evaluator,
        badness,
        scenario,
        settings,
        max_flights=max_flights,
        user_systems=user_systems,
        compiled=compiled,
        folder=folder,
        resume=resume,
        progress=show,
    ) as flights:
        population, restart = MIN_FLIGHTS, 0
        dimension = max(len(evaluator.names), 2)  # CMA-ES needs two dimensions; the second one may have no effect
        while flights.num_flights + population * num_noise <= max_flights:
            options = {
                "popsize": population, "seed": 1 + (scenario.seed + restart) % (2**31 - 1), "verbose": -9,
                "bounds": [-sigma, sigma],
            }  # fmt: skip
            start = np.random.default_rng([scenario.seed, restart]).standard_normal(dimension) * bool(restart)
            search = cma.CMAEvolutionStrategy(np.clip(start, -sigma, sigma), min(_INITIAL_STEP, sigma), options)
            while not search.stop() and flights.num_flights + population * num_noise <= max_flights:
                candidates = search.ask()
                points = np.array(candidates)[:, : len(evaluator.names)]
                flown = flights(np.repeat(scipy.special.ndtr(points), num_noise, axis=0), np.tile(noise, population))
                rows = flown.reshape(population, num_noise)
                search.tell(candidates, [*-rows.mean(axis=1)])
                smallest_badness = min(smallest_badness, float(rows.min()))
                row, column = np.unravel_index(int(rows.argmax()), rows.shape)
                worst = max(
                    worst, (float(rows[row, column]), points[row], int(noise[column])), key=lambda each: each[0]
                )
                means.append(sign * _metric_of_badness(float(rows.mean(axis=1).max())))
            population, restart = 2 * population, restart + 1
    value, point, number = worst
    if value == smallest_badness and value < _CRASH_BADNESS:
        raise InputError(
            f"{metric} is {sign * _metric_of_badness(value):.4g} in all {flights.num_flights:,} flights, so there is"
            " no worst case"
        )
    uniform = scipy.special.ndtr(point)
    nominal = median_scenario(scenario).model_copy(update={"sample": number})
    worst_scenario = evaluator.scenario_at(uniform, number)
    values = {path: (value_at(nominal, path), value_at(worst_scenario, path)) for path in distributions_in(scenario)}
    return WorstCase(
        metric,
        maximise,
        sign * _metric_of_badness(value),
        value >= _CRASH_BADNESS,
        evaluator.names,
        point,
        values,
        worst_scenario,
        nominal,
        tuple(means),
        flights.num_flights,
    )


def _metric_of_badness(badness: float) -> float:
    """Return the metric for a mean badness; infinite for a crash, or if one of the averaged metrics is infinite."""
    return badness if abs(badness) < _MAX_MEAN_METRIC else math.copysign(math.inf, badness)
