"""Monte Carlo studies of a scenario."""

import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError, InputWarning, lookup
from drake_quad.flight.mission import plan_route
from drake_quad.memory import check_fleet_fits
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.draws import LATIN_HYPERCUBE, MAX_SIZE, SOBOL, DesignedDraws
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.statistics.replicates import MIN_REPLICATES
from drake_quad.studies.flying import (
    BatchJob,
    build_before_fork,
    code_versions,
    crash_cause,
    default_batch_size,
    delete_fleets,
    fly_batch,
    fly_trial,
)
from drake_quad.studies.missing_samples import MissingSamples
from drake_quad.studies.processes import Workers, check_counts, check_importable, num_cores
from drake_quad.studies.stopping import StoppingRule, checkpoints
from drake_quad.studies.study import Study, study_columns
from drake_quad.studies.study_folder import StudyRows, open_study, report_saved_results
from drake_quad.studies.worker_pool import ExecutorPool, WorkerPool, fly_batches, size_of_batches

_TRIAL_SIZE = 3  # number of samples in the trial flights of a user's system
# Tolerance on the difference between a sample that is flown alone and in a batch. A user's system may sum in a
# different order, and vehicles that nearly crash amplify the rounding errors, so the tolerance is not zero.
_TRIAL_TOLERANCE = 1e-6


RANDOM = "random"
"""Kind of draws of independent samples."""
DRAWS = (RANDOM, LATIN_HYPERCUBE, SOBOL)
"""Kinds of draws of a study."""


def run_monte_carlo(
    scenario: Scenario,
    num_samples: int,
    seed: int | None = None,
    *,
    folder: Path | str | None = None,
    resume: bool = False,
    num_workers: int | None = None,
    batch_size: int | None = None,
    executor: Executor | WorkerPool | None = None,
    time_limit: float | None = None,
    position_controller: Callable[[int], Any] | None = None,
    control: Callable[[int], Any] | None = None,
    wind: Callable[[int], Any] | None = None,
    policy: Callable[[int], Any] | None = None,
    compiled: bool = True,
    until: Sequence[str] = (),
    draws: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Fly samples 0 to n - 1 of a scenario's study in fleets.

    The result of sample i does not depend on the number of samples, the batch size, the workers or the order. The
    sample can be flown alone by `simulate(scenario, seed=seed, sample=i)`.

    Args:
        scenario: scenario, which may contain distributions; even without distributions, each sample has different wind
            and noise.
        num_samples: number n of samples.
        seed: seed of the study; the scenario's seed by default.
        folder: folder for the results, which are written after each batch: the rows of all samples to results.csv, the
            scenario to scenario.yaml, versions and units to study.yaml, and failed samples to failed.csv. By default,
            nothing is written.
        resume: True to continue a study that the folder already contains.
        num_workers: number of processes, or of simultaneous batches of an executor of `concurrent.futures`; by default,
            the number of cores.
        batch_size: number of vehicles in a fleet; about a thousand by default.
        executor: executor that flies the batches instead of processes on this machine: one of `concurrent.futures`,
            existing `Workers`, or a Dask cluster from `dask_pool`.
        time_limit: time after which a batch fails, s, for processes on this machine; unlimited by default.
        position_controller: function that returns, for N vehicles, a system that replaces the scenario's position
            controller; see `build_tracking_diagram`. Workers must be able to import the function from its module.
        control: importable function that returns a system that replaces the whole cascade.
        wind: importable function that returns an additional source of wind.
        policy: importable function that returns a system that replaces the network of a control of kind `policy`. With
            any of these four functions, a sample is flown alone, alone again, and in a batch before the study begins.
            All three results must be equal.
        compiled: True to compile the diagram to machine code, except for systems that cannot be compiled; False to
            simulate the uncompiled diagram.
        until: rules such as `crash ± 0.2 %` or `rmse ± 1 %`. The study ends as soon as all of them are met, or after n
            samples. They are evaluated after fixed numbers of samples, see `drake_quad.studies.stopping`. The samples
            must be independent.
        draws: draws of the random parameters: `random` for independent samples, or `latin_hypercube` or `sobol` for at
            least 16 independent replicates that cover the distributions evenly; by default the draws of the scenario.
            Intervals follow from the spread of the replicates. Wind and noise are independent in all samples.
        progress: function that is called with the number of completed samples, and n.

    Returns:
        All samples that were flown in this run or an earlier run, and the reasons why other samples failed. A batch
        that fails is split in halves, which are flown separately, so that a sample that cannot be flown does not affect
        others.

    Raises:
        InputError: if a number is out of range, the scenario cannot be flown, worker processes cannot import a function
            or have different code, a user's system does not give equal results alone and in a batch or raises an error
            in the first samples, or the folder contains another study, or a study that must not be resumed.
        OSError: if rows could not be written, or the connection to a cluster was lost; completed rows are saved.
        RuntimeError: if no sample can be flown; completed rows are saved.
        MemoryError: if there is not enough memory; completed rows are saved.
        StudyInterrupted: if the user pressed Ctrl-C; completed rows are saved.
    """
    num_workers = num_cores() if num_workers is None else num_workers
    check_counts(num_samples=num_samples, num_workers=num_workers, batch_size=1 if batch_size is None else batch_size)
    scenario = scenario.model_copy(update={"seed": scenario.seed if seed is None else seed, "sample": None})
    if draws is not None:
        scenario = with_draws(scenario, draws, num_samples)
    if until and scenario.draws is not None:
        raise InputError(
            f"a study with {scenario.draws.kind} draws cannot end early: the stopping rules are valid for independent"
            " samples; use random draws, or leave out the rules"
        )
    plan = plan_route(scenario)
    rules = [StoppingRule.parse(text, scenario) for text in until]
    user_systems = UserSystems(position_controller, control, wind, policy)
    if executor is None or isinstance(executor, Workers):
        check_fleet_fits(min(batch_size or 1, num_samples), "batch")
        check_importable({**user_systems.specified, "a kind that the scenario uses": scenario})
    rows: StudyRows | None = None
    try:
        with (
            report_saved_results(lambda: "nothing was written" if rows is None else rows.saved),
            _open_pool(executor, num_workers, time_limit) as pool,
        ):
            job = BatchJob(
                uuid.uuid4().hex,
                code_versions(user_systems),
                scenario,
                plan,
                batch_size or default_batch_size(scenario),
                user_systems,
                compiled,
            )
            if user_systems.specified or scenario.control.contains_user_system():
                _check_repeatability(pool, job)
            duration = flight_duration(scenario, plan)
            with open_study(
                folder, scenario, num_samples, duration, user_systems, compiled=compiled, resume=resume
            ) as rows:
                for count in checkpoints(num_samples) if rules else [num_samples]:
                    missing, default = rows.missing(count), default_batch_size(scenario)
                    size = size_of_batches(len(missing), pool.num_workers, batch_size, default)
                    _fly(pool, job._replace(num_vehicles=size), rows, missing, progress)
                    if rules and len(rows) and all(rule.is_met(rows.metrics(count)) for rule in rules):
                        break
            if rows.failures and not len(rows):
                sample, reason = min(rows.failures.items())
                raise RuntimeError(f"no sample can be flown; sample {sample}: {reason}")
    finally:
        delete_fleets()
    return rows.study()


def with_draws(scenario: Scenario, kind: str, num_samples: int) -> Scenario:
    """Return a scenario whose random parameters are drawn by a given method.

    Args:
        scenario: scenario of the study.
        kind: `random`, `latin_hypercube` or `sobol`.
        num_samples: number of samples of the study, which is divided into at least `MIN_REPLICATES` replicates.

    Raises:
        InputError: if there is no such kind, the scenario has no distribution, or there are too few samples.
    """
    if kind == RANDOM:
        return scenario.model_copy(update={"draws": None})
    lookup(dict.fromkeys(DRAWS), kind, "kind of draws")
    if not distributions_in(scenario):
        raise InputError(f"{scenario.name} contains no distribution, so {kind} draws have no effect")
    size = min(num_samples // MIN_REPLICATES, MAX_SIZE)
    if size < 2:
        raise InputError(
            f"{kind} draws need at least {2 * MIN_REPLICATES} samples: {MIN_REPLICATES} replicates of two samples"
        )
    if kind == SOBOL:
        size = 2 ** (size.bit_length() - 1)
    return scenario.model_copy(update={"draws": DesignedDraws.model_validate({"kind": kind, "size": size})})


def _fly(
    pool: WorkerPool,
    job: BatchJob,
    rows: StudyRows,
    missing: MissingSamples,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Fly missing samples of a study in batches of the job's fleet size, and add their results to the study."""
    size = job.num_vehicles

    def report() -> None:
        if progress is not None:
            progress(len(rows) + len(rows.failures), rows.num_samples)

    report()
    if missing:
        build_before_fork(pool, job)
    batches = (missing[first : first + size] for first in range(0, len(missing), size))
    for outcome in fly_batches(pool, partial(fly_batch, job), batches):
        rows.add(outcome)
        report()


@contextmanager
def _open_pool(
    executor: Executor | WorkerPool | None, num_workers: int, time_limit: float | None
) -> Iterator[WorkerPool]:
    """Yield the pool that flies the batches, and abandon its remaining tasks at the end.

    Raises:
        InputError: if both an executor and a time limit are given.
    """
    if executor is not None and time_limit is not None:
        raise InputError(
            "a time limit cannot be combined with an executor; it applies to processes started by the study"
        )
    if executor is None:
        with Workers(num_workers, time_limit=time_limit) as workers:
            yield workers
        return
    pool = executor if isinstance(executor, WorkerPool) else ExecutorPool(executor, num_workers)
    try:
        yield pool
    finally:
        pool.abandon()


def _check_repeatability(pool: WorkerPool, job: BatchJob) -> None:
    """Check that sample 0 has the same result when it flies alone, flies alone again, and flies with other samples.

    A trial that fails for any reason other than an error in the user's code is ignored, since the study reports samples
    that cannot be flown. If the sample crashes because a value is NaN or infinite, a warning names this value.

    Raises:
        InputError: if the results differ, a user's system cannot be connected, or its code raises an error.
    """
    size = min(job.num_vehicles, _TRIAL_SIZE)
    job = job._replace(key=f"{job.key}, trial", num_vehicles=size)
    pool.submit(partial(fly_trial, job), range(size - 1, -1, -1))
    (outcome,) = pool.next_outcomes()
    if outcome.invalid_input or outcome.in_user_code:
        raise InputError(outcome.reason)
    if outcome.reason:
        return
    alone, repeated, in_batch = outcome.result
    columns = study_columns(job.scenario)
    names, error = " and ".join(job.user_systems.specified) or "the controller", columns.index("rmse")
    for row, circumstance, advice in (
        (repeated, "flown again in the same diagram", "must store all state in Drake's context, not in Python objects"),
        (in_batch, "flown together with other samples", "must not mix the columns of (k, N) arrays, one per vehicle"),
    ):
        if not np.allclose(row, alone, rtol=_TRIAL_TOLERANCE, atol=_TRIAL_TOLERANCE, equal_nan=True):
            raise InputError(
                f"sample 0 has an RMSE of {alone[error]:.6g} m when it is flown alone, but {row[error]:.6g} m when it"
                f" is {circumstance}; {names} {advice}"
            )
    if alone[columns.index("crashed")]:
        pool.submit(partial(crash_cause, job), range(1))
        (outcome,) = pool.next_outcomes()
        if outcome.result is not None:
            message = f"sample 0: {outcome.result}; flights with such values count as crashed"
            warnings.warn(message, InputWarning, stacklevel=3)
