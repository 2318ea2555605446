"""Numbers of a controller, chosen by one protocol: least error on training samples, under a limit on the loop.

Every controller gets the same budget. It is the cross-entropy method (R. Y. Rubinstein and D. P. Kroese, "The
cross-entropy method", 2004) over the logarithms of the numbers: in each round points of a normal distribution are flown
by one fleet on the training samples, and the best fourth of them are what the next distribution is made of. A linear
model takes as long as a thousand flights, and so the limit is looked at for a few of the best of each round, and told
for the others by radial basis functions through all that have been looked at. Three local searches from the best
follow, which look at the limit at every step.
"""

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
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.distributions import Choice
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import replaced

# Cost of a flight that ends in a crash, m: one crash in 25 flights costs as much as 4 cm of error in all of them.
# An early crash costs up to twice as much, so that a search finds its way where all flights crash.
_CRASH = 1.0
LATENCY = "laboratory.motion_capture.latency_frames"
# Share of the points that make the next distribution, and the part of the way there that is gone; least deviation of
# each number, in logarithms, against an early end; by how much more often the limit is looked at in the first round.
_ELITE, _STEP, _LEAST, _FIRST = 0.25, 0.7, 0.01, 4
# Penalty on the logarithm of the error, relative to the logarithm by which the limit is missed.
_PENALTY = 4.0
# How much better the limit may be kept than told, in logarithms, a width of the box away from what has been looked at,
# at the beginning; what is kept from the limit, since what is told is not exact.
_DOUBT, _RESERVE = 0.5, 0.002
# First steps of the local searches, in widths of the box.
_RADII = 0.15, 0.08, 0.04
# Smallest and largest share of the limit that the search distinguishes.
_ENDS = 0.2, 1.5


class Knob(NamedTuple):
    """A number that is tuned.

    Attributes:
        paths: of the fields that have it, such as `control.position.k_p.0`.
        low: the least that is tried, larger than zero.
        high: the largest that is tried.
    """

    paths: tuple[str, ...]
    low: float
    high: float

    @property
    def vertical(self) -> bool:
        """True if the number belongs to the vertical axis, the third of three."""
        return all(path.endswith(".2") for path in self.paths)


class Budget(NamedTuple):
    """Budget for the tuning of each controller.

    Attributes:
        rounds: of the search.
        candidates: flown in each round.
        samples: on which each of them is flown, in all laboratories together.
        checks: of the limit in each round.
        steps: of each of three local searches, from the best of all rounds.
    """

    rounds: int = 12
    candidates: int = 128
    samples: int = 16
    checks: int = 6
    steps: int = 80


class LoopLimit(NamedTuple):
    """Limits on the loops of a control, broken at the command link.

    Attributes:
        sensitivity: largest peak of |1 / (1 + L)|.
        delay: least delay margin, s.
    """

    sensitivity: float = 2.2
    delay: float = 0.05

    def shares_met(self, scenario: Scenario) -> np.ndarray:
        """The shares of the limit that the loops of a scenario meet; 1 or more where it is kept, all 0 if unstable."""
        try:
            found = fast_link_margins(scenario)
        except InputError:
            return np.zeros(1)
        return np.concatenate([self.sensitivity / found.sensitivity, found.delay / self.delay])


class Tuned(NamedTuple):
    """Result of a tuning.

    Attributes:
        numbers: of the knobs, in their order.
        error: mean RMSE on the training samples, with 1 to 2 m for each that crashed, m.
        share: of the limit that is met; 1 or more if it is kept, infinite if there is none.
    """

    numbers: tuple[float, ...]
    error: float
    share: float


def tune(
    scenarios: Sequence[Scenario],
    knobs: Sequence[Knob],
    shares_met: Callable[[Scenario], np.ndarray] | None,
    *,
    budget: Budget = Budget(),
    first_sample: int = 0,
    seed: int = 0,
    later: float = 0.0,
    before: Sequence[float] | None = None,
    progress: Callable[[], None] | None = None,
) -> Tuned:
    """Tune the numbers of a controller: those of the lateral axes first, then those of the vertical one.

    The two hardly touch each other, and the rounds are shared out by how many numbers each has. The vertical numbers
    wait in the middle of their ranges.

    Args:
        scenarios: laboratories with the controller, whose own numbers do not matter; the limit is that of the first.
        knobs: that are turned.
        shares_met: the shares of the limit that the loops of a scenario meet, as those of `LoopLimit`; None if there is
            no limit.
        budget: of the search.
        first_sample: of the training samples, which follow each other.
        seed: of the search.
        later: by how much later frames come in as many flights again, of which only crashes count, s: the limit of what
            has no linear model.
        before: numbers that an earlier search found, one more candidate for the local searches; those out of range are
            brought to its ends.
        progress: called after each round.

    Returns:
        The candidate of least error among those that keep the limit; if none does, the one that meets most of it.
    """
    numbers = [math.sqrt(knob.low * knob.high) for knob in knobs]
    found = Tuned((), math.inf, 0.0)
    for stage in filter(None, ([i for i, knob in enumerate(knobs) if knob.vertical is way] for way in (False, True))):
        rounds = max(round(budget.rounds * len(stage) / len(knobs)), 1)
        search = _GainSearch([knobs[i] for i in stage], budget._replace(rounds=rounds), first_sample, seed, later)
        found = search.run([with_numbers(each, knobs, numbers) for each in scenarios], shares_met, progress)
        for i, number in zip(stage, found.numbers, strict=True):
            numbers[i] = number
    found = found._replace(numbers=tuple(numbers))
    trial = _Trial(scenarios, knobs, budget._replace(candidates=1), first_sample, later)
    if before is not None:
        point = np.clip(trial.point(before), 0.0, 1.0)
        share = math.inf if shares_met is None else float(shares_met(trial.scenario(point)).min())
        found = _better(found, Tuned(trial.numbers(point), float(trial.errors(point[np.newaxis])[0]), share))
    for radius in _RADII:
        found = _better(found, _local_search(trial, found, shares_met, radius, budget.steps))
        if progress is not None:
            progress()
    return found


def _local_search(
    trial: "_Trial", start: Tuned, shares_met: Callable[[Scenario], np.ndarray] | None, radius: float, steps: int
) -> Tuned:
    """The best of a search with linear models of the error and of the shares (M. J. D. Powell's COBYLA, 1994)."""
    tried: dict[bytes, tuple[float, np.ndarray]] = {}
    best, first = start, trial.point(start.numbers)
    unlimited = np.array([math.inf])

    def looked_at(point: np.ndarray) -> tuple[float, np.ndarray]:
        """Logarithms of the error and of the shares."""
        nonlocal best
        point = np.clip(point, 0.0, 1.0)
        if point.tobytes() not in tried:
            error = float(trial.errors(point[np.newaxis])[0])
            shares = unlimited if shares_met is None else shares_met(trial.scenario(point))
            best = _better(best, Tuned(trial.numbers(point), error, float(shares.min())))
            tried[point.tobytes()] = math.log(error), _near_limit(shares, max(count, len(shares)))
        return tried[point.tobytes()]

    count = 0
    count = len(looked_at(first)[1])
    scipy.optimize.minimize(
        lambda point: looked_at(point)[0],
        first,
        method="COBYLA",
        constraints={"type": "ineq", "fun": lambda point: looked_at(point)[1] - _RESERVE},
        options={"rhobeg": radius, "tol": 1e-3, "maxiter": max(steps, len(first) + 2)},
    )
    return best


class _GainSearch(NamedTuple):
    """The search for some numbers, all at once."""

    knobs: Sequence[Knob]
    budget: Budget
    first_sample: int
    seed: int
    later: float

    def run(
        self,
        scenarios: Sequence[Scenario],
        shares_met: Callable[[Scenario], np.ndarray] | None,
        progress: Callable[[], None] | None,
    ) -> Tuned:
        """Return the best that is found; arguments as for `tune`."""
        count, size = len(self.knobs), self.budget.candidates
        trial = _Trial(scenarios, self.knobs, self.budget, self.first_sample, self.later)
        # Coordinates are relative to the box, from 0 to 1.
        points = scipy.stats.qmc.Sobol(count, seed=self.seed).random(2 ** math.ceil(math.log2(size)))[:size]
        normal = np.random.default_rng(self.seed)
        known, mean, spread = _Known(count), np.full(count, 0.5), np.eye(count) / 12.0
        best = Tuned((), math.inf, 0.0)
        for number in range(self.budget.rounds):
            errors = trial.errors(points)
            doubt = _DOUBT * (1.0 - number / self.budget.rounds)
            order = np.argsort(np.log(errors) + known.penalties(points, doubt))
            if shares_met is None:
                best = _better(best, Tuned(trial.numbers(points[order[0]]), float(errors[order[0]]), math.inf))
            else:
                for i in order[: self.budget.checks * (_FIRST if number == 0 else 1)]:
                    shares = shares_met(trial.scenario(points[i]))
                    known.add(points[i], shares)
                    best = _better(best, Tuned(trial.numbers(points[i]), float(errors[i]), float(shares.min())))
                order = np.argsort(np.log(errors) + known.penalties(points, doubt))
            elite = points[order[: max(round(_ELITE * size), 2)]]
            mean = mean + _STEP * (elite.mean(axis=0) - mean)
            spread = spread + _STEP * (np.cov(elite.T, ddof=0).reshape(spread.shape) - spread)
            points = np.clip(normal.multivariate_normal(mean, spread + np.diag(trial.least**2), size), 0.0, 1.0)
            if progress is not None:
                progress()
        return best


class _Trial:
    """Candidates, as points of the box of all knobs, and the fleets that fly them."""

    def __init__(
        self, scenarios: Sequence[Scenario], knobs: Sequence[Knob], budget: Budget, first_sample: int, later: float
    ) -> None:
        self._scenarios, self._knobs = scenarios, knobs
        self._samples = _training_samples(budget, len(scenarios), first_sample)
        size = budget.candidates * len(self._samples)
        self._fleets = [StudyFleet(each, plan_route(each), size) for each in scenarios]
        self._late_fleets = [
            StudyFleet(with_later_frames(each, later), plan_route(each), size) for each in scenarios if later
        ]
        self._low, high = np.log([[knob.low, knob.high] for knob in knobs]).T
        self._width = high - self._low
        self.least = _LEAST / self._width

    def numbers(self, point: np.ndarray) -> tuple[float, ...]:
        """Return the numbers of the knobs at a point."""
        return tuple(np.exp(self._low + self._width * point).tolist())

    def point(self, numbers: Sequence[float]) -> np.ndarray:
        """Return the point at which the knobs have these numbers."""
        return (np.log(numbers) - self._low) / self._width

    def scenario(self, point: np.ndarray) -> Scenario:
        """Return the first scenario with the numbers of a point."""
        return with_numbers(self._scenarios[0], self._knobs, self.numbers(point))

    def errors(self, points: np.ndarray) -> np.ndarray:
        """(count,) mean errors at points, m."""
        columns = np.repeat(np.exp(self._low + self._width * points), len(self._samples), axis=0).T
        varying = {path: column for knob, column in zip(self._knobs, columns, strict=True) for path in knob.paths}
        found = [_errors(*self._flown(fleet, varying, len(points))) for fleet in self._fleets]
        late = [_crashes(*self._flown(fleet, varying, len(points))) for fleet in self._late_fleets]
        return np.asarray(np.mean(found, axis=0) + sum(late, np.zeros(len(points))) / len(found))

    def _flown(self, fleet: StudyFleet, varying: dict[str, np.ndarray], count: int) -> tuple[Metrics, float, int]:
        """Return the flights of some candidates, how long they were to last, and the number of candidates."""
        batch = Batch.draw(fleet.scenario, [*self._samples] * count).with_varying(varying)
        return fleet.fly_batch(batch), fleet.duration, count


def delay_stood(
    scenarios: Sequence[Scenario], most: float, *, budget: Budget = Budget(), first_sample: int = 0
) -> float:
    """Return the largest additional latency of the cameras for which no training flight crashes, s, in whole frames.

    Args:
        scenarios: laboratories with the controller.
        most: that is looked at, s.
        budget: with the number of training flights.
        first_sample: of the training samples.
    """
    samples = _training_samples(budget, len(scenarios), first_sample)
    frame = scenarios[0].laboratory.motion_capture.period

    def crash(later: float) -> bool:
        fleets = (StudyFleet(with_later_frames(each, later), plan_route(each), len(samples)) for each in scenarios)
        return any(fleet.fly(samples).crashed.any() for fleet in fleets)

    return next((frames * frame for frames in range(round(most / frame), 0, -1) if not crash(frames * frame)), 0.0)


def _training_samples(budget: Budget, laboratories: int, first: int) -> range:
    """Return the samples that are flown in each laboratory."""
    return range(first, first + max(budget.samples // laboratories, 1))


def with_later_frames(scenario: Scenario, later: float) -> Scenario:
    """Return the scenario with camera frames delayed by a further time (s), rounded to whole frames."""
    cameras = scenario.laboratory.motion_capture
    frames = float(round(later / cameras.period))

    def added(path: str, value: Any) -> Any:
        if path != LATENCY:
            return value
        return (
            Choice(choice=tuple(each + frames for each in value.choice))
            if isinstance(value, Choice)
            else value + frames
        )

    return replaced(scenario, added)


def with_numbers(scenario: Scenario, knobs: Sequence[Knob], numbers: Sequence[float]) -> Scenario:
    """Return the scenario with the numbers of knobs."""
    values = {path: value for knob, value in zip(knobs, numbers, strict=True) for path in knob.paths}
    return replaced(scenario, lambda path, value: values.get(path, value))


def _errors(metrics: Metrics, duration: float, count: int) -> np.ndarray:
    """(count,) mean errors of candidates, m."""
    flown = np.where(metrics.crashed, 0.0, metrics.rmse).reshape(count, -1).mean(axis=1)
    return np.asarray(flown + _crashes(metrics, duration, count))


def _crashes(metrics: Metrics, duration: float, count: int) -> np.ndarray:
    """(count,) means of what candidates are charged for crashes, m."""
    left = 1.0 - np.minimum(metrics.crash_time, duration) / duration
    charged = np.where(metrics.crashed, _CRASH * (1.0 + left), 0.0)
    return np.asarray(charged.reshape(count, -1).mean(axis=1))


class _Known:
    """Evaluated points of a search, with the shares of the limit that are met at each."""

    def __init__(self, dimensions: int) -> None:
        self._dimensions = dimensions
        self._points: list[np.ndarray] = []
        self._shares: list[np.ndarray] = []

    def add(self, point: np.ndarray, shares: np.ndarray) -> None:
        """Add a point that has been looked at."""
        self._points.append(point)
        self._shares.append(shares)

    def penalties(self, points: np.ndarray, doubt: float) -> np.ndarray:
        """(count,) penalties on the logarithm of the error, for what is told to break the limit.

        What is far from all that has been looked at is given the benefit of the doubt, or nobody would ever look there.

        Args:
            points: (count, dimensions).
            doubt: how much better the limit may be kept than told, in logarithms, a width of the box away.
        """
        # The interpolation needs as many points as determine a plane.
        if len(self._points) <= self._dimensions + 1:
            return np.zeros(len(points))
        count = max(map(len, self._shares))
        shares = [_near_limit(each, count) for each in self._shares]
        told = scipy.interpolate.RBFInterpolator(self._points, shares, smoothing=1e-4)(points).min(axis=1)
        far = scipy.spatial.distance.cdist(points, self._points).min(axis=1)
        return np.asarray(_PENALTY * np.maximum(_RESERVE - told - doubt * far, 0.0))


def _near_limit(shares: np.ndarray, count: int) -> np.ndarray:
    """(count,) logarithms of shares of the limit, of which one alone stands for an unstable loop.

    Far from the limit shares jump, with a crossing of a loop or with its stability, and need not be known.
    """
    return np.log(np.clip(np.broadcast_to(shares, count), *_ENDS))


def _better(first: Tuned, second: Tuned) -> Tuned:
    """Return the least error of those that keep the limit; of none, what meets most of it."""
    return min(first, second, key=lambda each: (-min(each.share, 1.0), each.error))
