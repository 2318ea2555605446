"""The same rows from a Dask cluster: a scheduler and two workers, as the README starts them.

Everything of Dask's runs in other processes: its threads stay, and those of this one are forked elsewhere.
"""

import json
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drake_quad import load_scenario, read_study, run_monte_carlo

pytest.importorskip("distributed", reason="needs dask[distributed], the extra `cluster`")
ROOT = Path(__file__).parents[3]
OVERRIDES = ["duration=0.3"]


def start(program, *options):
    command = [sys.executable, "-m", "distributed.cli." + program, "--no-dashboard", *map(str, options)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def cluster(tmp_path):
    file = tmp_path / "scheduler.json"
    processes = [start("dask_scheduler", "--host", "127.0.0.1", "--port", 0, "--scheduler-file", file)]
    try:
        deadline = time.monotonic() + 60.0
        while not file.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        folder = ("--local-directory", tmp_path)
        processes += [start("dask_worker", "--scheduler-file", file, "--nthreads", 1, *folder) for _ in range(2)]
        yield json.loads(file.read_text())["address"]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def monte_carlo(address, folder, *options):
    script = [sys.executable, ROOT / "scripts" / "monte_carlo.py", ROOT / "diagrams" / "robustness.yaml"]
    overrides = [word for override in OVERRIDES for word in ("--set", override)]
    command = [*script, *overrides, "--cluster", address, "--output", folder, *options]
    return subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope="module", autouse=True)
def unreachable(tmp_path_factory):
    """Studies for clusters that are not there; they wait for them while the other test runs."""
    folder = tmp_path_factory.mktemp("unreachable") / "study"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        addresses = [f"tcp://127.0.0.1:{free.getsockname()[1]}", "nonsense://x"]
        runs = {address: monte_carlo(address, folder) for address in addresses}
        yield folder, runs
    for process in runs.values():
        process.kill()


def test_a_cluster_flies_the_same_study(cluster, tmp_path):
    """Also after Ctrl-C: what it had done by then is gone on with."""
    options = ("--samples", "600", "--batch", "3", "--workers", "2")
    interrupted = monte_carlo(cluster, tmp_path, *options)
    results = tmp_path / "robustness" / "results.csv"
    while interrupted.poll() is None and not (results.exists() and results.read_text().count("\n") > 3):
        time.sleep(0.05)
    interrupted.send_signal(signal.SIGINT)
    _, stderr = interrupted.communicate(timeout=60)
    assert interrupted.returncode == 1, stderr
    assert stderr.splitlines()[-1].startswith("interrupted: ")  # Dask may have logged before
    assert 0 < len(read_study(tmp_path / "robustness").samples) < 600

    gone_on = monte_carlo(cluster, tmp_path, "--samples", "600", "--batch", "200", "--resume")
    stdout, stderr = gone_on.communicate(timeout=120)
    assert (gone_on.returncode, stderr) == (0, "")
    assert stdout.splitlines()[-1].endswith("vehicle-seconds per second")
    run_monte_carlo(load_scenario(ROOT / "diagrams" / "robustness.yaml", OVERRIDES), 600, folder=tmp_path / "here")
    assert results.read_bytes() == (tmp_path / "here" / "results.csv").read_bytes()


def test_a_cluster_that_is_not_there_is_named(unreachable):
    folder, runs = unreachable
    for address, process in runs.items():
        _, stderr = process.communicate(timeout=60)
        assert process.returncode == 2
        assert f"error: no Dask scheduler can be reached at {address}" in stderr
    assert not folder.exists()
