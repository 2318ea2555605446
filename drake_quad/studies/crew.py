"""Crews of workers that fly the batches of a study, and the treatment of batches that fail."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError

# A study ends after this many failures of samples that were flown alone, if no sample has succeeded before.
_MAX_FAILURES = 8
_MAX_REASON_LENGTH = 300


class Outcome(NamedTuple):
    """Outcome of a task.

    Attributes:
        given: argument of the function; for a batch, the indices of its samples.
        result: return value of the function; for a batch, its rows (n, columns). None if the task failed.
        reason: reason for the failure, in one line; empty if the task succeeded.
        refused: True if the task failed because the input is wrong, so that the study must end.
    """

    given: Any
    result: Any = None
    reason: str = ""
    refused: bool = False


def attempt(function: Callable[[Any], Any], given: Any) -> Outcome:
    """Do a task in the worker and return its outcome.

    Everything that the task raises becomes an outcome, including `SystemExit`, but not `KeyboardInterrupt`.
    """
    try:
        return Outcome(given, function(given))
    except KeyboardInterrupt:
        raise
    except InputError as error:
        return Outcome(given, reason=str(error), refused=True)
    except BaseException as error:
        return failed(given, error)


def failed(given: Any, error: BaseException) -> Outcome:
    """Return the outcome of a task that raised an error."""
    words = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
    return Outcome(given, reason=words if len(words) <= _MAX_REASON_LENGTH else f"{words[:_MAX_REASON_LENGTH]}...")


class Crew(ABC):
    """Group of workers: processes on this machine, workers of an executor, or workers of a cluster.

    Attributes:
        num_workers: number of tasks that are done at the same time.
        capacity: number of tasks that are accepted at the same time; some of them wait in a queue.
    """

    num_workers: int
    capacity: int

    @abstractmethod
    def begin(self, function: Callable[[Any], Any], given: Any) -> None:
        """Begin a task, which calls a function with an argument; fewer than `capacity` tasks must be under way."""

    @abstractmethod
    def finished(self) -> list[Outcome]:
        """Wait until at least one task is done, and return the outcomes of all tasks that are done."""

    @abstractmethod
    def give_up(self) -> None:
        """Abandon all tasks that are under way."""


class ExecutorCrew(Crew):
    """Crew of the workers of an executor of `concurrent.futures`.

    Args:
        executor: executor that does the tasks.
        num_workers: number of tasks that the executor does at the same time.
    """

    def __init__(self, executor: Executor, num_workers: int) -> None:
        self.num_workers = num_workers
        self.capacity = 2 * num_workers  # each worker has a second task in its queue and does not wait for this process
        self._executor = executor
        self._under_way: dict[Future[Outcome], Any] = {}

    def begin(self, function: Callable[[Any], Any], given: Any) -> None:
        """Begin a task, as `Crew.begin` does."""
        self._under_way[self._executor.submit(attempt, function, given)] = given

    def finished(self) -> list[Outcome]:
        """Wait for outcomes, as `Crew.finished` does."""
        done, _ = wait(self._under_way, return_when=FIRST_COMPLETED)
        return [self._outcome(future, self._under_way.pop(future)) for future in done]

    @staticmethod
    def _outcome(future: Future[Outcome], given: Any) -> Outcome:
        try:
            return future.result()
        except Exception as error:  # the worker died, or could not unpickle the task
            return failed(given, error)

    def give_up(self) -> None:
        """Abandon all tasks, as `Crew.give_up` does, except that the executor completes tasks that it has begun."""
        for future in self._under_way:
            future.cancel()
        self._under_way.clear()


def outcomes_of(crew: Crew, function: Callable[[Any], Any], next_task: Callable[[], Any | None]) -> Iterator[Outcome]:
    """Do tasks and yield their outcomes in the order of completion.

    Args:
        crew: crew that does the tasks.
        function: function that does a task.
        next_task: called for a task when the crew has room for it; returns None if there is none at the moment. The
            handling of an outcome may create further tasks.

    Raises:
        InputError: a task fails because the input is wrong.
    """
    under_way = 0
    while True:
        while under_way < crew.capacity and (task := next_task()) is not None:
            crew.begin(function, task)
            under_way += 1
        if not under_way:
            return
        for outcome in crew.finished():
            under_way -= 1
            if outcome.refused:
                raise InputError(outcome.reason)
            yield outcome


def fly_batches(
    crew: Crew, fly: Callable[[Sequence[int]], np.ndarray], batches: Iterable[Sequence[int]]
) -> Iterator[Outcome]:
    """Fly batches and yield their outcomes in the order of completion.

    A batch that fails is repeatedly split in halves and flown again, until the samples that fail are known. Only these
    samples yield failed outcomes.

    Args:
        crew: crew that flies the batches.
        fly: function that returns the rows (n, columns) of n samples.
        batches: indices of the samples of each batch; a batch is requested when the crew has room for it.

    Raises:
        InputError: a drawn sample violates the limits of the scenario language.
        RuntimeError: every sample fails, with the error of the first; or the crew accepts no more batches.
    """
    fresh, halves = iter(batches), deque[Sequence[int]]()
    flown, failed_alone = False, 0
    for outcome in outcomes_of(crew, fly, lambda: halves.popleft() if halves else next(fresh, None)):
        if outcome.reason and len(outcome.given) > 1:
            middle = len(outcome.given) // 2
            halves.extendleft((outcome.given[middle:], outcome.given[:middle]))
            continue
        flown, failed_alone = flown or not outcome.reason, failed_alone + bool(outcome.reason)
        if not flown and failed_alone == _MAX_FAILURES:
            raise RuntimeError(f"the first {_MAX_FAILURES} samples that were flown alone all failed: {outcome.reason}")
        yield outcome
