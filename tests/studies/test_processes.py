"""Tests of worker processes."""

import functools
import gc
import math
import multiprocessing
import os
import signal
import sys
import time
import types
from pathlib import Path

import pytest

from drake_quad import InputError
from drake_quad.studies import processes
from drake_quad.studies.processes import Workers, _Worker, check_counts, check_importable, num_cores
from drake_quad.studies.worker_pool import Outcome

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="worker processes find these functions by a fork")


class Clock:
    """Clock that does not advance by itself."""

    def __init__(self):
        self.now = 50.0

    def monotonic(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    result = Clock()
    monkeypatch.setattr(processes, "time", result)
    return result


def submit_and_wait(workers, function, argument):
    """Submit a task to worker processes, wait, and return the outcomes of the tasks that have ended."""
    workers.submit(function, argument)
    return workers.next_outcomes()


def process_number(_):
    return os.getpid()


def wait_for_other_process(folder):
    """Create a file, and wait for a file of another process."""
    (folder / str(os.getpid())).touch()
    while len(list(folder.iterdir())) < 2:
        time.sleep(0.005)
    return os.getpid()


def run_forever(_):
    while True:
        time.sleep(0.01)


def exit_process(status):
    os._exit(status)


def signal_handler_and_freeze_count(_):
    return signal.getsignal(signal.SIGINT), gc.get_freeze_count()


class Unreadable:
    """Object that can be pickled but not unpickled."""

    def __reduce__(self):
        return fail_to_load, ("the sheet is torn",)


def fail_to_load(words):
    raise ArithmeticError(words)


@pytest.mark.parametrize("number", [1, 7, 2147483647])
def test_counts_in_range_are_accepted(number):
    check_counts(samples=number)


@pytest.mark.parametrize("number", [-1, 0, 2147483648])
def test_counts_out_of_range_are_named(number):
    with pytest.raises(InputError, match=f"batch_size is {number}; it must be between 1 and 2147483647"):
        check_counts(num_samples=3, batch_size=number)


def test_only_available_cores_are_counted(monkeypatch):
    assert num_cores() == len(os.sched_getaffinity(0))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3, 5})
    assert (num_cores(), Workers().num_workers, Workers().capacity, Workers(5).capacity) == (3, 3, 3, 5)
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    assert num_cores() == 6
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert num_cores() == 1


def test_functions_of_an_interactive_session_require_a_fork(monkeypatch):
    """A spawned process can import a function of a script, but not of a notebook."""
    session = types.ModuleType("__main__")
    exec("def maker(num_vehicles): return None", session.__dict__)
    monkeypatch.setitem(sys.modules, "__main__", session)
    for file, fork, is_accepted in ((None, True, True), ("a.py", False, True), (None, False, False)):
        monkeypatch.setattr(processes, "_can_fork", lambda fork=fork: fork)
        if file is not None:
            session.__file__ = file
        elif hasattr(session, "__file__"):
            del session.__file__
        check_importable({"wind": None, "control": process_number})
        if is_accepted:
            check_importable({"wind": session.maker})
        else:
            with pytest.raises(InputError, match="wind is defined in an interactive session"):
                check_importable({"control": process_number, "wind": session.maker})


def test_processes_are_forked_on_linux_only(monkeypatch):
    assert Workers(1).forks_workers
    monkeypatch.setattr(sys, "platform", "darwin")
    assert not Workers(1).forks_workers


@pytest.mark.parametrize(("fork", "method"), [(True, "fork"), (False, "spawn")])
def test_workers_are_spawned_where_they_cannot_be_forked(monkeypatch, fork, method):
    requested_methods, context = [], multiprocessing.get_context("fork")
    monkeypatch.setattr(processes, "_can_fork", lambda: fork)
    monkeypatch.setattr(multiprocessing, "get_context", lambda name: requested_methods.append(name) or context)
    worker = _Worker(None)
    worker.end()
    assert requested_methods == [method]


@pytest.mark.parametrize("limit", [0.0, -2.0, math.nan])
def test_a_time_limit_must_be_positive(limit):
    with pytest.raises(InputError, match=f"the time limit is {limit:g} s; it must be positive"):
        Workers(1, time_limit=limit)


def test_idle_processes_are_reused_and_two_run_at_a_time(tmp_path):
    with Workers(2, time_limit=20.0) as workers:
        ((_, first_pid, *_),) = submit_and_wait(workers, process_number, None)
        assert not workers.forks_workers
        ((_, second_pid, *_),) = submit_and_wait(workers, process_number, None)
        assert first_pid == second_pid != os.getpid()
        for _ in range(2):
            workers.submit(wait_for_other_process, tmp_path)
        outcomes = workers.next_outcomes()
        while len(outcomes) < 2:
            outcomes += workers.next_outcomes()
        pids = {outcome.result for outcome in outcomes}
        assert len(pids) == 2
        assert first_pid in pids
        processes = [worker.process for worker in workers._workers]
        assert all(process.daemon and process.is_alive() for process in processes)
    assert [process.exitcode for process in processes] == [-signal.SIGKILL] * 2
    assert workers._workers == []


class FakeWorker:
    """Stub of a worker process with a given outcome."""

    def __init__(self, time_left, outcome, *, busy=True, ended=False):
        self.time_left, self.busy, self.ended, self._outcome = time_left, busy, ended, outcome
        self.waitables = [self, "sentinel"]

    def outcome(self):
        return self._outcome


def test_the_wait_ends_at_the_first_deadline(monkeypatch):
    waits = []
    monkeypatch.setattr(processes, "wait", lambda waitables, timeout: waits.append((waitables, timeout)))
    workers = Workers(4)
    late, early = FakeWorker(7.0, Outcome(1)), FakeWorker(2.5, Outcome(2), ended=True)
    idle, working = FakeWorker(0.5, Outcome(3), busy=False), FakeWorker(9.0, None)
    workers._workers = [late, early, idle, working]
    assert workers.next_outcomes() == [Outcome(1), Outcome(2)]
    assert waits == [([late, "sentinel", early, "sentinel", working, "sentinel"], 2.5)]
    assert workers._workers == [late, idle, working]
    workers._workers = [FakeWorker(math.inf, Outcome(4))]
    workers.next_outcomes()
    assert waits[-1][1] is None


def test_abandoning_tasks_keeps_idle_processes():
    with Workers(2) as workers:
        workers.submit(run_forever, 1)
        ((argument, *_),) = submit_and_wait(workers, process_number, 2)
        assert argument == 2
        busy, idle = (worker.process for worker in workers._workers)
        workers.abandon()
        assert not busy.is_alive()
        assert [worker.process for worker in workers._workers] == [idle]
        assert idle.is_alive()


def test_the_time_limit_starts_when_the_process_is_ready(clock):
    worker = _Worker(10.0)
    try:
        assert worker.time_left == math.inf
        worker.submit(run_forever, "given")
        assert worker.time_left == 10.0
        clock.now = 54.0
        assert worker.time_left == 6.0
        assert worker._pipe.poll(20.0)
        assert worker.outcome() is None
        assert worker.time_left == 10.0
        clock.now = 63.75
        assert (worker.time_left, worker.outcome()) == (0.25, None)
        clock.now = 70.0
        assert worker.time_left == 0.0
        assert worker.outcome() == Outcome("given", reason="exceeded the time limit of 10 s")
        assert worker.ended
        assert worker._pipe.closed
        assert worker.process.exitcode == -signal.SIGKILL
    finally:
        worker.process.kill()


def test_without_a_time_limit_a_task_never_times_out(clock):
    worker = _Worker(None)
    try:
        worker.submit(run_forever, None)
        clock.now = 1e9
        assert (worker.time_left, worker.outcome()) == (math.inf, None)
    finally:
        worker.end()


def test_a_process_that_ends_fails_only_its_task():
    with Workers(1, time_limit=20.0) as workers:
        assert submit_and_wait(workers, exit_process, 7) == [
            Outcome(7, reason="the worker process ended with exit status 7")
        ]
        (outcome,) = submit_and_wait(workers, process_number, None)
        assert outcome.reason == ""


def test_a_process_that_ended_while_idle_fails_the_next_task():
    with Workers(1, time_limit=20.0) as workers:
        ((_, number, *_),) = submit_and_wait(workers, process_number, None)
        process = workers._workers[0].process
        os.kill(number, signal.SIGKILL)
        process.join()
        reason = "the worker process ended due to the signal SIGKILL"
        assert submit_and_wait(workers, process_number, 3) == [Outcome(3, reason=reason)]


def test_processes_that_end_at_once_are_not_restarted_forever(monkeypatch):
    monkeypatch.setattr(processes, "_serve", lambda pipe: None)
    with Workers(1, time_limit=20.0) as workers:
        workers.submit(process_number, None)
        with pytest.raises(RuntimeError, match="a worker process ended before it was ready"):
            workers.next_outcomes()


def test_a_task_that_cannot_be_unpickled_fails_and_the_process_continues():
    with Workers(1, time_limit=20.0) as workers:
        unreadable = Unreadable()
        (outcome,) = submit_and_wait(workers, process_number, unreadable)
        assert (outcome.argument, outcome.result) == (unreadable, None)
        assert outcome.reason.endswith(": ArithmeticError: the sheet is torn")
        ((_, number, *_),) = submit_and_wait(workers, process_number, None)
        assert number == workers._workers[0].process.pid


def test_a_worker_ignores_ctrl_c_and_excludes_inherited_objects_from_garbage_collection():
    with Workers(1, time_limit=20.0) as workers:
        ((_, (handler, frozen), *_),) = submit_and_wait(workers, signal_handler_and_freeze_count, None)
    assert handler == signal.SIG_IGN
    assert frozen > gc.get_freeze_count()
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler


def test_ctrl_c_is_blocked_while_a_process_starts():
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with processes._interrupts_blocked():
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


class Pipe:
    """Stub of the end of a pipe, which receives the given messages and is then closed."""

    def __init__(self, *messages):
        self.waiting, self.sent = [*messages], []

    def recv(self):
        if not self.waiting:
            raise EOFError
        return self.waiting.pop(0)

    def send(self, message):
        self.sent.append(message)


def test_a_process_ends_when_its_pipe_is_closed(monkeypatch):
    """The process first returns the outcome of its task, without the argument, which the parent process already has."""
    monkeypatch.setattr(processes, "_end_with_parent", lambda: None)
    pipe, previous_handler = Pipe((abs, -3)), signal.getsignal(signal.SIGINT)
    try:
        processes._serve(pipe)
    finally:
        signal.signal(signal.SIGINT, previous_handler)
    assert pipe.sent == [None, Outcome(None, 3)]


def start_endless_task(file):
    """Start a worker with an endless task, and write the process number of the worker to a file."""
    with Workers(1) as workers:
        workers.submit(run_forever, None)
        assert workers._workers[0]._pipe.poll(20.0)
        file.with_suffix(".part").write_text(str(workers._workers[0].process.pid))
        file.with_suffix(".part").rename(file)
        workers.next_outcomes()


def ends_within_ten_seconds(pid):
    """Return True if a process ends within ten seconds."""
    for _ in range(1000):
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX":
                return True
        except (FileNotFoundError, ProcessLookupError):
            return True
        time.sleep(0.01)
    return False


def test_a_busy_process_ends_with_its_parent(tmp_path):
    file = tmp_path / "worker"
    parent = multiprocessing.get_context("fork").Process(target=functools.partial(start_endless_task, file))
    parent.start()
    while not file.exists():
        time.sleep(0.005)
    parent.kill()
    parent.join()
    assert ends_within_ten_seconds(int(file.read_text()))
