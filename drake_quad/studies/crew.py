"""Who flies the batches of a study, and what becomes of batches that fail."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError

# Where no sample has been flown yet and so many have failed, each flown alone, all would.
_HOPELESS = 8
_LONGEST_REASON = 300


class Outcome(NamedTuple):
    """What became of a task.

    Attributes:
        given: what its function was given; for a batch the numbers of its samples.
        result: what the function returned; for a batch its (n, columns) rows. None if it failed.
        reason: why it failed, in one line; empty if it did not.
        refused: whether it failed because something that a person wrote is wrong, so that all must end.
    """

    given: Any
    result: Any = None
    reason: str = ""
    refused: bool = False


def attempt(function: Callable[[Any], Any], given: Any) -> Outcome:
    """Does a task where it is to be done; whatever it raises, also to end its process, is an outcome."""
    try:
        return Outcome(given, function(given))
    except KeyboardInterrupt:
        raise
    except InputError as error:
        return Outcome(given, reason=str(error), refused=True)
    except BaseException as error:
        return failed(given, error)


def failed(given: Any, error: BaseException) -> Outcome:
    """The outcome of a task that ended with an error."""
    words = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
    return Outcome(given, reason=words if len(words) <= _LONGEST_REASON else f"{words[:_LONGEST_REASON]}...")


class Crew(ABC):
    """Those that do tasks: processes of this machine, the threads of an executor, the workers of a cluster.

    Attributes:
        num_workers: how many tasks they do at a time.
        capacity: how many they take at a time.
    """

    num_workers: int
    capacity: int

    @abstractmethod
    def begin(self, function: Callable[[Any], Any], given: Any) -> None:
        """Begins a task, which is to call a function with an argument; there must be room for it."""

    @abstractmethod
    def finished(self) -> list[Outcome]:
        """Waits until one of the tasks under way is done, or several, and returns what became of them."""

    @abstractmethod
    def give_up(self) -> None:
        """Gives up what is under way."""


class ExecutorCrew(Crew):
    """The workers of any executor of `concurrent.futures`.

    Args:
        executor: that does the tasks.
        num_workers: how many it does at a time.
    """

    def __init__(self, executor: Executor, num_workers: int) -> None:
        self.num_workers = num_workers
        self.capacity = 2 * num_workers  # one more each, so that none waits for this process
        self._executor = executor
        self._under_way: dict[Future[Outcome], Any] = {}

    def begin(self, function: Callable[[Any], Any], given: Any) -> None:
        """As `Crew.begin`."""
        self._under_way[self._executor.submit(attempt, function, given)] = given

    def finished(self) -> list[Outcome]:
        """As `Crew.finished`."""
        done, _ = wait(self._under_way, return_when=FIRST_COMPLETED)
        return [self._outcome(future, self._under_way.pop(future)) for future in done]

    @staticmethod
    def _outcome(future: Future[Outcome], given: Any) -> Outcome:
        try:
            return future.result()
        except Exception as error:  # its worker died, or could not read what it was sent
            return failed(given, error)

    def give_up(self) -> None:
        """As `Crew.give_up`, but an executor does not end what it has begun."""
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
        if not flown and failed_alone == _HOPELESS:
            raise RuntimeError(f"the first {_HOPELESS} samples that were flown alone all failed: {outcome.reason}")
        yield outcome
