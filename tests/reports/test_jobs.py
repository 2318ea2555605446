"""Tests that jobs may be completed in any order, and that results are in the order of the jobs."""

from functools import partial

import pytest
from fake_workers import FakeWorkers

from drake_quad.errors import InputError
from drake_quad.reports.jobs import Job, run_jobs
from drake_quad.studies.processes import Workers

# Jobs with a name, a size and a function.
JOBS = [Job(name, size, partial(int, str(size))) for name, size in (("a", 3), ("b", 4), ("c", 5))]


@pytest.mark.parametrize(
    ("workers", "order"), [(None, [3, 4, 5]), (FakeWorkers(2), [4, 5, 3]), (FakeWorkers(9), [5, 4, 3])]
)
def test_results_and_progress_are_reported_as_jobs_are_completed(workers, order):
    completed, progress = [], []
    results = run_jobs(JOBS, workers, finished=completed.append, progress=lambda *each: progress.append(each))
    assert results == [3, 4, 5]
    assert completed == order
    names = {job.size: job.name for job in JOBS}
    assert progress == [(sum(order[: i + 1]), 12, names[size]) for i, size in enumerate(order)]
    assert workers is None or workers.max_pending == min(workers.capacity, 3)


def test_worker_processes_complete_jobs():
    with Workers(2) as workers:
        assert run_jobs(JOBS, workers) == [3, 4, 5]


def fail(error):
    raise error


@pytest.mark.parametrize(
    ("error", "kind", "reason"),
    [
        (ArithmeticError("no such number"), RuntimeError, "ArithmeticError: no such number"),
        (InputError("the mass is -1"), InputError, r"^\S+test_jobs.py:\d+: the mass is -1$"),
    ],
)
def test_the_error_of_a_worker_is_reported(error, kind, reason):
    """An InputError of a worker remains an InputError."""
    with pytest.raises(kind, match=reason):
        run_jobs([Job("d", 1, partial(fail, error))], FakeWorkers(1))
