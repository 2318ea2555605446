"""Functions that fly batches in the workers, in fleets that are built once per job."""

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

# Each thread has its own diagrams, since an executor may have several threads.
_own = threading.local()


class BatchJob(NamedTuple):
    """Common data of all batches of a study.

    Attributes:
        key: unique text that identifies this run of the study.
        code: versions and sources that the workers must have, see `code_of`.
        scenario: scenario with the seed of the study.
        plan: plan of the flight.
        num_vehicles: number N of vehicles in the largest fleet.
        own: functions that return the user's systems for N vehicles.
        compiled: True to compile the diagram to machine code. Otherwise the original diagram is simulated.
    """

    key: str
    code: dict[str, str]
    scenario: Scenario
    plan: Plan
    num_vehicles: int
    own: UserSystems
    compiled: bool


def code_of(own: UserSystems) -> dict[str, str]:
    """Return the code that this process would fly: its `provenance`, and a digest of the user's sources."""
    return {**provenance(), "own": sources_of(own.given.values())}


def fly_batch(job: BatchJob, samples: Sequence[int]) -> np.ndarray:
    """Fly samples of a study and return their rows (n, columns).

    Raises:
        InputError: the code of this process differs from that of the process that started the study.
    """
    batch = Batch.draw(job.scenario, samples)
    fleet = _fleet(job, len(batch))
    metrics = fleet.fly_batch(batch)
    return rows_of(batch, metrics, fleet.touched()[: len(batch)])


def fly_trial(job: BatchJob, samples: Sequence[int]) -> np.ndarray:
    """Fly the last of some samples alone, alone again, and together with the others, and return its three rows."""
    last = samples[-1:]
    return np.vstack([fly_batch(job, last), fly_batch(job, last), fly_batch(job, samples)[-1:]])


def cause_of_crash(job: BatchJob, samples: Sequence[int]) -> str | None:
    """Return a sentence on the first value that was NaN or infinite in the flight of the first of some samples.

    The result is None if the vehicle did not crash for this reason.
    """
    own = job.own.build(1).given
    return simulate(job.scenario, sample=samples[0], plan=job.plan, compiled=job.compiled, **own).cause


def prepare(job: BatchJob) -> None:
    """Build the fleet of a job and fly its first steps, so that forked processes inherit the compiled fleet."""
    fleet = _fleet(job, job.num_vehicles)
    fleet.fly(range(job.num_vehicles), duration=2.0 * job.scenario.laboratory.command_link.period)


def forget() -> None:
    """Delete the fleets of this thread."""
    _own.__dict__.clear()


def _fleet(job: BatchJob, num_samples: int) -> StudyFleet:
    """Return a fleet that has room for a number of samples.

    Its size is that of the largest fleet, halved as often as possible. A job therefore needs only a few fleets.
    """
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
