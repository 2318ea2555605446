"""Jobs of an experiment, which run one after another in this process, or in parallel in workers."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from drake_quad.studies.worker_pool import WorkerPool, run_tasks


class Job(NamedTuple):
    """Job of an experiment, such as flights that are simulated together.

    Attributes:
        name: name of the job in progress messages.
        size: size of the job, such as its number of flights.
        call: function that does the job; it must be picklable if the job runs in a worker.
    """

    name: str
    size: int
    call: Callable[[], Any]


def run_jobs(
    jobs: Sequence[Job],
    workers: WorkerPool | None = None,
    *,
    finished: Callable[[Any], object] = lambda result: None,
    progress: Callable[[int, int, str], object] = lambda *_: None,
) -> list[Any]:
    """Run jobs, and return their results in the order of the jobs.

    Args:
        jobs: jobs of the experiment.
        workers: workers in which the jobs run in parallel; by default, the jobs run in this process.
        finished: function that is called with the result of each job as soon as the job is done.
        progress: function that is called after each job with the total size of all finished jobs, the total size of all
            jobs, and the name of the job.

    Raises:
        InputError: if a job failed because the input is wrong.
        RuntimeError: if a job failed in a worker.
    """
    results, done, total = {}, 0, sum(job.size for job in jobs)
    for number, result in _results(jobs, workers):
        results[number], done = result, done + jobs[number].size
        finished(result)
        progress(done, total, jobs[number].name)
    return [results[number] for number in range(len(jobs))]


def _results(jobs: Sequence[Job], workers: WorkerPool | None) -> Iterator[tuple[int, Any]]:
    """Run jobs, and yield the index and the result of each job as soon as it is done."""
    if workers is None:
        for number, job in enumerate(jobs):
            yield number, job.call()
        return
    waiting = enumerate(jobs)
    for outcome in run_tasks(workers, _call, lambda: next(waiting, None)):
        if outcome.reason:
            raise RuntimeError(outcome.reason)
        yield outcome.argument[0], outcome.result


def _call(numbered: tuple[int, Job]) -> Any:
    _, job = numbered
    return job.call()
