"""Tests that studies on a Dask cluster give the results of local studies and report failures of the cluster.

Dask runs in other processes, since its threads would remain in this process, which other tests fork.
"""

import importlib.util
import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from drake_quad import load_scenario, read_study, run_monte_carlo
from drake_quad.studies import cluster as cluster_module
from drake_quad.studies.cluster import DaskPool
from drake_quad.studies.sobol_indices import sobol_indices
from drake_quad.studies.worker_pool import Outcome

# The package is looked up and not imported, since the import takes a second in every pytest process.
pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="needs dask[distributed], the extra `cluster`"
)
ROOT = Path(__file__).parents[2]
OVERRIDES = ["duration=0.3"]


class Cluster:
    """Dask scheduler with workers."""

    def __init__(self, folder):
        self._folder, self._file = folder, folder / "scheduler.json"
        self.processes = []
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", 0)
        self.address = None
        while self.address is None:
            time.sleep(0.05)
            with suppress(FileNotFoundError, json.JSONDecodeError):  # the file may be missing or incomplete
                self.address = json.loads(self._file.read_text())["address"]

    def add_worker(self, sources=ROOT):
        """Start a worker that imports this package from a folder."""
        return self._start(
            "dask_worker", "--host", "127.0.0.1", "--nthreads", 1, "--local-directory", self._folder, sources=sources
        )

    def _start(self, program, *options, sources=ROOT):
        command = [sys.executable, "-m", f"distributed.cli.{program}", "--no-dashboard", "--scheduler-file", self._file]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self.processes.append(subprocess.Popen([*map(str, command), *map(str, options)], cwd=sources, **quiet))
        return self.processes[-1]

    def end(self):
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    actual = Cluster(tmp_path_factory.mktemp("cluster"))
    actual.add_worker()
    yield actual
    actual.end()


def monte_carlo(address, folder, *options, command="study"):
    script = [sys.executable, "-m", "drake_quad", command, ROOT / "diagrams" / "robustness.yaml"]
    overrides = [word for override in OVERRIDES for word in ("--set", override)]
    command = [*script, *overrides, "--cluster", address, "--output", folder, *options]
    return subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_results(study, folder):
    """Wait until a study has written some results."""
    results = folder / "results.csv"
    while study.poll() is None and not (results.exists() and results.read_text().count("\n") > 3):
        time.sleep(0.05)


# The script runs one study after another, each on another cluster; each study ends with status 2.
STUDIES_PROGRAM = """
import sys
from drake_quad.command_line.main import main
_, scenario, folder, *addresses = sys.argv
for address in addresses:
    sys.argv[1:] = ["study", scenario, "--cluster", address, "--output", folder]
    try:
        main()
    except SystemExit as stop:
        assert stop.code == 2
"""


@pytest.fixture(scope="module", autouse=True)
def unreachable(tmp_path_factory):
    """Start studies on unreachable clusters. They wait for a timeout while the other tests run."""
    folder = tmp_path_factory.mktemp("unreachable") / "study"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        addresses = [f"tcp://127.0.0.1:{free.getsockname()[1]}", "nonsense://x", "x"]
        command = [sys.executable, "-c", STUDIES_PROGRAM, ROOT / "diagrams" / "robustness.yaml", folder, *addresses]
        process = subprocess.Popen([*map(str, command)], stderr=subprocess.PIPE, text=True, cwd=ROOT)
        yield folder, addresses, process
    process.kill()
    process.wait()
    process.stderr.close()


@pytest.fixture(scope="module", autouse=True)
def frozen(tmp_path_factory):
    """Start a study and freeze its scheduler. The study waits for a reply while the other tests run."""
    folder = tmp_path_factory.mktemp("frozen")
    cluster = Cluster(folder)
    cluster.add_worker()
    study = send_signal_during_study(cluster, folder / "study", signal.SIGSTOP)
    yield study, cluster, folder / "study"
    study.kill()
    study.communicate()
    cluster.end()


@pytest.mark.long
def test_a_study_on_a_cluster_has_the_results_of_a_local_study(cluster, tmp_path):
    """The study is interrupted by Ctrl-C and resumed."""
    folder = tmp_path / "study"
    interrupted = monte_carlo(cluster.address, folder, "--samples", "300", "--batch", "3", "--workers", "2")
    wait_for_results(interrupted, folder)
    interrupted.send_signal(signal.SIGINT)
    _, stderr = interrupted.communicate()
    assert interrupted.returncode == 1, stderr
    assert len(stderr.splitlines()) == 1
    assert stderr.startswith("interrupted: ")
    assert 0 < len(read_study(folder).samples) < 300

    resumed = monte_carlo(cluster.address, folder, "--samples", "300", "--batch", "200", "--resume")
    stdout, stderr = resumed.communicate()
    assert (resumed.returncode, stderr) == (0, "")
    assert stdout.splitlines()[-1].endswith("vehicle-seconds per second")
    run_monte_carlo(load_scenario(ROOT / "diagrams" / "robustness.yaml", OVERRIDES), 300, folder=tmp_path / "here")
    assert (folder / "results.csv").read_bytes() == (tmp_path / "here" / "results.csv").read_bytes()


@pytest.mark.long
def test_a_search_on_a_cluster_evaluates_the_same_flights_as_a_local_search(cluster, tmp_path):
    process = monte_carlo(cluster.address, tmp_path / "there", "--points", "8", "--workers", "2", command="sobol")
    stdout, stderr = process.communicate()
    assert (process.returncode, stderr) == (0, "")
    assert "fractions of the variance of rmse" in stdout
    scenario = load_scenario(ROOT / "diagrams" / "robustness.yaml", OVERRIDES)
    sobol_indices(scenario, "rmse", num_points=8, folder=tmp_path / "here")
    cluster_file, local_file = (tmp_path / name / "flights.csv" for name in ("there", "here"))
    assert cluster_file.read_bytes() == local_file.read_bytes()


@pytest.mark.long
def test_errors_in_the_client_loop_are_not_logged(cluster):
    """Ctrl-C in Dask's `sync` raises an exception in its event loop, which must not be printed."""
    script = f"""
import threading
from drake_quad.studies.cluster import dask_pool
with dask_pool("{cluster.address}") as pool:
    loop, called = pool._client.loop, threading.Event()
    loop.add_callback(lambda: 1 / 0)
    loop.add_callback(called.set)
    assert called.wait(30)
"""
    run = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")


def send_signal_during_study(cluster, folder, signal_number):
    """Return a study that has written some results when its scheduler receives a signal."""
    study = monte_carlo(cluster.address, folder, "--samples", "3000", "--batch", "3")
    wait_for_results(study, folder)
    cluster.scheduler.send_signal(signal_number)
    return study


def check_end(study, cluster, folder, words):
    """Check that a study ends with a message and keeps its results."""
    _, stderr = study.communicate()
    rows = len(read_study(folder).samples)
    assert 0 < rows < 3000
    saved = f"{rows} of 3000 samples are in {folder / 'results.csv'}"
    assert (study.returncode, stderr) == (1, f"failed: the Dask scheduler at {cluster.address} {words}; {saved}\n")


@pytest.mark.long
def test_a_worker_with_different_code_is_refused(tmp_path):
    """The worker has a copy of this package in which one value is changed."""
    copy = tmp_path / "copy" / "drake_quad"
    shutil.copytree(ROOT / "drake_quad", copy, ignore=shutil.ignore_patterns("__pycache__"))
    changed = copy / "laboratory" / "metrics.py"
    text = changed.read_text()
    assert "np.sqrt((sums.squares.x" in text
    changed.write_text(text.replace("np.sqrt((sums.squares.x", "1.02 * np.sqrt((sums.squares.x"))
    cluster = Cluster(tmp_path)
    try:
        cluster.add_worker(copy.parent)
        study = monte_carlo(cluster.address, tmp_path / "study", "--samples", "4")
        _, stderr = study.communicate()
    finally:
        cluster.end()
    assert study.returncode == 2
    assert stderr.startswith("error: the worker at tcp://127.0.0.1:")
    assert stderr.endswith(" has a different version of drake_quad's source files\n")
    assert not (tmp_path / "study").exists()


@pytest.mark.long
def test_an_unreachable_cluster_is_named_in_the_error(unreachable):
    folder, addresses, process = unreachable
    _, stderr = process.communicate()
    assert process.returncode == 0
    for address, line in zip(addresses, stderr.splitlines(), strict=True):
        assert line.startswith(f"error: no Dask scheduler can be reached at {address}: ")
    assert not folder.exists()


class Future:
    """Stub of a Dask future whose status changes each time the worker pool queries it."""

    def __init__(self, *statuses):
        self.statuses = [*statuses]

    @property
    def status(self):
        return self.statuses[0]

    def done(self):
        if len(self.statuses) > 1:
            self.statuses.pop(0)
        return self.status == "finished"

    def result(self, timeout):
        return Outcome(None, "rows")


class Client:
    """Stub of a Dask client whose scheduler always replies."""

    status = "running"
    scheduler = SimpleNamespace(ncores=None)

    def __init__(self, future, workers):
        self.future, self.workers = future, workers

    def submit(self, function, *arguments, pure):
        return self.future

    def sync(self, function, callback_timeout):
        return self.workers


def pool_with(future, workers):
    pool = DaskPool(Client(future, workers), "tcp://somewhere:1", 1)
    pool.submit(len, "given")
    return pool


def test_a_result_lost_with_its_worker_is_computed_again():
    pool = pool_with(Future("pending", "lost", "lost", "pending", "finished"), {"worker": 1})
    (outcome,) = pool.next_outcomes()
    assert outcome.result == "rows"


@pytest.mark.long
def test_a_scheduler_that_has_lost_all_workers_is_reported(monkeypatch):
    for name in ("_REQUEST_PERIOD", "_MAX_TIME_WITHOUT_WORKERS"):
        monkeypatch.setattr(cluster_module, name, 0.0)
    pool = pool_with(Future("pending", "lost"), {})
    with pytest.raises(
        ConnectionError,
        match="^the Dask scheduler at tcp://somewhere:1 has had no workers for a minute; start workers and resume",
    ):
        pool.next_outcomes()


@pytest.mark.long
def test_cancelled_futures_mean_that_the_connection_is_lost():
    with pytest.raises(ConnectionError, match="^the Dask scheduler at tcp://somewhere:1 has closed the connection$"):
        pool_with(Future("pending", "cancelled"), {"worker": 1}).next_outcomes()


@pytest.mark.long
def test_a_scheduler_that_freezes_ends_a_study(frozen):
    check_end(*frozen, "does not reply")


@pytest.mark.long
def test_a_scheduler_that_dies_ends_a_study(cluster, tmp_path):
    """This test is the last one of the file, because the other tests need the scheduler that it stops."""
    folder = tmp_path / "study"
    check_end(send_signal_during_study(cluster, folder, signal.SIGKILL), cluster, folder, "has closed the connection")
