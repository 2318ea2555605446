"""Monte Carlo studies of a scenario."""

import math
import uuid
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError, InputWarning
from drake_quad.flight.mission import plan_route
from drake_quad.memory import check_fleet_fits
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.models import Scenario
from drake_quad.studies.crew import Crew, ExecutorCrew, fly_batches
from drake_quad.studies.flying import BatchJob, cause_of_crash, code_of, fly_batch, fly_trial, forget, prepare
from drake_quad.studies.processes import Workers, check_counts, check_makers, num_cores
from drake_quad.studies.study import Study, columns_of
from drake_quad.studies.study_folder import StudyRows, open_study

# Default number of vehicles in a fleet. With about a thousand vehicles, Drake's overhead per step is negligible.
_BATCH_SIZE = 1024
# Number of samples in a trial, and tolerance on the difference between a sample that is flown alone and in a batch. The
# tolerance is not zero, since a user's system may sum in a different order. Vehicles that nearly crash amplify this.
_TRIAL_SIZE, _ALIKE = 3, 1e-6


class StudyInterrupted(KeyboardInterrupt):
    """Interruption of a study by Ctrl-C, with a message that says which rows are saved."""


def run_monte_carlo(
    scenario: Scenario,
    num_samples: int,
    seed: int | None = None,
    *,
    folder: Path | str | None = None,
    resume: bool = False,
    num_workers: int | None = None,
    batch_size: int | None = None,
    executor: Executor | Crew | None = None,
    time_limit: float | None = None,
    position_controller: Callable[[int], Any] | None = None,
    control: Callable[[int], Any] | None = None,
    wind: Callable[[int], Any] | None = None,
    policy: Callable[[int], Any] | None = None,
    compiled: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Fly samples 0 to n - 1 of a scenario's study in fleets.

    The result of sample i does not depend on the number of samples, the batch size, the workers or the order. The
    sample can be flown alone by `simulate(scenario, seed=seed, sample=i)`.

    Args:
        scenario: scenario, which may contain distributions; each sample has its own wind and noise in any case.
        num_samples: number n of samples.
        seed: seed of the study; that of the scenario if not given.
        folder: folder for the results, which are written batch by batch: the rows of all samples to results.csv, the
            scenario to scenario.yaml, versions and units to study.yaml, and failed samples to failed.csv. Nothing is
            written if it is not given.
        resume: True to continue the study in the folder, if there is one.
        num_workers: number of processes, or of simultaneous batches of an executor of `concurrent.futures`; the number
            of cores if not given.
        batch_size: number of vehicles in a fleet; about a thousand if not given.
        executor: executor that flies the batches instead of processes on this machine: one of `concurrent.futures`,
            existing `Workers`, or a Dask cluster from `dask_crew`.
        time_limit: time after which a batch fails, s, for processes on this machine; unlimited if not given.
        position_controller: function that returns, for N vehicles, a system that replaces the scenario's position
            controller; see `build_tracking_diagram`. Workers must be able to import the function from its module.
        control: function that returns a system that replaces the whole cascade; it must be importable, too.
        wind: function that returns an additional source of wind; it must be importable, too.
        policy: function that returns a system that replaces the network of a control of kind `policy`; it must be
            importable, too. With any of these four functions, a sample is flown alone, alone again, and in a batch
            before the study begins. All three results must be equal.
        compiled: True to compile the diagram to machine code, except for systems that cannot be compiled. Otherwise the
            original diagram is simulated.
        progress: function that is called with the number of completed samples, and n.

    Returns:
        All samples that were flown, now or earlier, and the reasons why others failed. A batch that fails is repeatedly
        split in halves and flown again, so that a sample that cannot be flown does not affect others.

    Raises:
        InputError: a number is out of range, the scenario cannot be flown, worker processes cannot import a function or
            have different code, a user's system does not give equal results alone and in a batch, or the folder
            contains another study or one that is not to be resumed.
        OSError: rows could not be written, or a cluster is gone; completed rows are saved.
        RuntimeError: no sample can be flown; completed rows are saved.
        MemoryError: there is not enough memory; completed rows are saved.
        StudyInterrupted: if the user pressed Ctrl-C; completed rows are saved.
    """
    num_workers = num_cores() if num_workers is None else num_workers
    check_counts(samples=num_samples, workers=num_workers, batch=1 if batch_size is None else batch_size)
    scenario = scenario.model_copy(update={"seed": scenario.seed if seed is None else seed, "sample": None})
    plan = plan_route(scenario)
    own = UserSystems(position_controller, control, wind, policy)
    if executor is None or isinstance(executor, Workers):
        check_fleet_fits(min(batch_size or 1, num_samples), "batch")
        check_makers(own.given)
    rows = None
    try:
        with _crew(executor, num_workers, time_limit) as crew:
            job = BatchJob(uuid.uuid4().hex, code_of(own), scenario, plan, batch_size or _BATCH_SIZE, own, compiled)
            if own.given or scenario.control.contains_user_system():
                _check_alike(crew, job)
            duration = flight_duration(scenario, plan)
            with open_study(folder, scenario, num_samples, duration, own, compiled=compiled, resume=resume) as rows:
                size = _size_of_batches(len(rows.missing), crew.num_workers, batch_size)
                _fly(crew, job._replace(num_vehicles=size), rows, progress)
            if rows.failures and not len(rows):
                sample, reason = min(rows.failures.items())
                raise RuntimeError(f"no sample can be flown; sample {sample}: {reason}")
    except KeyboardInterrupt:
        raise StudyInterrupted(f"interrupted: {_saved(rows)}") from None
    except OSError as error:
        raise OSError(f"{error}; {_saved(rows)}") from error
    except RuntimeError as error:
        raise RuntimeError(f"{error}; {_saved(rows)}") from error
    except MemoryError as error:
        raise MemoryError(f"the memory does not suffice; {_saved(rows)}") from error
    finally:
        forget()
    return rows.study()


def _saved(rows: StudyRows | None) -> str:
    return "nothing was written" if rows is None else rows.saved


def _fly(
    crew: Crew,
    job: BatchJob,
    rows: StudyRows,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Fly the missing samples of a study in batches of the size that the job gives, and add their rows."""
    missing, size = rows.missing, job.num_vehicles

    def report() -> None:
        if progress is not None:
            progress(len(rows) + len(rows.failures), rows.num_samples)

    report()
    if missing and not job.own.given and isinstance(crew, Workers) and crew.inherit:
        prepare(job)
    batches = (missing[first : first + size] for first in range(0, len(missing), size))
    for outcome in fly_batches(crew, partial(fly_batch, job), batches):
        rows.add(outcome)
        report()


@contextmanager
def _crew(executor: Executor | Crew | None, num_workers: int, time_limit: float | None) -> Iterator[Crew]:
    """Yield the crew that flies the batches, and abandon its remaining tasks at the end.

    Raises:
        InputError: both an executor and a time limit are given.
    """
    if executor is not None and time_limit is not None:
        raise InputError("a time limit is for processes of this study, not for an executor that is given")
    if executor is None:
        with Workers(num_workers, time_limit=time_limit) as workers:
            yield workers
        return
    crew = executor if isinstance(executor, Crew) else ExecutorCrew(executor, num_workers)
    try:
        yield crew
    finally:
        crew.give_up()


def _check_alike(crew: Crew, job: BatchJob) -> None:
    """Check that sample 0 has the same result when it is flown alone, alone again, and in a batch with others.

    A trial that fails is ignored, since the study reports samples that cannot be flown. If the sample crashes because a
    value is NaN or infinite, a warning names this value.

    Raises:
        InputError: if the results differ, or a user's system does not fit.
    """
    size = min(job.num_vehicles, _TRIAL_SIZE)
    job = job._replace(key=f"{job.key}, trial", num_vehicles=size)
    crew.begin(partial(fly_trial, job), range(size - 1, -1, -1))
    (outcome,) = crew.finished()
    if outcome.refused:
        raise InputError(outcome.reason)
    if outcome.reason:
        return
    alone, again, beside = outcome.result
    columns = columns_of(job.scenario)
    names, error = " and ".join(job.own.given) or "the controller", columns.index("rmse")
    for flown, how, why in (
        (again, "a second time in the same diagram", "must keep nothing in Python objects, but in Drake's state"),
        (beside, "beside other samples", "must not mix the vehicles of a fleet, whose rows are (k, N)"),
    ):
        if not np.allclose(flown, alone, rtol=_ALIKE, atol=_ALIKE, equal_nan=True):
            raise InputError(
                f"sample 0 flies otherwise {how} (RMSE {alone[error]:.6g} m, then {flown[error]:.6g} m): {names} {why}"
            )
    if alone[columns.index("crashed")]:
        crew.begin(partial(cause_of_crash, job), range(1))
        (outcome,) = crew.finished()
        if outcome.result is not None:
            words = f"sample 0: {outcome.result}; flights with such values count as crashed"
            warnings.warn(words, InputWarning, stacklevel=3)


def _size_of_batches(num_samples: int, num_workers: int, batch_size: int | None) -> int:
    """Return the number of samples in a batch; by default all workers get the same number of nearly equal batches."""
    if batch_size is None:
        rounds = math.ceil(num_samples / (num_workers * _BATCH_SIZE))
        batch_size = math.ceil(num_samples / max(rounds * num_workers, 1))
    return max(min(batch_size, num_samples), 1)
