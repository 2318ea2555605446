"""Worker processes on this machine."""

import gc
import math
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from drake_quad.errors import InputError
from drake_quad.studies.crew import Crew, Outcome, attempt, failed

_MAX_COUNT = 2**31 - 1


def check_counts(**counts: int) -> None:
    """Check that numbers, such as that of samples, are between 1 and 2³¹ - 1.

    Raises:
        InputError: a number is out of range.
    """
    for name, number in counts.items():
        if not 1 <= number <= _MAX_COUNT:
            raise InputError(f"{name} is {number}, but must be between 1 and {_MAX_COUNT}")


def num_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_makers(makers: Mapping[str, Callable[..., Any] | None]) -> None:
    """Check that worker processes can import the user's functions or classes.

    Raises:
        InputError: a function cannot be pickled, or is defined in an interactive session.
    """
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


class Workers(Crew):
    """Crew of processes on this machine, as a context manager that abandons the remaining tasks at its end.

    On Linux, if this process has a single thread, the workers are forked from it and inherit everything that it has
    loaded. Otherwise they are started as new processes, which takes two seconds. A process that has ended is replaced
    when there is another task.

    Args:
        num_workers: number of processes; the number of cores if not given.
        time_limit: time after which a task fails and its process is ended, s; unlimited if not given.

    Raises:
        InputError: the number of processes is out of range, or the time limit is not positive.
    """

    def __init__(self, num_workers: int | None = None, *, time_limit: float | None = None) -> None:
        self.num_workers = self.capacity = num_cores() if num_workers is None else num_workers
        check_counts(workers=self.num_workers)
        if time_limit is not None and not time_limit > 0.0:
            raise InputError(f"the time limit is {time_limit:g} s, but must be larger than 0")
        self._time_limit = time_limit
        self._workers: list[_Worker] = []

    @property
    def inherit(self) -> bool:
        """True if no process has been started and new ones will be forked, so that they inherit this one's objects."""
        return not self._workers and _can_fork()

    def begin(self, function: Callable[[Any], Any], given: Any) -> None:
        """Begin a task, as `Crew.begin` does."""
        worker = next((each for each in self._workers if not each.busy), None)
        if worker is None:
            worker = _Worker(self._time_limit)
            self._workers.append(worker)
        worker.begin(function, given)

    def finished(self) -> list[Outcome]:
        """Wait for outcomes, as `Crew.finished` does.

        Raises:
            RuntimeError: a worker process ended before it was ready for its first task.
        """
        outcomes: list[Outcome] = []
        while not outcomes:
            busy = [worker for worker in self._workers if worker.busy]
            patience = min(worker.time_left for worker in busy)
            signs = [sign for worker in busy for sign in worker.signs]
            wait(signs, None if patience == math.inf else patience)
            outcomes = [outcome for worker in busy if (outcome := worker.outcome()) is not None]
            self._workers = [worker for worker in self._workers if not worker.ended]
        return outcomes

    def give_up(self) -> None:
        """Abandon all tasks, as `Crew.give_up` does, and kill the processes that do them."""
        for worker in self._workers:
            if worker.busy:
                worker.end()
        self._workers = [worker for worker in self._workers if not worker.ended]

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()
        self._workers = []


class _Worker:
    """Process that does one task at a time.

    Args:
        time_limit: time limit of a task, s; None if there is none.
    """

    def __init__(self, time_limit: float | None) -> None:
        self._time_limit = math.inf if time_limit is None else time_limit
        self._deadline = math.inf
        self._given: Any = None
        self._begun = self.busy = self.ended = False
        context: Any = multiprocessing.get_context("fork" if _can_fork() else "spawn")
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        with _interrupts_held_back():
            self.process.start()
        theirs.close()

    @property
    def signs(self) -> list[Any]:
        """Objects for `multiprocessing.connection.wait`, ready if there is a message or the process has ended."""
        return [self._pipe, self.process.sentinel]

    @property
    def time_left(self) -> float:
        """Time that remains for the current task, s."""
        return max(self._deadline - time.monotonic(), 0.0)

    def begin(self, function: Callable[[Any], Any], given: Any) -> None:
        """Send a task to the process."""
        self._given, self.busy = given, True
        self._deadline = time.monotonic() + self._time_limit
        with suppress(BrokenPipeError, ConnectionResetError):  # the process has ended, which `outcome` reports
            self._pipe.send((function, given))

    def outcome(self) -> Outcome | None:
        """Return the outcome of the current task; None if it is still under way.

        A task fails if its process ends or its time limit is exceeded.

        Raises:
            RuntimeError: the process ended before it was ready for its first task.
        """
        ended = not self.process.is_alive()
        try:
            while self._pipe.poll():
                outcome = self._pipe.recv()
                if outcome is not None:
                    self.busy = False
                    found: Outcome = outcome._replace(given=self._given)
                    return found
                self._begun = True
                self._deadline = time.monotonic() + self._time_limit
        except (EOFError, ConnectionResetError):
            ended = True
        if ended:
            self.end()
            if not self._begun:
                raise RuntimeError("the worker processes end as soon as they begin")
            return Outcome(self._given, reason=f"its worker process was ended {_cause(self.process.exitcode)}")
        if self.time_left == 0.0:
            self.end()
            return Outcome(self._given, reason=f"took longer than the time limit of {self._time_limit:g} s")
        return None

    def end(self) -> None:
        """Kill the process."""
        self.process.kill()
        self.process.join()
        self._pipe.close()
        self.ended = True


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Block SIGINT, so that Ctrl-C cannot interrupt the start of a process."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _cause(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        return f"by {signal.Signals(-exit_code).name}"
    return f"with exit status {exit_code}"


def _serve(pipe: Connection) -> None:
    """Do the tasks that arrive through a pipe.

    The process ignores Ctrl-C, which the parent handles, and ends when its parent ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    gc.freeze()  # the garbage collector ignores inherited objects, so that their memory remains shared
    pipe.send(None)
    while True:
        try:
            function, given = pipe.recv()
        except EOFError:
            return
        except Exception as error:  # for example, the function cannot be imported in this process
            pipe.send(failed(None, error))
        else:
            pipe.send(attempt(function, given)._replace(given=None))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
