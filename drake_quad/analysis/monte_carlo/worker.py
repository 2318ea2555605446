"""What happens in a worker: batches of samples, flown by one fleet that is built once."""

import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.analysis.monte_carlo.study import rows_of
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario, drawn_numbers
from drake_quad.study_fleet import StudyFleet

# A thread flies in a diagram of its own, since executors may have several.
_own = threading.local()


class Job(NamedTuple):
    """What all batches of a study have in common.

    Attributes:
        key: tells this run of a study from others.
        scenario: of the study.
        plan: that is flown.
        num_vehicles: N of the fleet.
        position_controller: makes a position controller for N vehicles in place of the scenario's, if given.
        control: makes one for the whole cascade, if given.
        wind: makes a source of wind beside the scenario's, if given.
    """

    key: str
    scenario: Scenario
    plan: Plan
    num_vehicles: int
    position_controller: Callable[[int], Any] | None
    control: Callable[[int], Any] | None
    wind: Callable[[int], Any] | None


def fly_batch(job: Job, samples: Sequence[int]) -> np.ndarray:
    """Flies samples of a study and returns their (n, columns) rows."""
    metrics = _fleet(job).fly(samples, progress=_heed_stop)
    return rows_of(samples, drawn_numbers(job.scenario, samples), metrics)


def prepare(job: Job) -> None:
    """Builds the fleet of a job and flies its first steps: processes forked from this one have both at once."""
    fleet = _fleet(job)
    fleet.fly(range(job.num_vehicles), duration=2.0 * job.scenario.laboratory.command_link.period)


def forget() -> None:
    """Lets go of the fleet."""
    _own.__dict__.clear()


class StoppedError(Exception):
    """A batch was given up because its study is to end."""


def heed(stop: Any) -> None:
    """Lets batches of this process be given up when an event is set."""
    global _stop
    _stop = stop


_stop: Any = None


def _heed_stop(flown: float, duration: float) -> None:
    if _stop is not None and _stop.is_set():
        raise StoppedError


def _fleet(job: Job) -> StudyFleet:
    if getattr(_own, "key", None) != job.key:
        forget()
        _own.fleet = StudyFleet(
            job.scenario,
            job.num_vehicles,
            plan=job.plan,
            position_controller=job.position_controller,
            control=job.control,
            wind=job.wind,
        )
        _own.key = job.key
    fleet: StudyFleet = _own.fleet
    return fleet
