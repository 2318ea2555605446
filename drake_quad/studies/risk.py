"""Probabilities of rare events of a scenario, by subset simulation on fleets.

A sample of the scenario consists of a point of standard normal space, with a coordinate for each independent random
number, and of integers, each of which determines wind and noise in one period of the flight.
"""

import math
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError, check_integer, lookup, short_repr
from drake_quad.laboratory.metrics import Metrics, metric_definitions
from drake_quad.number_parsing import parse_float
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.estimates import mean_interval, proportion_interval
from drake_quad.statistics.interval import Interval
from drake_quad.statistics.subset_simulation import (
    MIN_RUNS,
    MIN_SIZE,
    SubsetRun,
    probability_of_runs,
    relative_half_width,
    run_together,
    subset_steps,
)
from drake_quad.studies.evaluator import Evaluator
from drake_quad.studies.statistics import values_with_crashes
from drake_quad.studies.stored_flights import stored_flights
from drake_quad.studies.worker_pool import WorkerPool

_CRASH = "crash"
_SIGNS = {">": 1.0, "<": -1.0}
_EVENT_PATTERN = re.compile(r"\s*(\w+)\s*(?:([<>])\s*(\S+)\s*)?")
_STEP_PROBABILITY = 0.1  # conditional probability of each step of subset simulation
# Performance of a flight whose metric is equal to the bound, which is not part of the event. It is the largest
# floating-point number below zero.
_PERFORMANCE_AT_BOUND = -5e-324
DEFAULT_PERIOD = 1.0
# Half-width of the interval, relative to the estimate, at which an estimation ends.
DEFAULT_HALF_WIDTH = 0.3
"""Default length of the periods whose noise is drawn separately, s."""


class Event(NamedTuple):
    """Event whose probability is estimated: a crash, or a metric that is above or below a bound.

    A crashed flight has the worst possible value of every metric.

    Attributes:
        metric: name of the metric; `crash` for a crash.
        sign: 1 if the event occurs above the bound, -1 if it occurs below.
        bound: bound in the unit of the metric.
    """

    metric: str
    sign: float = 1.0
    bound: float = 0.0

    @classmethod
    def parse(cls, text: str, scenario: Scenario) -> "Event":
        """Return the event that a text states, such as `peak_error > 0.8`, `crash`, or `stays_near < 0`.

        Raises:
            InputError: if the text is not an event, or the scenario has no such metric.
        """
        match = _EVENT_PATTERN.fullmatch(text)
        if match is None or (match[2] is None) != (match[1] == _CRASH):
            raise InputError(f"{short_repr(text)} is not an event; write it as in 'peak_error > 0.8', or write 'crash'")
        if match[2] is None:
            return cls(_CRASH)
        lookup(metric_definitions(scenario.metrics_type), match[1], "metric")
        try:
            bound = parse_float(match[3])
        except ValueError:
            bound = math.nan
        if not math.isfinite(bound):
            raise InputError(f"{short_repr(text)}: {short_repr(match[3])} is not a number")
        return cls(match[1], _SIGNS[match[2]], bound)

    def __str__(self) -> str:
        """Return the event as text, such as `rmse > 0.1` or `crash`."""
        return self.metric if self.metric == _CRASH else f"{self.metric} {'>' if self.sign > 0 else '<'} {self.bound:g}"

    def performance(self, metrics: Metrics) -> np.ndarray:
        """Return the performance (n,) of each flight, a number that is 0 or more if the event occurs.

        The closer a flight without the event is to the event, the larger is its performance.

        Raises:
            InputError: if the metric of a flight is not defined.
        """
        if self.metric == _CRASH:
            # A large position error usually precedes a crash, so the peak error measures how close a flight is to a
            # crash.
            return np.where(metrics.crashed, 0.0, -1.0 / (1.0 + np.asarray(metrics.peak_error)))
        values = values_with_crashes(metrics, self.metric)
        if np.isnan(values).any():
            raise InputError(f"{self.metric} is not defined in every flight, so it cannot define an event")
        distances = np.asarray(self.sign * (values - self.bound))
        # A flight whose metric equals the bound does not count as an event. For example, the event `stays_near < 0`
        # excludes flights with the robustness 0, since these satisfy the requirement.
        return np.where(distances == 0.0, _PERFORMANCE_AT_BOUND, distances)

    def value(self, performance: np.ndarray) -> np.ndarray:
        """Return the values of the metric, given the values of `performance`."""
        return np.asarray(self.bound + self.sign * np.where(performance == _PERFORMANCE_AT_BOUND, 0.0, performance))


class Coordinate(NamedTuple):
    """Coordinate of the samples at which an event occurs.

    Over all samples of the scenario, the coordinate has the mean 0 and the standard deviation 1.

    Attributes:
        name: path of the field, or name of the shared variable.
        mean: mean over the samples at which the event occurs, in standard deviations.
        deviation: standard deviation over these samples, in standard deviations.
    """

    name: str
    mean: Interval
    deviation: float

    @property
    def importance(self) -> float:
        """Kullback-Leibler divergence of a normal fit of the samples from the standard normal distribution."""
        variance = max(self.deviation, 1e-3) ** 2
        return 0.5 * (self.mean.value**2 + variance - 1.0 - math.log(variance))


@dataclass(frozen=True)
class Risk:
    """Estimated probability of an event.

    Attributes:
        event: event whose probability is estimated.
        probability: estimate with its 95 % interval.
        runs: independent runs of subset simulation.
        coordinates: all coordinates of the samples at which the event occurs, most important coordinate first.
        scenarios: scenarios of the worst samples, worst sample first.
        num_flights: number of flights of all runs.
        is_precise: True if the interval is as short as requested.
    """

    event: Event
    probability: Interval
    runs: tuple[SubsetRun, ...]
    coordinates: tuple[Coordinate, ...]
    scenarios: tuple[Scenario, ...]
    num_flights: int
    is_precise: bool

    def exceedance(self, thresholds: np.ndarray) -> list[Interval]:
        """Return the probabilities that the metric is beyond each of the (k,) thresholds, with intervals.

        If a run has not reached a threshold, the probability has no interval.
        """
        levels = self.event.sign * (np.asarray(thresholds) - self.event.bound)
        rows = np.stack([run.exceedance(levels) for run in self.runs])
        return [
            probability_of_runs(column) if np.all(column > 0.0) else Interval(float(column.mean()), math.nan, math.nan)
            for column in rows.T
        ]


def estimate_risk(
    scenario: Scenario,
    event: Event | str,
    *,
    half_width: float = DEFAULT_HALF_WIDTH,
    max_flights: int = 200_000,
    size: int = 1000,
    noise_period: float = DEFAULT_PERIOD,
    num_worst: int = 3,
    user_systems: UserSystems = UserSystems(),
    compiled: bool = True,
    pool: WorkerPool | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    progress: Callable[[int, str], None] | None = None,
) -> Risk:
    """Estimate the probability of an event by independent runs of subset simulation.

    The first six runs fly together. The spread of the finished runs then determines how many further runs fly together,
    at most six. The result does not depend on the workers, and it is the same after an interruption.

    Args:
        scenario: scenario, whose seed determines all random numbers.
        event: event, or text such as `peak_error > 0.8`.
        half_width: requested half-width of the interval, relative to the estimate. As soon as it is reached, no further
            run begins.
        max_flights: number of flights after which no further run begins.
        size: number of samples in each step of a run, a multiple of 10 and at least 500.
        noise_period: length of the periods whose noise is drawn separately, s; a multiple of the control period.
        num_worst: number of worst samples in the result.
        user_systems: functions that create the user's systems for N vehicles.
        compiled: True to compile the diagram to machine code.
        pool: workers that fly the samples; by default, one fleet in this process; see `Evaluator`.
        folder: folder for the values of all flights, with which an interrupted estimation is resumed.
        resume: True to continue an estimation that the folder already contains.
        progress: function that is called after each batch with its number of flights and a description of the state.

    Raises:
        InputError: if the scenario cannot be flown by a fleet, there are too few flights for an interval, the event is
            so rare that a run does not reach it, almost all flights have the same value of the metric, or the folder
            contains another study.
        RuntimeError: if workers cannot fly a sample.
        StudyInterrupted: if the user pressed Ctrl-C; finished batches are saved in the folder.
    """
    event = Event.parse(event, scenario) if isinstance(event, str) else event
    check_integer(size, "size", minimum=MIN_SIZE)
    if size % round(1.0 / _STEP_PROBABILITY):
        raise InputError(f"size is {size}, but must be a multiple of {round(1.0 / _STEP_PROBABILITY)}")
    # A fleet has a vehicle for each Markov chain of the runs that fly together, since each chain proposes one flight at
    # a time.
    num_vehicles = MIN_RUNS * round(_STEP_PROBABILITY * size)
    evaluator = Evaluator(
        scenario,
        num_vehicles=num_vehicles,
        noise_period=noise_period,
        user_systems=user_systems,
        compiled=compiled,
        pool=pool,
    )
    runs: list[SubsetRun] = []
    estimate: Interval | None = None
    settings = {"search": "risk", "event": event, "population": size, "noise_period": noise_period}

    def show(count: int) -> None:
        if progress is not None:
            progress(count, "" if estimate is None else f"{estimate.value:.2g} ± {relative_half_width(estimate):.0%}")

    with stored_flights(
        evaluator,
        event.performance,
        scenario,
        settings,
        max_flights=max_flights,
        user_systems=user_systems,
        compiled=compiled,
        folder=folder,
        resume=resume,
        progress=show,
    ) as flights:

        def performance(points: np.ndarray, noise: np.ndarray) -> np.ndarray:
            if estimate is None and flights.num_flights >= max_flights:
                raise InputError(
                    f"{max_flights:,} flights are enough for {len(runs)} runs, but an interval needs {MIN_RUNS}: allow"
                    " more flights, or reduce the number of samples in each step (`size`, or --population)"
                )
            return flights(scipy.special.ndtr(points), noise)

        while estimate is None or (relative_half_width(estimate) > half_width and flights.num_flights < max_flights):
            count = MIN_RUNS
            if estimate is not None:
                needed = len(runs) * ((relative_half_width(estimate) / half_width) ** 2 - 1.0)
                affordable = len(runs) * (max_flights / flights.num_flights - 1.0)
                count = min(max(math.ceil(min(needed, affordable)), 1), MIN_RUNS)
            generators = [np.random.default_rng([scenario.seed, len(runs) + number]) for number in range(count)]
            dimensions = len(evaluator.names), evaluator.num_periods
            steps = [subset_steps(*dimensions, each, size=size, fraction=_STEP_PROBABILITY) for each in generators]
            runs += run_together(performance, steps)
            _check_reached(event, runs)
            estimate = _probability(runs)
    return Risk(
        event,
        estimate,
        tuple(runs),
        _coordinates(evaluator.names, runs),
        _worst_scenarios(evaluator, runs, num_worst),
        flights.num_flights,
        relative_half_width(estimate) <= half_width,
    )


def _check_reached(event: Event, runs: Sequence[SubsetRun]) -> None:
    """Check that all runs have reached the event.

    Raises:
        InputError: if a run has not reached it, or has found the same value of the metric in almost all samples.
    """
    for run in runs:
        if run.equal_fraction:
            value = event.value(np.array([run.levels[-1]]))[0]
            raise InputError(
                f"{event.metric} is {value:.4g} in {run.equal_fraction:.1%} of the samples of a step, so it does not"
                f" show how close a flight is to {event}; choose another metric, or estimate the probability with"
                " drake-quad study"
            )
        if run.probability == 0.0:
            reached = event.value(np.array([run.history[-1][0]]))[0]
            raise InputError(
                f"{event} is too rare: a run ended without the event, at a probability below"
                f" {math.prod(run.fractions):.0e}"
                + ("" if event.metric == _CRASH else f" and {event.metric} = {reached:.4g}")
            )


def _probability(runs: Sequence[SubsetRun]) -> Interval:
    """Estimate the probability of the event from all runs; exact interval if no run has more than one step."""
    if all(len(run.levels) == 1 for run in runs):
        count, total = (sum(sizes) for sizes in zip(*((len(run.performance), run.history.size) for run in runs)))
        return proportion_interval(count, total)
    return probability_of_runs([run.probability for run in runs])


def _coordinates(names: Sequence[str], runs: Sequence[SubsetRun]) -> tuple[Coordinate, ...]:
    """Return the coordinates of the samples at which the event occurs, starting with the most important coordinate.

    The samples of a run are correlated, so the interval of each mean follows from the means of the separate runs.
    """
    means = np.stack([run.points.mean(axis=0) for run in runs])
    deviations = np.concatenate([run.points for run in runs]).std(axis=0)
    found = [Coordinate(name, mean_interval(means[:, i]), float(deviations[i])) for i, name in enumerate(names)]
    return tuple(sorted(found, key=operator.attrgetter("importance"), reverse=True))


def _worst_scenarios(evaluator: Evaluator, runs: Sequence[SubsetRun], number: int) -> tuple[Scenario, ...]:
    """Return the scenarios of the samples with the largest values of `performance`, at most one sample of each run."""
    best = [(run.performance.max(), int(run.performance.argmax()), run) for run in runs]
    best.sort(key=operator.itemgetter(0), reverse=True)
    return tuple(
        evaluator.scenario_at(scipy.special.ndtr(run.points[index]), run.noise[index])
        for _, index, run in best[:number]
    )
