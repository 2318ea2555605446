"""Tests that studies are reproducible and survive failures."""

import multiprocessing
import os
import shutil
import signal
import threading
import time
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import InputError, load_scenario, simulate
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.studies import flying
from drake_quad.studies import monte_carlo as run_module
from drake_quad.studies.flying import BatchJob, build_fleet, fly_batch, fly_trial
from drake_quad.studies.monte_carlo import run_monte_carlo
from drake_quad.studies.processes import Workers
from drake_quad.studies.results_file import read_results, write_results
from drake_quad.studies.study import read_record, read_study, study_columns, study_row_format
from drake_quad.studies.study_folder import StudyInterrupted, open_study
from drake_quad.studies.worker_pool import Outcome, WorkerPool, size_of_batches

pytestmark = pytest.mark.usefixtures("package_functions")


class TimeVaryingWind(LeafSystem):
    """Wind that varies with time and is equal for all vehicles."""

    def __init__(self, num_vehicles):
        super().__init__()
        self.num_vehicles = num_vehicles
        self.DeclareVectorOutputPort("wind", BasicVector(3 * num_vehicles), self.set_velocity)

    def set_velocity(self, context, output):
        output.SetFromVector(np.repeat([np.sin(8.0 * context.get_time()), 0.5, 0.0], self.num_vehicles))


NUM_SAMPLES = 24  # samples of a study
OVERRIDES = ["duration=0.4", "crash.position_error=0.018"]


def study(*overrides):
    return load_scenario("diagrams/robustness.yaml", [*OVERRIDES, *overrides])


def uncompiled_scenario():
    """Return a scenario with few systems, for uncompiled studies."""
    return load_scenario("figure_eight", ["duration=0.4", "vehicle.linear_drag={uniform: {min: 0.1, max: 0.2}}"])


def run(folder=None, num_samples=NUM_SAMPLES, **options):
    return run_monte_carlo(study(), num_samples, 5, **{"folder": folder, "num_workers": 2, "batch_size": 5, **options})


def assert_same(result, expected):
    np.testing.assert_array_equal(result.samples, expected.samples)
    for name, values in expected.parameters.items():
        np.testing.assert_allclose(result.parameters[name], values, rtol=1e-9)
    for actual_values, expected_values in zip(result.metrics, expected.metrics, strict=True):
        np.testing.assert_allclose(actual_values, expected_values, rtol=1e-9)


@pytest.fixture(scope="module")
def reference_study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    result = run(folder)
    return folder, result


@pytest.mark.long
def test_some_samples_crash_and_others_do_not(reference_study):
    assert 3 < reference_study[1].metrics.crashed.sum() < NUM_SAMPLES - 3
    crashes = reference_study[1].metrics.crashed.sum()
    words = f"<Study of robustness: {NUM_SAMPLES} samples, {crashes} crashed; drawn fields: vehicle.mass, "
    assert repr(reference_study[1]).startswith(words)


@pytest.mark.long
@pytest.mark.parametrize("options", [{"batch_size": 1}, {"batch_size": 7, "num_workers": 1}, {"batch_size": None}])
def test_results_do_not_depend_on_batches_and_workers(reference_study, options, tmp_path):
    assert_same(run(tmp_path, **options), reference_study[1])
    assert (tmp_path / "results.csv").read_bytes() == (reference_study[0] / "results.csv").read_bytes()


@pytest.mark.long
def test_a_user_s_wind_blows_in_every_worker():
    scenario = uncompiled_scenario()
    result = run_monte_carlo(scenario, 4, 5, num_workers=2, batch_size=2, wind=TimeVaryingWind)
    assert result.failures == {}
    single_metrics = simulate(scenario, seed=5, sample=3, wind=TimeVaryingWind(1), compiled=False).metrics
    assert result.metrics.rmse[3] == pytest.approx(single_metrics.rmse, rel=1e-9)
    calm = simulate(scenario, seed=5, sample=3).metrics
    assert result.metrics.rmse[3] != pytest.approx(calm.rmse, rel=1e-6)


def test_a_function_that_workers_cannot_import_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="position_controller cannot be sent to worker processes"):
        run(tmp_path, position_controller=lambda num_vehicles: None)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_results_do_not_depend_on_the_executor(reference_study):
    with ThreadPoolExecutor(2) as executor:
        assert_same(run(executor=executor), reference_study[1])
    with Workers(2) as workers:
        for _ in range(2):
            assert_same(run(executor=workers), reference_study[1])


def test_a_sample_flown_alone_has_the_same_metrics_as_in_the_study(reference_study):
    """The metrics agree within 1e-9, also for the first sample that crashes."""
    for sample in {0, int(np.argmin(reference_study[1].metrics.crash_time))}:
        single_flight = simulate(study(), seed=5, sample=sample, compiled=False)
        row = [values[sample] for values in reference_study[1].metrics]
        np.testing.assert_allclose(single_flight.metrics, row, rtol=1e-9)
        assert single_flight.scenario.vehicle.mass == pytest.approx(
            reference_study[1].parameters["vehicle.mass"][sample], rel=1e-12
        )


def test_a_study_read_from_its_folder_equals_the_flown_one(reference_study):
    assert_same(read_study(reference_study[0]), reference_study[1])
    assert read_study(reference_study[0]).scenario == study("seed=5")
    assert reference_study[1].simulated_time == pytest.approx(reference_study[1].flight_time.sum())


@pytest.mark.long
def test_a_resumed_study_can_have_more_samples(reference_study, tmp_path):
    progress_calls = []
    run(tmp_path, num_samples=9)
    result = run(tmp_path, resume=True, progress=lambda done, total: progress_calls.append((done, total)))
    assert (tmp_path / "results.csv").read_bytes() == (reference_study[0] / "results.csv").read_bytes()
    assert progress_calls[0] == (9, NUM_SAMPLES)
    assert progress_calls[-1] == (NUM_SAMPLES, NUM_SAMPLES)
    assert result.simulated_time == pytest.approx(reference_study[1].flight_time[9:].sum())
    assert run(tmp_path, resume=True).simulated_time == 0.0


def child_processes(pid):
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


def killing_progress(folder, count):
    """Return a progress function that prints the worker processes and kills its own process after some samples."""

    def progress(done, _):
        if done >= count:
            (folder / f"workers_at_{count}").write_text(" ".join(map(str, child_processes(os.getpid()))))
            os.kill(os.getpid(), signal.SIGKILL)

    return progress


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's /proc")
def test_a_killed_study_can_be_resumed_at_any_row(reference_study, tmp_path):
    """No sample is flown twice, no worker remains, and the file equals that of an undisturbed study."""
    context, folder = multiprocessing.get_context("fork"), tmp_path / "study"
    path, flown = folder / "results.csv", set()
    for count in (0, 1, 8, 24):
        options = {"resume": True, "batch_size": 2, "progress": killing_progress(tmp_path, count)}
        process = context.Process(target=run, args=(folder,), kwargs=options)
        process.start()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        flown_before, flown = flown, [int(line.split(",")[0]) for line in path.read_text().split("\n")[1:-1]]
        assert len(flown) == len(set(flown)) >= count
        assert set(flown) >= set(flown_before)
        workers = [int(worker) for worker in (tmp_path / f"workers_at_{count}").read_text().split()]
        assert workers or len(flown_before) == count
        assert _within_a_minute(lambda: not any(map(is_running, workers)))  # noqa: B023
    run(folder, resume=True)
    for name in ("results.csv", "scenario.yaml", "study.yaml"):
        assert (folder / name).read_bytes() == (reference_study[0] / name).read_bytes()


def _within_a_minute(condition):
    deadline = time.monotonic() + 60.0
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return condition()


@pytest.mark.long
def test_ctrl_c_keeps_completed_rows(reference_study, tmp_path):
    def interrupt(done, total):
        if 0 < done < total:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(StudyInterrupted, match=r"interrupted: \d+ of 24 samples are in .*results.csv"):
        run(tmp_path, progress=interrupt)
    assert 0 < len(read_study(tmp_path).samples) < NUM_SAMPLES
    run(tmp_path, resume=True)
    assert (tmp_path / "results.csv").read_bytes() == (reference_study[0] / "results.csv").read_bytes()


class FailingFlights:
    """Function that flies batches, but fails a number of times for batches with a certain sample."""

    def __init__(self, folder, failure, times):
        self.folder, self.failure, self.times = folder, failure, times

    def __call__(self, job, samples):
        if 7 in samples:
            attempt = len(list(self.folder.iterdir()))
            (self.folder / str(attempt)).touch()
            if attempt < self.times:
                if self.failure == "dies":
                    os.kill(os.getpid(), signal.SIGKILL)
                raise ArithmeticError("sample 7 failed")
        return fly_batch(job, samples)


@pytest.mark.slow
@pytest.mark.parametrize("failure", ["raises", "dies"])
def test_a_batch_that_fails_once_is_flown_again(reference_study, failure, tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "fly_batch", FailingFlights(tmp_path, failure, 1))
    result = run()
    assert_same(result, reference_study[1])
    assert not result.failures


@pytest.mark.long
@pytest.mark.parametrize(
    ("failure", "reason"),
    [("raises", "ArithmeticError: sample 7 failed"), ("dies", "the worker process ended due to the signal SIGKILL")],
)
def test_a_sample_that_always_fails_does_not_affect_the_others(reference_study, failure, reason, tmp_path, monkeypatch):
    """The batch of 5 is split into 2 and 3 samples, and the 3 samples are split again. A later run flies the sample."""
    attempts, folder = tmp_path / "attempts", tmp_path / "study"
    attempts.mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(run_module, "fly_batch", FailingFlights(attempts, failure, 99))
        result = run(folder)
    assert len(list(attempts.iterdir())) == 3
    assert result.failures == {7: reason}
    np.testing.assert_array_equal(result.samples, [*range(7), *range(8, NUM_SAMPLES)])
    assert (folder / "failed.csv").read_text() == f"sample,reason\n7,{reason}\n"
    run(folder, resume=True)
    assert (folder / "results.csv").read_bytes() == (reference_study[0] / "results.csv").read_bytes()
    assert not (folder / "failed.csv").exists()


def fail_always(job, samples):
    raise ArithmeticError(f"all {len(samples)} samples failed,\nwith a long message: {'x' * 1000}")


@pytest.mark.slow
def test_a_study_in_which_every_sample_fails_is_aborted(tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "fly_batch", fail_always)
    words = (
        r"the first 8 samples all failed, each flown alone: ArithmeticError: all 1 samples failed, with a long"
        r" message: x+\.\.\.; 0 of 24 samples are in .*results\.csv"
    )
    with pytest.raises(RuntimeError, match=words):
        run(tmp_path, num_workers=1)
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "alter",
    [
        lambda cells: [cells[0], str(float(cells[1]) + 1e-9), *cells[2:]],  # a drawn value
        lambda cells: [*cells[:-4], "0.123", *cells[-3:]],  # a metric
        lambda cells: ["17", *cells[1:]],  # the index of the sample
        lambda cells: ["3.5", *cells[1:]],
        lambda cells: ["-1", *cells[1:]],
        lambda cells: ["", *cells[1:]],
        lambda cells: [cells[0], *[""] * (len(cells) - 2), cells[-1]],
        lambda cells: cells[:-1],
        lambda cells: ["what"],
    ],
)
def test_altered_rows_are_detected_and_flown_again(reference_study, alter, tmp_path):
    """A file with an altered third row cannot be read; after the study is resumed, the file is complete."""
    shutil.copytree(reference_study[0], tmp_path, dirs_exist_ok=True)
    path = tmp_path / "results.csv"
    lines = path.read_text().splitlines()
    lines[3] = ",".join(alter(lines[3].split(",")))
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"results\.csv:4: the row was altered"):
        read_study(tmp_path)
    result = run(tmp_path, resume=True)
    assert list(result.invalid_lines) == [4]
    assert result.simulated_time == pytest.approx(reference_study[1].flight_time[2])
    assert path.read_bytes() == (reference_study[0] / "results.csv").read_bytes()
    assert not read_study(tmp_path).invalid_lines


def test_rows_whose_values_do_not_follow_from_the_seed_are_flown_again(reference_study, tmp_path):
    """Such rows have valid checksums; another version could have drawn their values."""
    shutil.copytree(reference_study[0], tmp_path, dirs_exist_ok=True)
    form = study_row_format(study("seed=5"))
    rows = read_results(tmp_path / "results.csv", form).rows
    rows[2, 1] *= 1.0 + 1e-9
    write_results(tmp_path / "results.csv", form, rows)
    with pytest.raises(InputError, match=r"csv:4:"):
        read_study(tmp_path)
    assert list(run(tmp_path, resume=True).invalid_lines) == [4]
    assert (tmp_path / "results.csv").read_bytes() == (reference_study[0] / "results.csv").read_bytes()


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("samples: 24", "samples: 3.5", "samples"),
        ("duration: 0.4", "duration: [", ""),
        ("versions:", "versions: 3\nx:", "versions"),
    ],
)
def test_an_invalid_record_is_refused(reference_study, old, new, field, tmp_path):
    shutil.copytree(reference_study[0], tmp_path, dirs_exist_ok=True)
    record = (tmp_path / "study.yaml").read_text()
    assert old in record
    (tmp_path / "study.yaml").write_text(record.replace(old, new))
    words = rf"is not the record of a study: {field} is missing or invalid" if field else "is not YAML"
    for attempt in (lambda: read_study(tmp_path), lambda: run(tmp_path, resume=True)):
        with pytest.raises(InputError, match=words):
            attempt()


@pytest.mark.parametrize("name", ["scenario.yaml", "study.yaml"])
def test_foreign_files_are_not_overwritten(name, tmp_path):
    (tmp_path / name).write_text("notes: of somebody\n")
    with pytest.raises(InputError, match=rf"{name} .* is not overwritten"):
        run(tmp_path)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "notes: of somebody\n")]


@pytest.mark.slow
def test_a_study_that_ended_before_its_first_row_can_be_started_again(reference_study, tmp_path):
    for names in (["scenario.yaml"], ["scenario.yaml", "study.yaml"]):
        folder = tmp_path / str(len(names))
        folder.mkdir()
        for name in names:
            shutil.copy(reference_study[0] / name, folder)
        run(folder, num_samples=3)
        assert len(read_study(folder).samples) == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"num_samples": 0}, "samples is 0"),
        ({"num_samples": -3}, "samples is -3"),
        ({"num_workers": 0}, "workers is 0"),
        ({"batch_size": 0}, "batch_size is 0"),
    ],
)
def test_counts_out_of_range_are_refused(options, words, tmp_path):
    with pytest.raises(InputError, match=words):
        run(tmp_path / "study", **options)
    assert not (tmp_path / "study").exists()


def test_a_study_is_not_overwritten(reference_study):
    before = (reference_study[0] / "results.csv").read_bytes()
    with pytest.raises(InputError, match="already contains a study"):
        run(reference_study[0])
    assert (reference_study[0] / "results.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("overrides", "seed", "words"),
    [
        (
            ["vehicle.mass={normal: {mean: 0.7, standard_deviation: 0.01, min: 0.64, max: 0.72}}"],
            5,
            "its vehicle.mass.normal.mean is 0.68, not 0.7",
        ),
        (["control.position.k_d=[0.7, 0.6, 3.0]"], 5, r"its control.position.k_d.0 is \S+, not 0.7"),
        (["duration=0.5"], 5, r"its duration is 0.4, not 0.5"),
        ([], 6, "its seed is 5, not 6"),
    ],
)
def test_a_different_study_is_not_resumed(reference_study, overrides, seed, words):
    before = {path: path.read_bytes() for path in reference_study[0].iterdir()}
    with pytest.raises(InputError, match=words):
        run_monte_carlo(study(*overrides), NUM_SAMPLES, seed, folder=reference_study[0], resume=True)
    assert {path: path.read_bytes() for path in reference_study[0].iterdir()} == before


def test_resuming_with_fewer_samples_is_refused(reference_study):
    with pytest.raises(InputError, match="already contains sample 23"):
        run(reference_study[0], num_samples=10, resume=True)


def test_a_results_file_that_is_not_a_study_is_not_resumed(tmp_path):
    (tmp_path / "results.csv").write_text("time,x\n0,1\n")
    with pytest.raises(InputError, match=r"study.yaml"):
        run(tmp_path, resume=True)
    with pytest.raises(InputError, match=r"study.yaml"):
        read_study(tmp_path)
    assert (tmp_path / "results.csv").read_text() == "time,x\n0,1\n"


@pytest.mark.long
def test_a_write_error_ends_the_study_and_keeps_earlier_rows(reference_study, tmp_path, monkeypatch):
    """The disk is full in the middle of a study."""
    from drake_quad.studies.results_file import ResultsFile

    append, count = ResultsFile.append, iter(range(NUM_SAMPLES))

    def failing(self, rows):
        if next(count) == 2:
            raise OSError(28, "No space left on device")
        append(self, rows)

    with monkeypatch.context() as patch:
        patch.setattr(ResultsFile, "append", failing)
        with pytest.raises(OSError, match=r"No space left on device; 10 of 24 samples are in"):
            run(tmp_path)
    run(tmp_path, resume=True)
    assert (tmp_path / "results.csv").read_bytes() == (reference_study[0] / "results.csv").read_bytes()


def test_workers_are_spawned_where_a_fork_is_not_safe():
    """Another thread is running; its state would be inconsistent in a forked process."""
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    try:
        assert not Workers(1).forks_workers
    finally:
        done.set()
        thread.join()
    assert Workers(1).forks_workers


@pytest.mark.slow
def test_a_scenario_without_distributions_can_be_studied(tmp_path):
    result = run_monte_carlo(load_scenario("diagrams/laboratory.yaml:nominal", ["duration=0.3"]), 6, folder=tmp_path)
    assert not result.parameters
    assert len(np.unique(result.metrics.rmse)) == 6
    assert (tmp_path / "results.csv").read_text().startswith("sample,rmse,")


def test_all_versions_that_flew_a_study_are_recorded(reference_study, tmp_path):
    shutil.copytree(reference_study[0], tmp_path, dirs_exist_ok=True)
    record = read_record(tmp_path)
    earlier_version = {**record.versions[0], "numpy": "0.0.1"}
    record.model_copy(update={"versions": [earlier_version]}).write(tmp_path / "study.yaml")
    run(tmp_path, resume=True)
    assert read_record(tmp_path).versions == [earlier_version, *record.versions]


def test_a_difference_inside_a_list_is_named(reference_study):
    """The message names the old value first, then the new one."""
    other_scenario = study(
        "vehicle.inertia.1={normal: {mean: 0.0071, standard_deviation: 0.00035, min: 0.0056, max: 0.0084}}"
    )
    with pytest.raises(InputError, match=r"its vehicle.inertia.1.normal.mean is 0\.007, not 0\.0071$"):
        run_monte_carlo(other_scenario, NUM_SAMPLES, 5, folder=reference_study[0], resume=True)


def test_failures_are_written_in_the_order_of_their_samples(tmp_path):
    with open_study(tmp_path, study("seed=5"), NUM_SAMPLES, 0.4, UserSystems(), compiled=True, resume=False) as rows:
        rows.add(Outcome([7], reason="late"))
        rows.add(Outcome([3], reason="early, with a comma"))
    assert (tmp_path / "failed.csv").read_text() == 'sample,reason\n3,"early, with a comma"\n7,late\n'


@pytest.mark.parametrize(
    ("count", "num_workers", "batch_size", "sizes"),
    [
        (10, 2, 4, [4, 4, 2]),
        (10, 2, None, [5, 5]),
        (3, 8, None, [1, 1, 1]),
        (3, 1, None, [3]),
        (5000, 2, None, [834] * 5 + [830]),
        (2049, 2, None, [513] * 3 + [510]),
        (2048, 2, None, [1024, 1024]),
        (0, 2, None, []),
        (0, 2, 4, []),
    ],
)
def test_all_workers_get_equally_many_batches_of_at_most_1024(count, num_workers, batch_size, sizes):
    size = size_of_batches(count, num_workers, batch_size, 1024)
    assert [min(size, count - first) for first in range(0, count, size)] == sizes


@pytest.mark.slow
def test_memory_is_used_only_for_flown_samples(tmp_path):
    """The results of two billion samples would take 250 GB."""
    count = 2_000_000_000
    totals = []

    def stop(done, total):
        totals.append(total)
        if done >= 4:
            raise KeyboardInterrupt

    scenario = load_scenario("hover", ["duration=0.05"])
    tracemalloc.start()
    try:
        with ThreadPoolExecutor(1) as executor, pytest.raises(StudyInterrupted, match="4 of 2000000000"):
            run_monte_carlo(scenario, count, folder=tmp_path, executor=executor, batch_size=2, progress=stop)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 100e6
    assert {*totals} == {count}
    assert read_study(tmp_path).samples.tolist() == [0, 1, 2, 3]


def test_a_study_that_runs_out_of_memory_reports_what_is_saved(monkeypatch, tmp_path):
    def raise_memory_error(*_):
        raise MemoryError

    monkeypatch.setattr(run_module.StudyRows, "add", raise_memory_error)
    with pytest.raises(MemoryError, match=r"^there is not enough memory; 0 of 2 samples are in .*results.csv$"):
        run_monte_carlo(load_scenario("hover", ["duration=0.05"]), 2, folder=tmp_path, num_workers=1)


class PoolWithGivenOutcome(WorkerPool):
    """Pool of workers that records its tasks and returns the same given outcome for each of them."""

    num_workers = capacity = 1

    def __init__(self, outcome):
        self.outcome, self.tasks = outcome, []

    def submit(self, function, argument):
        self.tasks.append((function.func, function.args[0], [*argument]))

    def next_outcomes(self):
        return [self.outcome]

    def abandon(self):
        pass


def trial(num_vehicles, rmse, reason="", invalid_input=False, in_user_code=False):
    """Run the check of user systems before a study, with invented RMSEs of its three flights; return the pool."""
    rows = np.ones((3, len(study_columns(study()))))
    rows[:, study_columns(study()).index("rmse")] = rmse
    rows[:, 1] = np.nan
    rows[:, study_columns(study()).index("crashed")] = 0.0
    pool = PoolWithGivenOutcome(Outcome([0], rows, reason, invalid_input, in_user_code))
    user_systems = UserSystems(position_controller=TimeVaryingWind, wind=TimeVaryingWind)
    run_module._check_repeatability(pool, BatchJob("key", {}, study(), None, num_vehicles, user_systems, True))
    return pool


@pytest.mark.parametrize(("num_vehicles", "size"), [(1, 1), (2, 2), (3, 3), (1024, 3)])
def test_the_trial_of_user_systems_flies_sample_0_with_at_most_two_other_samples(num_vehicles, size):
    """The three flights of sample 0 agree within 1e-6, so the system is accepted."""
    ((function, job, samples),) = trial(num_vehicles, [0.25, 0.2500005, 0.2499995]).tasks
    assert (function, samples) == (fly_trial, [2, 1, 0][3 - size :])
    assert (job.num_vehicles, job.key) == (size, "key, trial")


@pytest.mark.long
def test_a_study_without_user_systems_flies_no_trial(monkeypatch):
    trials = []
    monkeypatch.setattr(run_module, "_check_repeatability", lambda pool, job: trials.append(job))
    run(num_samples=1)
    run_monte_carlo(load_scenario("hover", ["duration=0.1"], layers=["controllers/lqg:lqg"]), 1, num_workers=1)
    assert trials == []
    run_monte_carlo(uncompiled_scenario(), 1, 5, num_workers=1, batch_size=5, wind=TimeVaryingWind)
    assert len(trials) == 1


@pytest.mark.parametrize(
    ("rmse", "words"),
    [
        (
            [0.25, 0.25001, 0.25],
            r"^sample 0 has an RMSE of 0\.25 m when it is flown alone, but 0\.25001 m when it is flown again in the"
            r" same diagram;"
            " position_controller and wind must store all state in Drake's context, not in Python objects$",
        ),
        (
            [0.25, 0.25, 0.24999],
            r"^sample 0 has an RMSE of 0\.25 m when it is flown alone, but 0\.24999 m when it is flown together with"
            r" other samples;"
            r" position_controller and wind must not mix the columns of \(k, N\) arrays, one per vehicle$",
        ),
        ([1e-5, 1.4e-5, 1e-5], "flown again in the same diagram"),
        ([0.25, 0.26, 0.24], "flown again in the same diagram"),
    ],
)
def test_a_trial_of_user_systems_with_different_results_explains_the_difference(rmse, words):
    with pytest.raises(InputError, match=words):
        trial(3, rmse)


def test_a_trial_of_user_systems_reports_invalid_input_but_not_other_failures():
    trial(3, [1.0, 2.0, 3.0], reason="ArithmeticError: no flight")
    with pytest.raises(InputError, match="^the wings are missing$"):
        trial(3, [1.0, 1.0, 1.0], reason="the wings are missing", invalid_input=True)
    with pytest.raises(InputError, match="^mine.py:3: KeyError: 'gain'$"):
        trial(3, [1.0, 1.0, 1.0], reason="mine.py:3: KeyError: 'gain'", in_user_code=True)


@pytest.mark.long
def test_fleets_are_built_before_a_fork_and_deleted_at_the_end(reference_study, tmp_path, monkeypatch):
    """Fleets are not built in this process if a study is complete, has user systems, or uses another executor."""
    prepared, fleets = [], vars(flying._thread_data)

    def prepare_and_tell(job):
        prepared.append(job.num_vehicles)
        build_fleet(job)
        assert list(fleets["fleets"]) == [5]

    monkeypatch.setattr(flying, "build_fleet", prepare_and_tell)
    run(tmp_path, num_samples=7)
    assert prepared == [5]
    assert fleets == {}
    run(tmp_path, num_samples=7, resume=True)
    run_monte_carlo(uncompiled_scenario(), 2, 5, num_workers=2, batch_size=5, wind=TimeVaryingWind)
    with ThreadPoolExecutor(1) as executor:
        run(num_samples=2, executor=executor)
    monkeypatch.setattr(Workers, "forks_workers", False)
    run(num_samples=2)
    assert prepared == [5]


@pytest.mark.long
def test_a_given_seed_replaces_the_seed_of_the_scenario():
    scenario = study("seed=8").model_copy(update={"sample": 4})
    options = {"num_workers": 1, "batch_size": 2}
    with_scenario_seed, with_given_seed = (
        run_monte_carlo(scenario, 2, **options),
        run_monte_carlo(scenario, 2, 5, **options),
    )
    assert (with_scenario_seed.scenario.seed, with_scenario_seed.scenario.sample, with_given_seed.scenario.seed) == (
        8,
        None,
        5,
    )
    assert with_scenario_seed.metrics.rmse[1] == pytest.approx(
        simulate(study(), seed=8, sample=1).metrics.rmse, rel=1e-9
    )
    assert with_given_seed.metrics.rmse[1] == pytest.approx(simulate(study(), seed=5, sample=1).metrics.rmse, rel=1e-9)


def test_progress_counts_completed_and_failed_samples(tmp_path, monkeypatch):
    attempts, progress_calls = tmp_path / "attempts", []
    attempts.mkdir()
    monkeypatch.setattr(run_module, "fly_batch", FailingFlights(attempts, "raises", 99))
    run(num_samples=8, num_workers=1, batch_size=4, progress=lambda *counts: progress_calls.append(counts))
    assert progress_calls == [(0, 8), (4, 8), (6, 8), (7, 8), (8, 8)]


@pytest.mark.parametrize("fails", [False, True])
def test_pending_tasks_are_abandoned_at_the_end(fails, monkeypatch):
    abandoned = []

    class RecordingPool(PoolWithGivenOutcome):
        def submit(self, function, argument):
            self.outcome = Outcome(argument, None if fails else function(argument), "no flight" if fails else "")

        def abandon(self):
            abandoned.append(True)

    if fails:
        with pytest.raises(RuntimeError, match="no flight; nothing was written"):
            run(num_samples=8, batch_size=1, executor=RecordingPool(None))
    else:
        assert len(run(num_samples=2, batch_size=1, executor=RecordingPool(None)).samples) == 2
    assert abandoned == [True]


@pytest.mark.slow
def test_a_study_without_any_flown_sample_states_the_reason(tmp_path):
    with pytest.raises(RuntimeError, match=r"no sample can be flown; sample 0: .*broken.*; 0 of 3 samples are in"):
        run(tmp_path, num_samples=3, wind=failing_wind)
    assert len((tmp_path / "failed.csv").read_text().splitlines()) == 1 + 3


def failing_wind(num_vehicles):
    raise ArithmeticError("broken")


@pytest.mark.long
@pytest.mark.parametrize("kind", ["latin_hypercube", "sobol"])
def test_latin_hypercube_and_sobol_draws_do_not_depend_on_batches_workers_or_interruptions(kind, tmp_path):
    options = {"num_samples": 40, "draws": kind}
    result = run(tmp_path, **options)
    assert result.scenario.draws.size == 2
    assert len({*result.replicates.indices}) == 20
    content = (tmp_path / "results.csv").read_bytes()
    with ThreadPoolExecutor(1) as executor:
        other_study = run(executor=executor, num_workers=1, batch_size=3, **options)
    np.testing.assert_array_equal(other_study.metrics, result.metrics)
    (tmp_path / "results.csv").write_bytes(b"".join(content.splitlines(keepends=True)[:12]))
    resumed = run(tmp_path, resume=True, **options)
    assert (tmp_path / "results.csv").read_bytes() == content
    assert 0.0 < resumed.simulated_time < result.simulated_time
    # The scenario in the folder reproduces the flight of a sample.
    single_flight = simulate(load_scenario(tmp_path / "scenario.yaml"), sample=33)
    assert single_flight.metrics.rmse == pytest.approx(result.metrics.rmse[33], rel=1e-9)
    assert read_study(tmp_path).replicates.indices.tolist() == result.replicates.indices.tolist()


@pytest.mark.long
def test_sobol_draws_do_not_change_wind_and_noise():
    """The drawn field has almost no effect, so flights with Sobol draws agree with those of independent draws."""
    harmless = load_scenario(
        "laboratory:low_wind", ["duration=0.3", "vehicle.gravity={uniform: {min: 9.81, max: 9.8100001}}"]
    )
    designed, independent = (
        run_monte_carlo(harmless, 32, num_workers=1, draws=kind).metrics.rmse for kind in ("sobol", "random")
    )
    np.testing.assert_allclose(designed, independent, rtol=1e-5)
    assert np.ptp(designed) > 0.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"draws": "halton"}, "there is no kind of draws called .halton.; there are random, latin_hypercube, sobol"),
        ({"draws": "sobol", "num_samples": 31}, "sobol draws need at least 32 samples: 16 replicates of two samples"),
        ({"draws": "sobol", "num_samples": 64, "until": ["rmse ± 1 %"]}, "a study with sobol draws cannot end early"),
    ],
)
def test_draws_that_do_not_fit_the_study_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        run(**options)
    with pytest.raises(InputError, match="hover contains no distribution, so sobol draws have no effect"):
        run_monte_carlo(load_scenario("hover"), 100, draws="sobol")
