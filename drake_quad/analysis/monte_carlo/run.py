"""Flying a study."""

import math
import uuid
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from drake_quad.analysis.monte_carlo.study import Study
from drake_quad.analysis.monte_carlo.study_folder import open_study
from drake_quad.analysis.monte_carlo.worker import Job, fly_batch, forget, prepare
from drake_quad.analysis.monte_carlo.workers import Workers, check_counts, check_makers, fly_batches, num_cores
from drake_quad.planning import flight_duration, plan_route
from drake_quad.scenario import Scenario

# Vehicles of a fleet. With about a thousand, what Drake does once a step hardly counts any more.
_BATCH_SIZE = 1024


class StudyInterrupted(KeyboardInterrupt):
    """A study was ended by Ctrl-C; the message says what is saved."""


def run_monte_carlo(
    scenario: Scenario,
    num_samples: int,
    seed: int | None = None,
    *,
    folder: Path | str | None = None,
    resume: bool = False,
    num_workers: int | None = None,
    batch_size: int | None = None,
    executor: Executor | Workers | None = None,
    position_controller: Callable[[int], Any] | None = None,
    control: Callable[[int], Any] | None = None,
    wind: Callable[[int], Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Flies samples 0 to n - 1 of a scenario's study, in fleets.

    Sample i is the same whatever the number of samples, the size of batches, the workers and the order; it can be flown
    alone by `simulate(scenario, seed=seed, sample=i)`.

    Args:
        scenario: with or without distributions; wind and noise of each sample are its own in any case.
        num_samples: n.
        seed: of the study, in place of the scenario's.
        folder: where to write, batch by batch: the rows of all samples to results.csv, the scenario to scenario.yaml,
            versions and units to study.yaml, and what could not be flown to failed.csv. Nothing is written if it is not
            given.
        resume: whether to go on with the study in the folder, if there is one.
        num_workers: processes, or how many batches another executor flies at a time; as many as there are cores if not
            given.
        batch_size: vehicles in a fleet; about a thousand if not given.
        executor: that flies the batches, such as that of a Dask client, in place of processes on this machine.
        position_controller: makes a system for N vehicles that stands in for the scenario's; see
            `build_tracking_diagram`. A function of a module, so that workers find it.
        control: makes one for the whole cascade; likewise.
        wind: makes a source of wind beside the scenario's; likewise.
        progress: called with the number of samples that are done, and n.

    Returns:
        All samples that were flown, now or before; failures say why others were not.

    Raises:
        InputError: a number is out of range, the scenario cannot be flown, worker processes would not find a function,
            or the folder holds another study or one that is not to be resumed.
        OSError: rows could not be written; those before them are saved.
        StudyInterrupted: by Ctrl-C; what is done is saved.
    """
    num_workers = num_cores() if num_workers is None else num_workers
    check_counts(samples=num_samples, workers=num_workers, batch=1 if batch_size is None else batch_size)
    scenario = scenario.model_copy(update={"seed": scenario.seed if seed is None else seed, "sample": None})
    plan = plan_route(scenario)
    own = {"position_controller": position_controller, "control": control, "wind": wind}
    if executor is None or isinstance(executor, Workers):
        check_makers(own)
    with open_study(folder, scenario, num_samples, flight_duration(scenario, plan), own, resume=resume) as rows:
        batches = _batches(rows.missing, num_workers, batch_size)
        job = Job(uuid.uuid4().hex, scenario, plan, max(map(len, batches), default=1), **own)

        def report() -> None:
            if progress is not None:
                progress(len(rows) + len(rows.failures), num_samples)

        report()
        try:
            with Workers(num_workers) if executor is None else nullcontext(executor) as workers:
                if batches and isinstance(workers, Workers) and workers.inherit:
                    prepare(job)
                fly = partial(fly_batch, job)
                for outcome in fly_batches(workers.submit, fly, batches, at_once=2 * num_workers):
                    rows.add(outcome)
                    report()
        except KeyboardInterrupt:
            raise StudyInterrupted(f"interrupted: {rows.saved}") from None
        except OSError as error:
            raise OSError(f"{error}; {rows.saved}") from error
        finally:
            forget()
    return rows.study()


def _batches(samples: Sequence[int], num_workers: int, batch_size: int | None) -> list[Sequence[int]]:
    """Samples in batches: if nothing else is asked for, equally many for every worker, and nearly equally large."""
    if batch_size is None:
        rounds = math.ceil(len(samples) / (num_workers * _BATCH_SIZE))
        batch_size = math.ceil(len(samples) / max(rounds * num_workers, 1))
    return [samples[first : first + batch_size] for first in range(0, len(samples), max(batch_size, 1))]
