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
from drake_quad.studies.worker_pool import Outcome, WorkerPool, failed_outcome, run_task

_MAX_COUNT = 2**31 - 1  # largest signed 32-bit integer


def check_counts(**counts: int) -> None:
    """Check that counts, given as keyword arguments, are between 1 and 2³¹ - 1.

    Raises:
        InputError: if a count is out of range.
    """
    for name, number in counts.items():
        if not 1 <= number <= _MAX_COUNT:
            raise InputError(f"{name} is {number}; it must be between 1 and {_MAX_COUNT}")


def num_cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_importable(functions: Mapping[str, Any]) -> None:
    """Check that worker processes can import the user's functions and classes.

    Args:
        functions: functions, classes, and instances of user-defined classes, by their names in error messages.

    Raises:
        InputError: if a function cannot be pickled, or is defined in an interactive session.
    """
    in_a_file = hasattr(sys.modules["__main__"], "__file__")
    for name, function in functions.items():
        try:
            pickle.dumps(function)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InputError(
                f"{name} cannot be sent to worker processes; define it as a function or class of a module: {error}"
            ) from None
        if getattr(function, "__module__", None) == "__main__" and not (in_a_file or _can_fork()):
            raise InputError(
                f"{name} is defined in an interactive session, where worker processes cannot import it; move it to a"
                " file"
            )


def _can_fork() -> bool:
    return sys.platform == "linux" and threading.active_count() == 1


class Workers(WorkerPool):
    """Pool of processes on this machine, as a context manager that abandons the remaining tasks at its end.

    On Linux, if this process has a single thread, the workers are forked from it and inherit everything that it has
    loaded. Otherwise they are started as new processes, which takes two seconds. A process that has ended is replaced
    when there is another task.

    Args:
        num_workers: number of processes; by default, the number of cores.
        time_limit: time after which a task fails and its process is killed, s; unlimited by default.

    Raises:
        InputError: if the number of processes is out of range, or the time limit is not positive.
    """

    def __init__(self, num_workers: int | None = None, *, time_limit: float | None = None) -> None:
        self.num_workers = self.capacity = num_cores() if num_workers is None else num_workers
        check_counts(num_workers=self.num_workers)
        if time_limit is not None and not time_limit > 0.0:
            raise InputError(f"the time limit is {time_limit:g} s; it must be positive")
        self._time_limit = time_limit
        self._workers: list[_Worker] = []

    @property
    def forks_workers(self) -> bool:
        """True if no worker has been started yet and workers will be forked, so that they inherit all objects."""
        return not self._workers and _can_fork()

    def submit(self, function: Callable[[Any], Any], argument: Any) -> None:
        """Start a task, as `WorkerPool.submit` does."""
        worker = next((each for each in self._workers if not each.busy), None)
        if worker is None:
            worker = _Worker(self._time_limit)
            self._workers.append(worker)
        worker.submit(function, argument)

    def next_outcomes(self) -> list[Outcome]:
        """Wait for outcomes, as `WorkerPool.next_outcomes` does.

        Raises:
            RuntimeError: if a worker process ended before it was ready for its first task.
        """
        outcomes: list[Outcome] = []
        while not outcomes:
            busy = [worker for worker in self._workers if worker.busy]
            timeout = min(worker.time_left for worker in busy)
            waitables = [waitable for worker in busy for waitable in worker.waitables]
            wait(waitables, None if timeout == math.inf else timeout)
            outcomes = [outcome for worker in busy if (outcome := worker.outcome()) is not None]
            self._workers = [worker for worker in self._workers if not worker.ended]
        return outcomes

    def abandon(self) -> None:
        """Abandon all pending tasks, and kill the processes that run them."""
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
    """Process that runs one task at a time.

    Args:
        time_limit: time limit of a task, s; None if there is none.
    """

    def __init__(self, time_limit: float | None) -> None:
        self._time_limit = math.inf if time_limit is None else time_limit
        self._deadline = math.inf
        self._argument: Any = None
        self._is_ready = self.busy = self.ended = False
        context: Any = multiprocessing.get_context("fork" if _can_fork() else "spawn")
        self._pipe, child_pipe = context.Pipe()
        self.process = context.Process(target=_serve, args=(child_pipe,), daemon=True)
        with _interrupts_blocked():
            self.process.start()
        child_pipe.close()

    @property
    def waitables(self) -> list[Any]:
        """Objects for `multiprocessing.connection.wait`, ready when a message arrives or the process ends."""
        return [self._pipe, self.process.sentinel]

    @property
    def time_left(self) -> float:
        """Time that remains for the current task, s."""
        return max(self._deadline - time.monotonic(), 0.0)

    def submit(self, function: Callable[[Any], Any], argument: Any) -> None:
        """Send a task to the worker process."""
        self._argument, self.busy = argument, True
        self._deadline = time.monotonic() + self._time_limit
        with suppress(BrokenPipeError, ConnectionResetError):  # `outcome` reports that the process has ended
            self._pipe.send((function, argument))

    def outcome(self) -> Outcome | None:
        """Return the outcome of the current task; None if it is still running.

        A task fails if its process ends or its time limit is exceeded.

        Raises:
            RuntimeError: if the process ended before it was ready for its first task.
        """
        ended = not self.process.is_alive()
        try:
            while self._pipe.poll():
                outcome = self._pipe.recv()
                if outcome is not None:
                    self.busy = False
                    result: Outcome = outcome._replace(argument=self._argument)
                    return result
                self._is_ready = True
                self._deadline = time.monotonic() + self._time_limit
        except (EOFError, ConnectionResetError):
            ended = True
        if ended:
            self.end()
            if not self._is_ready:
                raise RuntimeError("a worker process ended before it was ready for its first task")
            return Outcome(self._argument, reason=f"the worker process ended {_cause(self.process.exitcode)}")
        if self.time_left == 0.0:
            self.end()
            return Outcome(self._argument, reason=f"exceeded the time limit of {self._time_limit:g} s")
        return None

    def end(self) -> None:
        """Kill the worker process."""
        self.process.kill()
        self.process.join()
        self._pipe.close()
        self.ended = True


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
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
        return f"due to the signal {signal.Signals(-exit_code).name}"
    return f"with exit status {exit_code}"


def _serve(pipe: Connection) -> None:
    """Run the tasks that arrive through a pipe, in the worker process.

    The process ignores Ctrl-C, which the parent process handles, and ends when its parent ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    gc.freeze()  # excludes inherited objects from garbage collection, so that their memory remains shared
    pipe.send(None)
    while True:
        try:
            function, argument = pipe.recv()
        except EOFError:
            return
        except Exception as error:  # for example, the function cannot be imported in this process
            pipe.send(failed_outcome(None, error))
        else:
            pipe.send(run_task(function, argument)._replace(argument=None))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
