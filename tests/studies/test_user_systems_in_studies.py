"""Tests that studies refuse user systems with inconsistent results, and end user systems that hang."""

import functools
import multiprocessing
import os
import signal
import sys
import time
from multiprocessing import connection

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import InputError, load_scenario, read_study, run_monte_carlo, simulate
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.studies import processes as workers_module
from drake_quad.studies.flying import BatchJob, code_versions, fly_batch
from drake_quad.studies.processes import Workers

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="worker processes find these classes by a fork")


class UserController(LeafSystem):
    """PD controller of a user, for N vehicles."""

    def __init__(self, num_vehicles):
        super().__init__()
        self.num_vehicles = num_vehicles
        self._measurement = self.DeclareVectorInputPort("measurement", BasicVector(12 * num_vehicles))
        self._reference = self.DeclareVectorInputPort("reference", BasicVector(11 * num_vehicles))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(3 * num_vehicles), self.calc)

    def calc(self, context, output):
        x = self._measurement.Eval(context).reshape(12, -1)
        r = self._reference.Eval(context).reshape(11, -1)
        output.SetFromVector(self.command(context.get_time(), r[:3] - x[:3], r[3:6] - x[6:9]).ravel())

    def command(self, time, error, rate):
        return 1.2 * error + 1.6 * rate


class RememberingController(UserController):
    """Controller with an integral in the Python object, which is not reset between flights."""

    def __init__(self, num_vehicles):
        super().__init__(num_vehicles)
        self.integral = np.zeros((3, num_vehicles))

    def command(self, time, error, rate):
        self.integral += 0.02 * error
        return super().command(time, error, rate) + 0.5 * self.integral


class MixingController(UserController):
    """Controller that confuses rows and columns, so that it is correct only for one vehicle."""

    def command(self, time, error, rate):
        return super().command(time, error, rate).T.reshape(3, -1)


class NondeterministicController(UserController):
    """Controller with noise that does not depend on the seed."""

    def command(self, time, error, rate):
        return super().command(time, error, rate) + np.random.default_rng().normal(scale=1e-3, size=error.shape)


class ExitingController(UserController):
    """Controller that exits the program, except in a small fleet."""

    def command(self, time, error, rate):
        if self.num_vehicles > 3 and time > 0.1:
            sys.exit(3)
        return super().command(time, error, rate)


class RaisingController(UserController):
    """Controller with an error that appears in flight, in fleets of more than a given number of vehicles."""

    def __init__(self, num_vehicles, largest=0):
        super().__init__(num_vehicles)
        self.largest = largest

    def command(self, time, error, rate):
        if self.num_vehicles > self.largest and time > 0.1:
            raise KeyError("gain")
        return super().command(time, error, rate)


class HangingController(UserController):
    """Controller that writes a file and hangs, in large fleets only."""

    def __init__(self, num_vehicles, file):
        super().__init__(num_vehicles)
        self.file = file

    def command(self, time, error, rate):
        if self.num_vehicles > 3 and time > 0.1:
            self.file.touch()
            while True:
                pass
        return super().command(time, error, rate)


def study():
    return load_scenario("diagrams/robustness.yaml", ["duration=0.4"])


def run(**options):
    return run_monte_carlo(study(), 8, 5, **{"num_workers": 2, "batch_size": 4, **options})


@pytest.mark.long
def test_a_user_s_controller_gives_each_sample_the_same_result_in_a_study_and_in_a_single_flight():
    result = run(position_controller=UserController)
    single_metrics = simulate(study(), seed=5, sample=6, position_controller=UserController(1)).metrics
    np.testing.assert_allclose([values[6] for values in result.metrics], single_metrics, rtol=1e-9)
    assert not result.failures


@pytest.mark.long
@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (
            RememberingController,
            r"sample 0 .* flown again in the same diagram; position_controller must store all state in Drake's context",
        ),
        (NondeterministicController, r"sample 0 .* flown again in the same diagram"),
        (
            MixingController,
            r"sample 0 .* flown together with other samples; position_controller must not mix the columns",
        ),
    ],
)
def test_a_system_with_inconsistent_results_is_refused_before_anything_is_written(controller, words, tmp_path):
    with pytest.raises(InputError, match=words):
        run(position_controller=controller, folder=tmp_path / "study")
    assert not (tmp_path / "study").exists()


@pytest.mark.slow
def test_a_system_whose_code_fails_is_refused_with_its_file_and_line(tmp_path):
    with pytest.raises(InputError, match=r"^\S*test_user_systems_in_studies\.py:\d+: KeyError: 'gain'$"):
        run(position_controller=RaisingController, folder=tmp_path / "study")
    assert not (tmp_path / "study").exists()


@pytest.mark.long
def test_code_that_fails_after_the_trial_fails_its_batch_but_not_the_study():
    result = run(position_controller=functools.partial(RaisingController, largest=3))
    assert not result.failures


@pytest.mark.long
def test_a_system_that_mixes_the_columns_of_vehicles_is_accepted_in_batches_of_one():
    assert not run(position_controller=MixingController, batch_size=1).failures


def test_a_system_that_cannot_be_connected_is_refused():
    with pytest.raises(InputError, match="position_controller has no output port|position_controller must have"):
        run(position_controller=LeafSystemOf)


def LeafSystemOf(num_vehicles):
    return LeafSystem()


@pytest.mark.long
def test_system_exit_fails_a_batch_but_not_the_study():
    """The batches of four fail, but their halves fly."""
    result, expected = run(position_controller=ExitingController), run(position_controller=UserController)
    assert not result.failures
    np.testing.assert_allclose(result.metrics.rmse, expected.metrics.rmse, rtol=1e-12)


def run_interruptible(**options):
    # Background processes of a shell ignore interrupts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    run(**options)


@pytest.mark.long
def test_ctrl_c_ends_a_study_whose_controller_hangs(tmp_path):
    file, folder = tmp_path / "hangs", tmp_path / "study"
    maker = functools.partial(HangingController, file=file)
    process = multiprocessing.get_context("fork").Process(
        target=run_interruptible, kwargs={"position_controller": maker, "folder": folder}
    )
    process.start()
    while not file.exists():
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGINT)
    process.join()  # without the interrupt, the process would run forever
    assert process.exitcode == 1
    assert len(read_study(folder).samples) == 0


@pytest.mark.long
def test_a_time_limit_ends_a_batch_that_hangs(tmp_path, monkeypatch):
    """After the time limit, the study flies the two halves of the batch, which do not hang.

    A fake clock exceeds the time limit as soon as a task hangs, so the test does not depend on the machine.
    """
    file = tmp_path / "hangs"

    class Clock:
        @staticmethod
        def monotonic():
            if file.exists():
                Clock.offset += 1000.0
                file.unlink()
            return time.monotonic() + Clock.offset

        offset = 0.0

    monkeypatch.setattr(workers_module, "time", Clock)
    monkeypatch.setattr(workers_module, "wait", lambda waitables, _: connection.wait(waitables, 0.05))
    maker = functools.partial(HangingController, file=file)
    result = run(position_controller=maker, num_workers=1, time_limit=500.0)
    assert not result.failures
    np.testing.assert_allclose(result.metrics.rmse, run(position_controller=UserController).metrics.rmse, rtol=1e-12)


def test_a_time_limit_cannot_be_combined_with_an_executor():
    with Workers(1) as workers, pytest.raises(InputError, match="a time limit"):
        run(executor=workers, time_limit=5.0)
    with pytest.raises(InputError, match="the time limit is 0 s; it must be positive"):
        run(time_limit=0.0)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("sources", "a different version of drake_quad's source files"),
        ("numpy", r"numpy [\d.]+, not 1\.2\.3"),
        ("user_systems", "different source files of the user's systems"),
    ],
)
def test_a_worker_with_different_code_refuses_to_fly(code, words):
    job = BatchJob("key", {**code_versions(UserSystems()), code: "1.2.3"}, study(), None, 1, UserSystems(), True)
    with pytest.raises(InputError, match=f"a worker on .* has {words}"):
        fly_batch(job, [0])
