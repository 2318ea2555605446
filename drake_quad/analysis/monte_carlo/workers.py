"""Worker processes, and what becomes of batches whose worker fails."""

import gc
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from typing import Any, NamedTuple

import numpy as np

from drake_quad.analysis.monte_carlo.worker import heed
from drake_quad.errors import InputError

_MOST = 2**31 - 1


def check_counts(**counts: int) -> None:
    """Raises InputError if one of these is no number of things that a study can have."""
    for name, number in counts.items():
        if not 1 <= number <= _MOST:
            raise InputError(f"{name} is {number}, but must be between 1 and {_MOST}")


def num_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_makers(makers: Mapping[str, Callable[..., Any] | None]) -> None:
    """Raises InputError if worker processes would not find one of these functions or classes."""
    in_a_file = hasattr(sys.modules["__main__"], "__file__")
    for name, maker in makers.items():
        try:
            pickle.dumps(maker)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InputError(
                f"{name} cannot be sent to worker processes, but must be a function or class of a module: {error}"
            ) from None
        if getattr(maker, "__module__", None) == "__main__" and not (in_a_file or _can_fork()):
            raise InputError(f"{name} is known to this session only, but worker processes need it in a module")


def _can_fork() -> bool:
    return sys.platform == "linux" and threading.active_count() == 1


class Workers:
    """Processes on this machine that fly batches, as a context manager; what is under way at its end is given up.

    They are forked from this process where that is safe, with all that it has loaded: on Linux, while it has a single
    thread. Elsewhere they begin anew, which takes two seconds.

    Args:
        num_workers: how many; as many as there are cores if not given.

    Raises:
        InputError: that is no number of processes.
    """

    def __init__(self, num_workers: int | None = None) -> None:
        self.num_workers = num_cores() if num_workers is None else num_workers
        check_counts(workers=self.num_workers)
        self._forks = _can_fork()
        self._context = multiprocessing.get_context("fork" if self._forks else "spawn")
        self._stop = self._context.Event()
        self._pool: ProcessPoolExecutor | None = None

    @property
    def inherit(self) -> bool:
        """Whether the processes are still to begin, with what this one has by then."""
        return self._forks and self._pool is None

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """As `concurrent.futures.Executor.submit`, with new processes if one of the old ones has ended."""
        for _ in range(2):
            if self._pool is None:
                self._pool = ProcessPoolExecutor(
                    self.num_workers, self._context, initializer=_begin, initargs=(self._stop,)
                )
            try:
                return self._pool.submit(function, *arguments)
            except BrokenExecutor:
                self._pool.shutdown(wait=True)  # no thread of it may be left when the next processes are forked
                self._pool = None
        raise BrokenExecutor("the worker processes end as soon as they begin")

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)


def _begin(stop: Any) -> None:
    """Readies a worker process: it leaves Ctrl-C to its parent, and ends when its parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    heed(stop)
    gc.freeze()  # what came with the fork is not looked through again, and stays shared


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


class Outcome(NamedTuple):
    """What became of a batch.

    Attributes:
        samples: of the batch.
        rows: (n, columns) of them, if it was flown.
        reason: why it could not be, else.
    """

    samples: Sequence[int]
    rows: np.ndarray | None
    reason: str


def fly_batches(
    submit: Callable[..., Future[Any]],
    function: Callable[[Sequence[int]], np.ndarray],
    batches: Sequence[Sequence[int]],
    *,
    at_once: int,
) -> Iterator[Outcome]:
    """Flies batches and yields what becomes of them, in the order in which they are done.

    A batch that fails is flown once more, alone: a worker that ends takes down what others have under way, and so it
    is clear whose fault it was.

    Args:
        submit: that of an executor.
        function: flies a batch.
        batches: numbers of samples.
        at_once: how many batches to have with the executor at a time.

    Raises:
        InputError: a sample is not what the scenario may say.
    """
    waiting, suspects = deque(batches), deque[Sequence[int]]()
    under_way: dict[Future[Any], tuple[Sequence[int], bool]] = {}
    try:
        while waiting or suspects or under_way:
            if suspects and not under_way:
                samples = suspects.popleft()
                under_way[submit(function, samples)] = samples, True
            while waiting and not suspects and len(under_way) < at_once:
                samples = waiting.popleft()
                under_way[submit(function, samples)] = samples, False
            done, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for future in done:
                samples, again = under_way.pop(future)
                try:
                    yield Outcome(samples, future.result(), "")
                except InputError:
                    raise
                except Exception as error:
                    if again:
                        yield Outcome(samples, None, f"{type(error).__name__}: {error}")
                    else:
                        suspects.append(samples)
    finally:
        for future in under_way:
            future.cancel()
