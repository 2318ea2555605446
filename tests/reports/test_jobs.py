"""Jobs are done in any order, and their results are returned in the order of the jobs."""

from functools import partial

import pytest
from invented_workers import InventedWorkers

from drake_quad.errors import InputError
from drake_quad.reports.jobs import Job, run_jobs
from drake_quad.studies.processes import Workers

JOBS = [Job(name, size, partial(int, str(size))) for name, size in (("a", 3), ("b", 4), ("c", 5))]


@pytest.mark.parametrize(
    ("workers", "order"), [(None, [3, 4, 5]), (InventedWorkers(2), [4, 5, 3]), (InventedWorkers(9), [5, 4, 3])]
)
def test_jobs_are_counted_as_they_are_done(workers, order):
    results, told = [], []
    found = run_jobs(JOBS, workers, finished=results.append, progress=lambda *each: told.append(each))
    assert found == [3, 4, 5]
    assert results == order
    names = {job.size: job.name for job in JOBS}
    assert told == [(sum(order[: i + 1]), 12, names[size]) for i, size in enumerate(order)]
    assert workers is None or workers.most == min(workers.capacity, 3)


def test_processes_do_jobs():
    with Workers(2) as workers:
        assert run_jobs(JOBS, workers) == [3, 4, 5]


def fail(error):
    raise error


@pytest.mark.parametrize(
    ("error", "kind", "reason"),
    [
        (ArithmeticError("this one is cursed"), RuntimeError, "ArithmeticError: this one is cursed"),
        (InputError("the mass is -1"), InputError, "^the mass is -1$"),
    ],
)
def test_the_failure_of_a_worker_is_told(error, kind, reason):
    """A mistake in the input is an error of the user, also if a worker finds it."""
    with pytest.raises(kind, match=reason):
        run_jobs([Job("d", 1, partial(fail, error))], InventedWorkers(1))
