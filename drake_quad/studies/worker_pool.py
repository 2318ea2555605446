"""Pools of workers that fly the batches of a study, and the handling of batches that fail."""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.user_code import describe_error, user_frames

# Number of failures of single samples after which a study is aborted, if no sample has succeeded before.
_MAX_FAILURES = 8
_MAX_REASON_LENGTH = 300  # characters; longer reasons for failures are cut


class Outcome(NamedTuple):
    """Outcome of a task.

    Attributes:
        argument: argument of the function; for a batch, the indices of its samples.
        result: return value of the function; for a batch, its rows (n, columns) of the results table. None if the task
            failed.
        reason: reason for the failure, in one line; empty if the task succeeded.
        invalid_input: True if the task failed because the user's input is wrong, so that the study must end.
        in_user_code: True if the user's own Python code raised an error.
    """

    argument: Any
    result: Any = None
    reason: str = ""
    invalid_input: bool = False
    in_user_code: bool = False


def run_task(function: Callable[[Any], Any], argument: Any) -> Outcome:
    """Call a function with an argument in the worker, and return the outcome.

    Every exception, including `SystemExit` but not `KeyboardInterrupt`, is returned as an outcome.
    """
    try:
        return Outcome(argument, function(argument))
    except KeyboardInterrupt:
        raise
    except InputError as error:
        return Outcome(argument, reason=describe_error(error), invalid_input=True)
    except BaseException as error:
        return failed_outcome(argument, error)


def failed_outcome(argument: Any, error: BaseException) -> Outcome:
    """Return the outcome of a task that raised an error."""
    text = describe_error(error)
    reason = text if len(text) <= _MAX_REASON_LENGTH else f"{text[:_MAX_REASON_LENGTH]}..."
    return Outcome(argument, reason=reason, in_user_code=bool(user_frames(error)))


class WorkerPool(ABC):
    """Workers that run tasks: processes on this machine, workers of an executor, or workers of a cluster.

    Attributes:
        num_workers: number of tasks that run at the same time.
        capacity: largest number of submitted tasks, including those that wait in a queue.
    """

    num_workers: int
    capacity: int

    @abstractmethod
    def submit(self, function: Callable[[Any], Any], argument: Any) -> None:
        """Start a task that calls a function with an argument; fewer than `capacity` tasks must be pending."""

    @abstractmethod
    def next_outcomes(self) -> list[Outcome]:
        """Wait until at least one task is done, and return the outcomes of all tasks that are done by then."""

    @abstractmethod
    def abandon(self) -> None:
        """Abandon all pending tasks."""


class ExecutorPool(WorkerPool):
    """Pool that runs its tasks in an executor of `concurrent.futures`.

    Args:
        executor: executor that runs the tasks.
        num_workers: number of tasks that the executor runs at the same time.
    """

    def __init__(self, executor: Executor, num_workers: int) -> None:
        self.num_workers = num_workers
        self.capacity = 2 * num_workers  # a queued task for each worker, so that no worker waits for this process
        self._executor = executor
        self._pending: dict[Future[Outcome], Any] = {}

    def submit(self, function: Callable[[Any], Any], argument: Any) -> None:
        """Start a task, as `WorkerPool.submit` does."""
        self._pending[self._executor.submit(run_task, function, argument)] = argument

    def next_outcomes(self) -> list[Outcome]:
        """Wait for outcomes, as `WorkerPool.next_outcomes` does, and return them in the order of submission."""
        done, _ = wait(self._pending, return_when=FIRST_COMPLETED)
        in_order = [future for future in self._pending if future in done]
        return [self._outcome(future, self._pending.pop(future)) for future in in_order]

    @staticmethod
    def _outcome(future: Future[Outcome], argument: Any) -> Outcome:
        try:
            return future.result()
        except Exception as error:  # the worker died, or could not unpickle the task
            return failed_outcome(argument, error)

    def abandon(self) -> None:
        """Cancel all pending tasks; the executor completes tasks that are already running."""
        for future in self._pending:
            future.cancel()
        self._pending.clear()


def run_tasks(
    pool: WorkerPool, function: Callable[[Any], Any], next_task: Callable[[], Any | None]
) -> Iterator[Outcome]:
    """Run tasks and yield their outcomes in the order of completion.

    Args:
        pool: pool that runs the tasks.
        function: function that is called with the argument of each task.
        next_task: function that returns the argument of the next task, or None if there is none at the moment. It is
            called whenever the pool can accept a task. The handling of an outcome may create further tasks.

    Raises:
        InputError: if a task fails because the input is wrong.
    """
    num_pending = 0
    while True:
        while num_pending < pool.capacity and (task := next_task()) is not None:
            pool.submit(function, task)
            num_pending += 1
        if not num_pending:
            return
        for outcome in pool.next_outcomes():
            num_pending -= 1
            if outcome.invalid_input:
                raise InputError(outcome.reason)
            yield outcome


def fly_batches(
    pool: WorkerPool, fly: Callable[[Any], np.ndarray], batches: Iterable[Sequence[Any] | np.ndarray]
) -> Iterator[Outcome]:
    """Fly batches and yield their outcomes in the order of completion.

    A batch that fails is split in halves, which are flown separately, and so on, until the samples that fail are known.
    Only these samples yield failed outcomes.

    Args:
        pool: pool that flies the batches.
        fly: function that returns the rows (n, columns) of n samples.
        batches: samples of each batch, by their indices or as the rows of an array; a batch is requested when the pool
            can accept it.

    Raises:
        InputError: if a drawn sample violates the limits of the scenario language.
        RuntimeError: if the first samples all fail when flown alone, or the pool accepts no more batches.
    """
    new_batches, split_batches = iter(batches), deque[Sequence[Any] | np.ndarray]()
    any_succeeded, num_failed = False, 0
    for outcome in run_tasks(pool, fly, lambda: split_batches.popleft() if split_batches else next(new_batches, None)):
        if outcome.reason and len(outcome.argument) > 1:
            middle = len(outcome.argument) // 2
            split_batches.extendleft((outcome.argument[middle:], outcome.argument[:middle]))
            continue
        any_succeeded, num_failed = any_succeeded or not outcome.reason, num_failed + bool(outcome.reason)
        if not any_succeeded and num_failed == _MAX_FAILURES:
            raise RuntimeError(f"the first {_MAX_FAILURES} samples all failed, each flown alone: {outcome.reason}")
        yield outcome


def size_of_batches(num_samples: int, num_workers: int, batch_size: int | None, default: int) -> int:
    """Return the number of samples in a batch; by default, all workers receive equally many batches of similar size."""
    if batch_size is None:
        rounds = math.ceil(num_samples / (num_workers * default))
        batch_size = math.ceil(num_samples / max(rounds * num_workers, 1))
    return max(min(batch_size, num_samples), 1)
