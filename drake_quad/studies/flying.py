"""What happens where batches are flown: samples side by side in fleets that are built once."""

import platform
import threading
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.simulation import simulate
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.studies.provenance import difference, provenance, sources_of
from drake_quad.studies.study import rows_of

# A thread flies in diagrams of its own, since executors may have several.
_own = threading.local()


class BatchJob(NamedTuple):
    """What all batches of a study have in common.

    Attributes:
        key: tells this run of a study from others.
        code: versions and sources with which it must be flown.
        scenario: under the study's seed.
        plan: that is flown.
        num_vehicles: N of the largest fleet.
        own: functions that make systems of the user's for N vehicles.
        compiled: whether the diagram is compiled to machine code; else it flies as it is wired.
    """

    key: str
    code: dict[str, str]
    scenario: Scenario
    plan: Plan
    num_vehicles: int
    own: UserSystems
    compiled: bool


def code_of(own: UserSystems) -> dict[str, str]:
    """What this process would fly with: `provenance`, and the sources of functions that are not of this package."""
    return {**provenance(), "own": sources_of(own.given.values())}


def fly_batch(job: BatchJob, samples: Sequence[int]) -> np.ndarray:
    """Flies samples of a study and returns their (n, columns) rows.

    Raises:
        InputError: this process has other code than the one that wants the study.
    """
    batch = Batch.draw(job.scenario, samples)
    fleet = _fleet(job, len(batch))
    metrics = fleet.fly_batch(batch)
    return rows_of(batch, metrics, fleet.touched()[: len(batch)])


def fly_trial(job: BatchJob, samples: Sequence[int]) -> np.ndarray:
    """Flies the last of some samples alone, alone once more, and beside the others; returns its three rows."""
    last = samples[-1:]
    return np.vstack([fly_batch(job, last), fly_batch(job, last), fly_batch(job, samples)[-1:]])


def cause_of_crash(job: BatchJob, samples: Sequence[int]) -> str | None:
    """Return a sentence on the first value that was NaN or infinite in the flight of the first of some samples.

    The result is None if the vehicle did not crash for this reason.
    """
    own = job.own.build(1).given
    return simulate(job.scenario, sample=samples[0], plan=job.plan, compiled=job.compiled, **own).cause


def prepare(job: BatchJob) -> None:
    """Builds the fleet of a job and flies its first steps: processes forked from this one have both at once."""
    fleet = _fleet(job, job.num_vehicles)
    fleet.fly(range(job.num_vehicles), duration=2.0 * job.scenario.laboratory.command_link.period)


def forget() -> None:
    """Lets go of the fleets."""
    _own.__dict__.clear()


def _fleet(job: BatchJob, num_samples: int) -> StudyFleet:
    """A fleet for so many samples: the largest, or half of it, and so on, so that there are few."""
    if getattr(_own, "key", None) != job.key:
        forget()
        other = difference(job.code, code_of(job.own))
        if other is not None:
            raise InputError(f"a worker on {platform.node()} has {other}")
        _own.fleets = {}
        _own.key = job.key
    size = job.num_vehicles
    while size > 1 and (size + 1) // 2 >= num_samples:
        size = (size + 1) // 2
    fleets: dict[int, StudyFleet] = _own.fleets
    if size not in fleets:
        fleets[size] = StudyFleet(job.scenario, job.plan, size, own=job.own, compiled=job.compiled)
    return fleets[size]
