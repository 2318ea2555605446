"""The same rows from a Dask cluster: a scheduler and two workers, as the README starts them."""

import json
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.analysis.monte_carlo import run_monte_carlo
from drake_quad.analysis.monte_carlo.cluster import dask_executor

pytest.importorskip("distributed", reason="needs dask[distributed], the extra `cluster`")
pytestmark = pytest.mark.filterwarnings("default")  # Dask's own are not ours to mend


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


def test_a_cluster_flies_the_same_study(cluster):
    from distributed import Client

    with Client(cluster) as client:
        client.wait_for_workers(2, timeout=60)
    scenario = load_scenario("diagrams/robustness.yaml", ["duration=0.3"])
    with dask_executor(cluster) as (executor, threads):
        assert threads == 2
        found = run_monte_carlo(scenario, 21, executor=executor, num_workers=threads, batch_size=4)
    here = run_monte_carlo(scenario, 21, num_workers=1)
    for ours, others in zip(found.metrics, here.metrics, strict=True):
        np.testing.assert_allclose(ours, others, rtol=1e-9)


def test_a_cluster_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr("drake_quad.analysis.monte_carlo.cluster._PATIENCE", 0.5)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(InputError, match=f"no Dask scheduler can be reached at {address}"), dask_executor(address):
            pass
    for nonsense in ("nonsense://x", "", "127.0.0.1:what"):
        with pytest.raises(InputError, match="no Dask scheduler can be reached at"), dask_executor(nonsense):
            pass
