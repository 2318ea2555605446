"""Numbers of a controller, chosen by one protocol: least error on training samples, under a limit on the loop.

Every controller gets the same budget. In each round points of a Sobol sequence fill a box of the logarithms of its
numbers, a fleet flies them all on the training samples, and the best that keeps the limit is the middle of the next,
smaller box. The limit is looked at from the best downwards, since a linear model takes longer than a flight.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.analysis.link_margins import link_margins
from drake_quad.errors import InputError
from drake_quad.flight import StudyFleet
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario import Batch, Scenario
from drake_quad.scenario.paths import replaced, value_at

# What a flight that ends in a crash is charged with, m: so that of 25 flights one crash costs as much as 4 cm in all.
_CRASH = 1.0
# By which the box gets smaller from round to round.
_SHRINK = 0.4


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


class Budget(NamedTuple):
    """What each controller's tuning may cost.

    Attributes:
        rounds: of the search.
        candidates: flown in each round, a power of two.
        samples: on which each of them is flown.
    """

    rounds: int = 4
    candidates: int = 128
    samples: int = 8


class LoopLimit(NamedTuple):
    """What the loops of a control must keep where its commands go over the link.

    Attributes:
        sensitivity: largest peak of |1 / (1 + L)|.
        delay: least delay margin, s.
    """

    sensitivity: float = 2.2
    delay: float = 0.05

    def share_met(self, scenario: Scenario) -> float:
        """The least share of the limit that a loop of a scenario meets; 1 or more if all keep it, 0 if unstable."""
        try:
            found = [margins for margins in link_margins(scenario).values() if margins is not None]
        except InputError:
            return 0.0
        return min(
            (min(self.sensitivity / each.sensitivity, each.delay / self.delay) for each in found), default=math.inf
        )


class Tuned(NamedTuple):
    """What a tuning found.

    Attributes:
        scenario: with the numbers.
        numbers: of the knobs, in their order.
        error: mean RMSE on the training samples, with 1 m for each that crashed, m.
        share: of the limit that is met; 1 or more if it is kept.
    """

    scenario: Scenario
    numbers: tuple[float, ...]
    error: float
    share: float


def tune(
    scenario: Scenario,
    knobs: Sequence[Knob],
    share_met: Callable[[Scenario], float],
    *,
    budget: Budget = Budget(),
    first_sample: int = 0,
    seed: int = 0,
) -> Tuned:
    """Tunes the numbers of a scenario's controller.

    Args:
        scenario: the laboratory with the controller, whose own numbers are tried, too.
        knobs: that are turned.
        share_met: the share of the limit that a scenario's loop meets; 1 or more if it keeps it.
        budget: of the search.
        first_sample: of the training samples, which follow each other.
        seed: of the Sobol sequence.

    Returns:
        The candidate of least error among those that keep the limit; if none does, the one that meets most of it.
    """
    samples = range(first_sample, first_sample + budget.samples)
    fleet = StudyFleet(scenario, (budget.candidates + 1) * budget.samples)
    sequence = scipy.stats.qmc.Sobol(len(knobs), seed=seed)
    low, high = np.log([[knob.low, knob.high] for knob in knobs]).T
    best = _at(scenario, knobs, _numbers_of(scenario, knobs), np.inf, share_met)
    for number in range(budget.rounds):
        half = 0.5 * _SHRINK**number * (high - low)
        middle = np.clip(0.5 * (low + high) if number == 0 else np.log(best.numbers), low + half, high - half)
        points = middle + half * (2.0 * sequence.random(budget.candidates) - 1.0)
        candidates = np.vstack([best.numbers, np.exp(points)])
        errors = _errors(fleet.fly_batch(_batch(scenario, knobs, candidates, samples)), len(candidates))
        found = (_at(scenario, knobs, candidates[i], errors[i], share_met) for i in np.argsort(errors))
        best = _better([best._replace(error=float(errors[0])), *_until_kept(found)])
    return best


def _numbers_of(scenario: Scenario, knobs: Sequence[Knob]) -> np.ndarray:
    """The numbers that a scenario has."""
    return np.array([value_at(scenario, knob.paths[0]) for knob in knobs], dtype=float)


def _batch(scenario: Scenario, knobs: Sequence[Knob], candidates: np.ndarray, samples: Sequence[int]) -> Batch:
    """Each candidate on all samples, one candidate after another."""
    columns = np.repeat(candidates, len(samples), axis=0).T
    varying = {path: column for knob, column in zip(knobs, columns, strict=True) for path in knob.paths}
    return Batch.draw(scenario, [*samples] * len(candidates)).with_varying(varying)


def _errors(metrics: Metrics, count: int) -> np.ndarray:
    """(count,) mean errors of candidates, m."""
    errors = np.where(np.asarray(metrics.crashed) > 0.0, _CRASH, np.asarray(metrics.rmse))
    return np.asarray(errors.reshape(count, -1).mean(axis=1))


def _at(
    scenario: Scenario, knobs: Sequence[Knob], numbers: np.ndarray, error: float, share_met: Callable[[Scenario], float]
) -> Tuned:
    values = {path: float(value) for knob, value in zip(knobs, numbers, strict=True) for path in knob.paths}
    tuned: Scenario = replaced(scenario, lambda path, value: values.get(path, value))
    return Tuned(tuned, tuple(map(float, numbers)), float(error), share_met(tuned))


def _until_kept(found: Iterable[Tuned]) -> list[Tuned]:
    """The first, up to one that keeps the limit."""
    looked_at = []
    for each in found:
        looked_at.append(each)
        if each.share >= 1.0:
            break
    return looked_at


def _better(found: Iterable[Tuned]) -> Tuned:
    """The least error of those that keep the limit; of none, what meets most of it."""
    return min(found, key=lambda each: (-min(each.share, 1.0), each.error))
