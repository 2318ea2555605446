"""Functions that fly batches in the workers, in fleets that are built once per job."""

import platform
import threading
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.simulation import fly_with_metrics, simulate
from drake_quad.laboratory.metrics import recorded_metrics
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch, coordinates
from drake_quad.scenario.models import Scenario
from drake_quad.studies.processes import Workers
from drake_quad.studies.provenance import code_difference, provenance, source_digest
from drake_quad.studies.study import study_rows
from drake_quad.studies.worker_pool import WorkerPool

# With about a thousand vehicles in a fleet, Drake's overhead per step is negligible. With 1,024 vehicles, all rows of a
# column would compete for the same places in the processor's caches; vehicles with estimators then fly a third slower.
_DEFAULT_BATCH_SIZE = 1000
_RECORDED_BATCH_SIZE = 64  # smaller, since recording 30 s of flight takes a few megabytes per vehicle
_FIRMWARE_BATCH_SIZE = 16  # smaller still, since every vehicle has a process

# Each thread has separate diagrams, since an executor may have several threads.
_thread_data = threading.local()


class BatchJob(NamedTuple):
    """Common data of all batches of a study.

    Attributes:
        key: unique text that identifies this run of the study.
        code: versions and source digests that the workers must match, see `code_versions`.
        scenario: scenario with the seed of the study.
        plan: plan of the flight.
        num_vehicles: number N of vehicles in the largest fleet.
        user_systems: functions that return the user's systems for N vehicles.
        compiled: True to compile the diagram to machine code. Otherwise the original diagram is simulated.
    """

    key: str
    code: dict[str, str]
    scenario: Scenario
    plan: Plan
    num_vehicles: int
    user_systems: UserSystems
    compiled: bool


def default_batch_size(scenario: Scenario) -> int:
    """Return the default number of samples in a batch, which is smaller if metrics need signals, or with firmware."""
    if scenario.laboratory.autopilot.is_firmware:
        return _FIRMWARE_BATCH_SIZE
    return _RECORDED_BATCH_SIZE if recorded_metrics(scenario.metrics_type) else _DEFAULT_BATCH_SIZE


def code_versions(user_systems: UserSystems) -> dict[str, str]:
    """Return the versions and digests of the code in this process: its `provenance`, and the user's source files."""
    return {**provenance(), "user_systems": source_digest(user_systems.specified.values())}


def fly_batch(job: BatchJob, samples: Sequence[int]) -> np.ndarray:
    """Fly samples of a study and return their rows (n, columns) of the results table.

    Raises:
        InputError: if the code of this process differs from the code of the process that started the study.
    """
    batch = Batch.draw(job.scenario, samples)
    fleet = _fleet(job, len(batch))
    metrics = fly_with_metrics(fleet, batch)
    return study_rows(batch, metrics, fleet.obstacle_hit()[: len(batch)])


def fly_points(job: BatchJob, flights: np.ndarray) -> np.ndarray:
    """Fly vehicles whose random numbers are given as points of the d-dimensional unit cube, and return their metrics.

    Args:
        job: common data of all batches.
        flights: (n, 1 + d + k) array with a row for each flight. Column 0 contains the index of the flight, the next d
            columns the point, and the last k columns the numbers of the samples whose wind and noise are used in the k
            periods of the flight; see `Batch.at_points`.

    Returns:
        (n, 1 + m) array with the index and the m metrics of each flight, in the order of the given flights.

    Raises:
        InputError: if the code of this process differs from the code of the process that started the search.
    """
    return point_rows(_fleet(job, len(flights)), flights)


def point_rows(fleet: StudyFleet, flights: np.ndarray) -> np.ndarray:
    """Return the result of `fly_points` for flights in a given fleet."""
    return np.column_stack([flights[:, 0], *fly_with_metrics(fleet, build_point_batch(fleet.scenario, flights))])


def build_point_batch(scenario: Scenario, flights: np.ndarray) -> Batch:
    """Return the batch of the flights of `fly_points`."""
    end = 1 + len(coordinates(scenario))
    periods = flights[:, end:].astype(np.int64).T.tolist()
    noise = None if scenario.noise is None else periods
    return Batch.at_points(scenario, flights[:, 1:end], periods[0], noise=noise)


def fly_trial(job: BatchJob, samples: Sequence[int]) -> np.ndarray:
    """Fly the last sample alone twice, then all samples together, and return the three results of the last sample."""
    last = samples[-1:]
    return np.vstack([fly_batch(job, last), fly_batch(job, last), fly_batch(job, samples)[-1:]])


def crash_cause(job: BatchJob, samples: Sequence[int]) -> str | None:
    """Return a sentence that names the first NaN or infinite value in the flight of the first sample.

    The result is None if the vehicle did not crash because of such a value.
    """
    systems = job.user_systems.build(1).specified
    return simulate(job.scenario, sample=samples[0], plan=job.plan, compiled=job.compiled, **systems).cause


def build_fleet(job: BatchJob) -> None:
    """Build the fleet of a job and simulate its first ticks, so that forked processes inherit the compiled fleet."""
    fleet = _fleet(job, job.num_vehicles)
    fleet.fly(range(job.num_vehicles), duration=2.0 * job.scenario.laboratory.command_link.period)


def build_before_fork(pool: WorkerPool, job: BatchJob) -> None:
    """Build the fleet of a job if the workers of a pool will be forked from this process, and inherit the fleet."""
    if not job.user_systems.specified and isinstance(pool, Workers) and pool.forks_workers:
        build_fleet(job)


def delete_fleets() -> None:
    """Delete the fleets of this thread."""
    _thread_data.__dict__.clear()


def _fleet(job: BatchJob, num_samples: int) -> StudyFleet:
    """Return a fleet of this thread with at least as many vehicles as there are samples; see `get_fleet`."""
    if getattr(_thread_data, "key", None) != job.key:
        delete_fleets()
        mismatch = code_difference(job.code, code_versions(job.user_systems))
        if mismatch is not None:
            raise InputError(f"a worker on {platform.node()} has {mismatch}")
        _thread_data.fleets = {}
        _thread_data.key = job.key
    return get_fleet(job, _thread_data.fleets, num_samples)


def get_fleet(job: BatchJob, fleets: dict[int, StudyFleet], num_samples: int) -> StudyFleet:
    """Return a fleet with at least as many vehicles as there are samples, and build it if there is none.

    The size of a fleet is the size of the largest fleet divided by a power of two, so that a job needs only a few
    fleets.

    Args:
        job: common data of all batches.
        fleets: existing fleets of the job by size.
        num_samples: number of samples, at most the size of the largest fleet.
    """
    size = job.num_vehicles
    while size > 1 and (size + 1) // 2 >= num_samples:
        size = (size + 1) // 2
    if size not in fleets:
        fleets[size] = StudyFleet(job.scenario, job.plan, size, user_systems=job.user_systems, compiled=job.compiled)
    return fleets[size]
