"""Tests of worker pools and of the handling of failed batches."""

import re
import threading
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_quad import InputError, load_scenario, run_monte_carlo, user_code
from drake_quad.studies.processes import Workers
from drake_quad.studies.worker_pool import ExecutorPool, Outcome, WorkerPool, fly_batches, run_task

pytestmark = pytest.mark.usefixtures("package_functions")


class InProcessPool(WorkerPool):
    """Pool that runs tasks in this process, in order; `capacity` tasks may be pending."""

    num_workers = 2

    def __init__(self, capacity):
        self.capacity, self.in_transit, self.done = capacity, [], []

    def submit(self, function, argument):
        assert len(self.in_transit) < self.capacity
        self.in_transit.append((function, argument))

    def next_outcomes(self):
        function, samples = self.in_transit.pop(0)
        self.done.append(list(samples))
        return [run_task(function, samples)]

    def abandon(self):
        self.in_transit.clear()


def fly(failing):
    def flown(samples):
        if failing & set(samples):
            raise ArithmeticError("no flight")
        return np.array([[sample] for sample in samples])

    return flown


@given(st.sets(st.integers(0, 39), max_size=7), st.integers(1, 40), st.integers(1, 5))
def test_exactly_the_samples_that_fail_in_single_flights_are_failures(failing, size, capacity):
    pool = InProcessPool(capacity)
    batches = [range(first, min(first + size, 40)) for first in range(0, 40, size)]
    outcomes = list(fly_batches(pool, fly(failing), batches))
    assert sorted(sample for outcome in outcomes if outcome.reason for sample in outcome.argument) == sorted(failing)
    flown = [sample for outcome in outcomes if not outcome.reason for sample in outcome.result[:, 0]]
    assert sorted(flown) == sorted(set(range(40)) - failing)
    # A failing sample causes at most two further flights each time that its batch is halved.
    assert len(pool.done) <= len(batches) + 2 * len(failing) * int(np.ceil(np.log2(max(size, 2))) + 1)


def test_a_failing_batch_is_halved_down_to_single_samples():
    pool = InProcessPool(1)
    list(fly_batches(pool, fly({5}), [range(8)]))
    assert pool.done == [[*range(8)], [0, 1, 2, 3], [4, 5, 6, 7], [4, 5], [4], [5], [6, 7]]


def test_a_study_ends_after_eight_failures_of_single_samples_without_a_success():
    pool = InProcessPool(3)
    with pytest.raises(
        RuntimeError, match="the first 8 samples all failed, each flown alone: ArithmeticError: no flight"
    ):
        list(fly_batches(pool, fly(set(range(40))), [range(40)]))
    assert sum(len(samples) == 1 for samples in pool.done) == 8
    failures = [
        outcome for outcome in fly_batches(InProcessPool(3), fly(set(range(39))), [[39], range(39)]) if outcome.reason
    ]
    assert len(failures) == 39


def invalid_input(samples):
    raise InputError(f"samples {[*samples]} are not allowed")


def exit_program(samples):
    raise SystemExit(3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [lambda: InProcessPool(2), lambda: ExecutorPool(ThreadPoolExecutor(1), 1), lambda: Workers(1)]
)
def test_invalid_input_in_a_sample_ends_the_study(make):
    pool = make()
    with pytest.raises(InputError, match=r"samples \[0\] are not allowed"):
        list(fly_batches(pool, invalid_input, [[0], [1]]))
    pool.abandon()


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [lambda: InProcessPool(2), lambda: ExecutorPool(ThreadPoolExecutor(1), 1), lambda: Workers(1)]
)
def test_a_task_that_raises_system_exit_is_reported_as_failed(make):
    pool = make()
    (outcome,) = fly_batches(pool, exit_program, [[4]])
    assert (outcome.argument, outcome.result) == ([4], None)
    # The fixture `package_functions` is not active in a new process, where file and line precede the message.
    assert re.fullmatch(r"(\S*test_worker_pool\.py:\d+: )?SystemExit: 3", outcome.reason)
    pool.abandon()


def test_a_given_executor_flies_all_batches():
    submitted = []

    class Executor(ThreadPoolExecutor):
        def submit(self, function, /, *arguments, **options):
            submitted.append(function)
            return super().submit(function, *arguments, **options)

    scenario = load_scenario("diagrams/hover.yaml", ["duration=0.1"])
    with Executor(1) as executor:
        assert len(run_monte_carlo(scenario, 4, batch_size=2, executor=executor).samples) == 4
    assert len(submitted) == 2


def test_the_reason_for_a_failure_is_shortened_to_one_line():
    def fail(samples):
        raise ValueError("many\nlines " + "and words " * 100)

    outcome = run_task(fail, [0])
    assert outcome.reason.startswith("ValueError: many lines and words and words")
    assert len(outcome.reason) <= 303
    assert outcome.reason.endswith("...")


@pytest.mark.parametrize(("length", "expected_length"), [(288, 300), (289, 303)])
def test_the_reason_for_a_failure_is_shortened_only_beyond_300_characters(length, expected_length):
    def fail(samples):
        raise ValueError("x" * length)

    outcome = run_task(fail, [0])
    assert len(outcome.reason) == expected_length
    assert outcome.reason.removesuffix("...") == ("ValueError: " + "x" * length)[:300]


def test_an_error_without_a_message_is_described_by_its_name():
    def fail(samples):
        raise ArithmeticError

    assert run_task(fail, [4]) == Outcome([4], reason="ArithmeticError")


def test_ctrl_c_is_not_an_outcome():
    def interrupt(samples):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_task(interrupt, [0])


def test_an_executor_has_one_queued_task_per_worker():
    pool = ExecutorPool(ThreadPoolExecutor(3), 3)
    assert (pool.num_workers, pool.capacity) == (3, 6)


def test_a_dying_worker_of_an_executor_fails_its_task():
    class DyingExecutor(Executor):
        def submit(self, function, /, *arguments):
            future = Future()
            if arguments[1] == [2]:
                future.set_exception(OSError("its worker is gone"))
            else:
                future.set_result(function(*arguments))
            return future

    pool = ExecutorPool(DyingExecutor(), 1)
    outcomes = list(fly_batches(pool, len, [[1], [2], [3]]))
    reasons = sorted((outcome.argument, outcome.result, outcome.reason) for outcome in outcomes if outcome.reason)
    assert reasons == [([2], None, "OSError: its worker is gone")]
    assert sorted(outcome.argument for outcome in outcomes if not outcome.reason) == [[1], [3]]


def test_abandoned_tasks_of_an_executor_are_cancelled():
    done, may_end, has_begun = [], threading.Event(), threading.Event()

    def wait_and_tell(argument):
        has_begun.set()
        may_end.wait(20.0)
        done.append(argument)
        return argument

    with ThreadPoolExecutor(1) as executor:
        pool = ExecutorPool(executor, 1)
        pool.submit(wait_and_tell, 1)
        assert has_begun.wait(20.0)
        pool.submit(wait_and_tell, 2)
        pool.abandon()
        pool.submit(wait_and_tell, 3)
        may_end.set()
        (outcome,) = pool.next_outcomes()
        assert (outcome.argument, outcome.result) == (3, 3)
    assert done == [1, 3]


def test_tasks_that_are_done_at_the_same_time_have_outcomes_in_the_order_of_submission():
    with ThreadPoolExecutor(1) as executor:
        pool = ExecutorPool(executor, 16)
        for argument in range(32):
            pool.submit(abs, argument)
    assert [outcome.argument for outcome in pool.next_outcomes()] == [*range(32)]


@pytest.mark.long
def test_abandoned_tasks_have_no_outcome():
    """A study that ends early leaves no outcomes for the next study with the same processes."""
    with Workers(2) as workers:
        for _ in range(2):
            workers.submit(sleep_for_ever, [1])
        workers.abandon()
        assert [outcome.argument for outcome in fly_batches(workers, np.array, [[7]])] == [[7]]


def sleep_for_ever(samples):
    while True:
        pass


@pytest.mark.parametrize("kind", [ArithmeticError, InputError])
def test_the_reason_for_a_failure_in_the_user_s_code_begins_with_file_and_line(monkeypatch, kind):
    monkeypatch.setattr(user_code, "_LIBRARIES", ())

    def fail(samples):
        raise kind("bad")

    outcome = run_task(fail, [4])
    assert re.fullmatch(r".*test_worker_pool\.py:\d+: (ArithmeticError: )?bad", outcome.reason)
    assert outcome.in_user_code or outcome.invalid_input
