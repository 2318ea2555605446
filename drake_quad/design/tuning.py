"""Tuning of a controller's parameters to the smallest error on training samples, subject to a stability limit.

All controllers are tuned with the same budget. The search is the cross-entropy method (R. Y. Rubinstein and D. P.
Kroese, "The cross-entropy method", 2004) over the logarithms of the parameters. In each round, sets of parameters
(points) are drawn from a normal distribution. Every point is simulated on all training samples, and the best quarter of
the points determines the next distribution. Evaluating the stability limit requires a linear model of the loop, which
takes as long as a thousand flights. The limit is therefore evaluated only at a few of the best points in each round,
and radial basis functions predict it for all other points. Three local searches from the best point follow. They
evaluate the limit at every step.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.linear.link_margins import fast_link_margins
from drake_quad.scenario.batch import Batch, median_scenario
from drake_quad.scenario.distributions import Choice
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import map_leaves

# Cost of a crash at the end of a flight, m. One crash in 25 flights costs as much as 4 cm of error in all of them. An
# earlier crash costs up to twice as much, so that a search makes progress where all flights crash.
_CRASH_COST = 1.0
LATENCY = "laboratory.motion_capture.latency_frames"
"""Path of the field with the camera latency, in frames."""
_ELITE_FRACTION = 0.25  # fraction of the points, those with the smallest cost, that determine the next distribution
_DISTRIBUTION_STEP = 0.7  # step from the present distribution towards the distribution of the elite, from 0 to 1
_MIN_DEVIATION = 0.01  # smallest standard deviation of a parameter's logarithm, against premature convergence
# Number of candidates for which the first round evaluates the limits, relative to this number in later rounds.
_FIRST_CHECKS_FACTOR = 4
# Weight of the logarithm of the violated margin ratio, relative to the logarithm of the error.
_PENALTY_WEIGHT = 4.0
# Assumed error of a predicted logarithm of a margin ratio in the first round, divided by the distance from the nearest
# point at which the ratio was evaluated. Distances are relative to the widths of the parameter ranges.
_INITIAL_UNCERTAINTY = 0.5
# Smallest logarithm of a margin ratio without a penalty. At the limit, the logarithm is 0. The reserve allows for
# errors of predicted ratios.
_LIMIT_RESERVE = 0.002
# Initial step of each local search, relative to the width of a parameter's range.
_LOCAL_STEPS = (0.15, 0.08, 0.04)
# Ratios from `margin_ratios` are clipped to this range before they are interpolated.
_MARGIN_RATIO_RANGE = (0.2, 1.5)


class TuningParameter(NamedTuple):
    """Parameter that is tuned within a range.

    Attributes:
        paths: paths of the fields that are set to this parameter, such as `control.position.k_p.0`.
        low: smallest value that is tried; it must be positive.
        high: largest value that is tried.
    """

    paths: tuple[str, ...]
    low: float
    high: float

    @property
    def vertical(self) -> bool:
        """True if the parameter belongs to the vertical axis, so that all paths end with the index 2."""
        return all(path.endswith(".2") for path in self.paths)


class Budget(NamedTuple):
    """Budget for the tuning of each controller.

    Attributes:
        rounds: number of rounds of the search.
        candidates: number of candidates that are simulated in each round.
        samples: number of samples for each candidate, in all laboratories together.
        limit_evaluations: number of evaluations of the limit in each round.
        local_search_steps: number of steps in each of the three local searches that follow the rounds.
    """

    rounds: int = 12
    candidates: int = 128
    samples: int = 16
    limit_evaluations: int = 6
    local_search_steps: int = 80


class LoopLimit(NamedTuple):
    """Limits on the loops of a control, broken at the command link.

    Attributes:
        sensitivity: largest peak of |1 / (1 + L)|.
        delay: smallest delay margin, s.
    """

    sensitivity: float = 2.2
    delay: float = 0.05

    def margin_ratios(self, scenario: Scenario) -> np.ndarray:
        """Return how well the loops of a scenario meet the limits, as ratios; a single 0 if a loop is unstable.

        Each ratio compares a margin with its limit. A ratio of 1 or more means that the limit is met. Distributions are
        replaced by their medians.
        """
        try:
            margins = fast_link_margins(median_scenario(scenario))
        except InputError:
            return np.zeros(1)
        return np.concatenate([self.sensitivity / margins.sensitivity, margins.delay / self.delay])


class TuningResult(NamedTuple):
    """Result of a tuning.

    Attributes:
        values: tuned values, in the order of the parameters.
        error: mean RMSE on the training samples, m. A crash counts as an RMSE of 1 to 2 m.
        min_margin_ratio: smallest ratio of a margin to its limit; 1 or more if all limits are met, infinite without
            limits.
    """

    values: tuple[float, ...]
    error: float
    min_margin_ratio: float


def tune(
    scenarios: Sequence[Scenario],
    parameters: Sequence[TuningParameter],
    margin_ratios: Callable[[Scenario], np.ndarray] | None,
    *,
    budget: Budget = Budget(),
    first_sample: int = 0,
    seed: int = 0,
    extra_latency: float = 0.0,
    before: Sequence[float] | None = None,
    progress: Callable[[], None] | None = None,
) -> TuningResult:
    """Tune the parameters of a controller: first for the lateral axes, then for the vertical axis.

    The two stages are almost independent. Each stage gets a number of rounds in proportion to its number of parameters.
    During the first stage, each vertical parameter is held at the geometric mean of its range.

    Args:
        scenarios: laboratories with the controller, whose present parameters are ignored. The limit is evaluated in the
            first laboratory.
        parameters: parameters to tune, with their ranges.
        margin_ratios: function that returns how well the loops of a scenario meet the limits, such as
            `LoopLimit.margin_ratios`; None without a limit.
        budget: budget of the search.
        first_sample: first of the consecutive training samples.
        seed: seed of the search.
        extra_latency: additional camera latency, s. If it is not 0, each candidate also flies all samples with this
            latency, and the crashes of these flights count. This replaces the limit for controllers that have no linear
            model.
        before: parameters from an earlier search, an additional starting point of the local searches. Parameters that
            are out of range are clipped.
        progress: function that is called after each round.

    Returns:
        The candidate with the smallest error of all that meet the limit; if none does, the candidate that comes closest
        to meeting it.
    """
    numbers = [math.sqrt(parameter.low * parameter.high) for parameter in parameters]
    best = TuningResult((), math.inf, 0.0)
    for stage in filter(
        None,
        ([i for i, parameter in enumerate(parameters) if parameter.vertical is vertical] for vertical in (False, True)),
    ):
        rounds = max(round(budget.rounds * len(stage) / len(parameters)), 1)
        search = _GainSearch(
            [parameters[i] for i in stage], budget._replace(rounds=rounds), first_sample, seed, extra_latency
        )
        best = search.run(
            [with_parameter_values(each, parameters, numbers) for each in scenarios], margin_ratios, progress
        )
        for i, number in zip(stage, best.values, strict=True):
            numbers[i] = number
    best = best._replace(values=tuple(numbers))
    trial = _Trial(scenarios, parameters, budget._replace(candidates=1), first_sample, extra_latency)
    starts = [best]
    if before is not None:
        point = np.clip(trial.point(before), 0.0, 1.0)
        min_ratio = math.inf if margin_ratios is None else float(margin_ratios(trial.scenario(point)).min())
        starts.append(TuningResult(trial.values(point), float(trial.errors(point[np.newaxis])[0]), min_ratio))
    for radius in _LOCAL_STEPS:
        starts = [
            _better(start, _local_search(trial, start, margin_ratios, radius, budget.local_search_steps))
            for start in starts
        ]
        if progress is not None:
            progress()
    return functools.reduce(_better, starts)


def _local_search(
    trial: "_Trial",
    start: TuningResult,
    margin_ratios: Callable[[Scenario], np.ndarray] | None,
    radius: float,
    steps: int,
) -> TuningResult:
    """Return the best point of a local search by COBYLA, which uses linear models (M. J. D. Powell, 1994)."""
    tried: dict[bytes, tuple[float, np.ndarray]] = {}
    best, first_point = start, trial.point(start.values)
    unlimited = np.array([math.inf])

    def evaluate(point: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the logarithms of the error and of the ratios from `margin_ratios`."""
        nonlocal best
        point = np.clip(point, 0.0, 1.0)
        if point.tobytes() not in tried:
            error = float(trial.errors(point[np.newaxis])[0])
            ratios = unlimited if margin_ratios is None else margin_ratios(trial.scenario(point))
            best = _better(best, TuningResult(trial.values(point), error, float(ratios.min())))
            tried[point.tobytes()] = math.log(error), _clipped_logarithms(ratios, max(count, len(ratios)))
        return tried[point.tobytes()]

    count = 0
    count = len(evaluate(first_point)[1])
    scipy.optimize.minimize(
        lambda point: evaluate(point)[0],
        first_point,
        method="COBYLA",
        constraints={"type": "ineq", "fun": lambda point: evaluate(point)[1] - _LIMIT_RESERVE},
        options={"rhobeg": radius, "tol": 1e-3, "maxiter": max(steps, len(first_point) + 2)},
    )
    return best


class _GainSearch(NamedTuple):
    """Search by the cross-entropy method for several parameters at once."""

    parameters: Sequence[TuningParameter]
    budget: Budget
    first_sample: int
    seed: int
    extra_latency: float

    def run(
        self,
        scenarios: Sequence[Scenario],
        margin_ratios: Callable[[Scenario], np.ndarray] | None,
        progress: Callable[[], None] | None,
    ) -> TuningResult:
        """Return the best candidate; the arguments are as in `tune`."""
        count, size = len(self.parameters), self.budget.candidates
        trial = _Trial(scenarios, self.parameters, self.budget, self.first_sample, self.extra_latency)
        # Each coordinate of a point is 0 and 1 at the ends of a parameter's range.
        points = scipy.stats.qmc.Sobol(count, seed=self.seed).random(2 ** math.ceil(math.log2(size)))[:size]
        generator = np.random.default_rng(self.seed)
        evaluated, mean, spread = _EvaluatedPoints(count), np.full(count, 0.5), np.eye(count) / 12.0
        best = TuningResult((), math.inf, 0.0)
        for number in range(self.budget.rounds):
            errors = trial.errors(points)
            uncertainty = _INITIAL_UNCERTAINTY * (1.0 - number / self.budget.rounds)
            order = np.argsort(np.log(errors) + evaluated.penalties(points, uncertainty))
            if margin_ratios is None:
                best = _better(best, TuningResult(trial.values(points[order[0]]), float(errors[order[0]]), math.inf))
            else:
                for i in order[: self.budget.limit_evaluations * (_FIRST_CHECKS_FACTOR if number == 0 else 1)]:
                    ratios = margin_ratios(trial.scenario(points[i]))
                    evaluated.add(points[i], ratios)
                    best = _better(best, TuningResult(trial.values(points[i]), float(errors[i]), float(ratios.min())))
                order = np.argsort(np.log(errors) + evaluated.penalties(points, uncertainty))
            elite = points[order[: max(round(_ELITE_FRACTION * size), 2)]]
            mean = mean + _DISTRIBUTION_STEP * (elite.mean(axis=0) - mean)
            spread = spread + _DISTRIBUTION_STEP * (np.cov(elite.T, ddof=0).reshape(spread.shape) - spread)
            points = np.clip(
                generator.multivariate_normal(mean, spread + np.diag(trial.min_deviation**2), size), 0.0, 1.0
            )
            if progress is not None:
                progress()
        return best


class _Trial:
    """Simulation of candidates, which are points whose coordinates are 0 and 1 at the ends of the parameter ranges."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        parameters: Sequence[TuningParameter],
        budget: Budget,
        first_sample: int,
        extra_latency: float,
    ) -> None:
        self._scenarios, self._parameters = scenarios, parameters
        self._samples = _training_samples(budget, len(scenarios), first_sample)
        size = budget.candidates * len(self._samples)
        self._fleets = [StudyFleet(each, plan_route(each), size) for each in scenarios]
        self._late_fleets = [
            StudyFleet(with_extra_latency(each, extra_latency), plan_route(each), size)
            for each in scenarios
            if extra_latency
        ]
        self._low, high = np.log([[parameter.low, parameter.high] for parameter in parameters]).T
        self._width = high - self._low
        self.min_deviation = _MIN_DEVIATION / self._width

    def values(self, point: np.ndarray) -> tuple[float, ...]:
        """Return the values of the tuned parameters at a point of the search space."""
        return tuple(np.exp(self._low + self._width * point).tolist())

    def point(self, numbers: Sequence[float]) -> np.ndarray:
        """Return the point of the search space at which the tuned parameters have given values."""
        return (np.log(numbers) - self._low) / self._width

    def scenario(self, point: np.ndarray) -> Scenario:
        """Return the first training scenario with the parameter values of a point."""
        return with_parameter_values(self._scenarios[0], self._parameters, self.values(point))

    def errors(self, points: np.ndarray) -> np.ndarray:
        """Return the mean error (count,) over all training samples of the candidate at each point, m."""
        columns = np.repeat(np.exp(self._low + self._width * points), len(self._samples), axis=0).T
        varying = {
            path: column
            for parameter, column in zip(self._parameters, columns, strict=True)
            for path in parameter.paths
        }
        errors = [_errors(*self._flights(fleet, varying, len(points))) for fleet in self._fleets]
        late = [_crash_costs(*self._flights(fleet, varying, len(points))) for fleet in self._late_fleets]
        return np.asarray(np.mean(errors, axis=0) + sum(late, np.zeros(len(points))) / len(errors))

    def _flights(self, fleet: StudyFleet, varying: dict[str, np.ndarray], count: int) -> tuple[Metrics, float, int]:
        """Fly several candidates, and return the metrics, the planned duration (s), and the number of candidates."""
        batch = Batch.draw(fleet.scenario, [*self._samples] * count).with_varying(varying)
        return fleet.fly_batch(batch), fleet.duration, count


def tolerated_delay(
    scenarios: Sequence[Scenario], max_latency: float, *, budget: Budget = Budget(), first_sample: int = 0
) -> float:
    """Return the largest additional camera latency at which no training flight crashes, s.

    The result is a multiple of the frame period; 0 if a flight crashes at each latency that is tried.

    Args:
        scenarios: laboratories with the controller.
        max_latency: largest latency that is tried, s.
        budget: budget, which determines the number of training samples.
        first_sample: index of the first training sample.
    """
    samples = _training_samples(budget, len(scenarios), first_sample)
    frame = scenarios[0].laboratory.motion_capture.period

    def crash(extra_latency: float) -> bool:
        fleets = (
            StudyFleet(with_extra_latency(each, extra_latency), plan_route(each), len(samples)) for each in scenarios
        )
        return any(fleet.fly(samples).crashed.any() for fleet in fleets)

    return next(
        (frames * frame for frames in range(round(max_latency / frame), 0, -1) if not crash(frames * frame)), 0.0
    )


def _training_samples(budget: Budget, laboratories: int, first: int) -> range:
    """Return the indices of the training samples that are flown in each laboratory."""
    return range(first, first + max(budget.samples // laboratories, 1))


def with_extra_latency(scenario: Scenario, extra_latency: float) -> Scenario:
    """Return the scenario with additional camera latency (s), rounded to whole frames."""
    cameras = scenario.laboratory.motion_capture
    frames = float(round(extra_latency / cameras.period))

    def with_added_frames(path: str, value: Any) -> Any:
        if path != LATENCY:
            return value
        return (
            Choice(choice=tuple(each + frames for each in value.choice))
            if isinstance(value, Choice)
            else value + frames
        )

    return map_leaves(scenario, with_added_frames)


def with_parameter_values(
    scenario: Scenario, parameters: Sequence[TuningParameter], numbers: Sequence[float]
) -> Scenario:
    """Return the scenario with given parameter values."""
    values = {path: value for parameter, value in zip(parameters, numbers, strict=True) for path in parameter.paths}
    return map_leaves(scenario, lambda path, value: values.get(path, value))


def _errors(metrics: Metrics, duration: float, count: int) -> np.ndarray:
    """Return the mean error of each candidate, (count,), m, including the costs of crashes."""
    tracking_errors = np.where(metrics.crashed, 0.0, metrics.rmse).reshape(count, -1).mean(axis=1)
    return np.asarray(tracking_errors + _crash_costs(metrics, duration, count))


def _crash_costs(metrics: Metrics, duration: float, count: int) -> np.ndarray:
    """Return the mean crash cost of each candidate, (count,), m."""
    remaining_fraction = 1.0 - np.minimum(metrics.crash_time, duration) / duration
    costs = np.where(metrics.crashed, _CRASH_COST * (1.0 + remaining_fraction), 0.0)
    return np.asarray(costs.reshape(count, -1).mean(axis=1))


class _EvaluatedPoints:
    """Points at which a search has evaluated the limits, with the ratios from `margin_ratios`."""

    def __init__(self, dimensions: int) -> None:
        self._dimensions = dimensions
        self._points: list[np.ndarray] = []
        self._ratios: list[np.ndarray] = []

    def add(self, point: np.ndarray, ratios: np.ndarray) -> None:
        """Add a point at which the limits have been evaluated, with the ratios from `margin_ratios`."""
        self._points.append(point)
        self._ratios.append(ratios)

    def penalties(self, points: np.ndarray, uncertainty: float) -> np.ndarray:
        """Return penalties (count,) on the logarithm of the error, positive where the limits are probably violated.

        The penalty decreases with the distance from evaluated points, so that the search also explores unknown regions.

        Args:
            points: (count, dimensions) points; each coordinate is 0 and 1 at the ends of a parameter's range.
            uncertainty: assumed error of the predicted logarithm, per distance from the nearest evaluated point.
        """
        # A plane through `dimensions` + 1 points fits them exactly, so predictions need at least one more point.
        if len(self._points) <= self._dimensions + 1:
            return np.zeros(len(points))
        count = max(map(len, self._ratios))
        ratios = [_clipped_logarithms(each, count) for each in self._ratios]
        predicted = scipy.interpolate.RBFInterpolator(self._points, ratios, smoothing=1e-4)(points).min(axis=1)
        distance = scipy.spatial.distance.cdist(points, self._points).min(axis=1)
        return np.asarray(_PENALTY_WEIGHT * np.maximum(_LIMIT_RESERVE - predicted - uncertainty * distance, 0.0))


def _clipped_logarithms(ratios: np.ndarray, count: int) -> np.ndarray:
    """Return the logarithms (count,) of clipped ratios from `margin_ratios`.

    For an unstable loop, `margin_ratios` returns a single 0 instead of `count` ratios. This value is then used for all
    limits. The ratios are clipped because they are discontinuous far from the limits, where the search does not need
    exact values.
    """
    return np.log(np.clip(np.broadcast_to(ratios, count), *_MARGIN_RATIO_RANGE))


def _better(first: TuningResult, second: TuningResult) -> TuningResult:
    """Return the candidate with the smaller error if both meet the limits, or else the one closer to the limits."""
    return min(first, second, key=lambda each: (-min(each.min_margin_ratio, 1.0), each.error))
