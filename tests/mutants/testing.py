"""Tests in processes of their own, with and without a mutant in place of a file.

All are forked from one process that has imported everything but this project.
"""

import contextlib
import gc
import importlib
import multiprocessing
import os
import pkgutil
import shutil
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from importlib.machinery import SourceFileLoader
from multiprocessing import connection
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import HealthCheck, Phase, settings
from mutation import Mutant
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
# Where each process says which test it runs.
RUNNING = ROOT / "out" / "mutants" / "running"
# Machine code of formulas, which goes by what it computes: a mutant's has a name of its own. What makes machine code is
# in `MAKER`; where that is changed, none is kept.
MACHINE_CODE = ROOT / "out" / "mutants" / "machine_code"
MAKER = "drake_quad/framework/"
THIRD_PARTY = (
    "pydrake.all", "control", "dask.distributed", "markdown", "matplotlib.pyplot", "mpl_toolkits.mplot3d",
    "llvmlite.binding", "minsnap_trajectories", "pydantic", "pyit2fls", "scipy.integrate", "scipy.optimize",
    "scipy.signal", "scipy.stats",
)  # fmt: skip
# Seconds of the processor's time that a test may always take.
LEAST = 10.0
# Seconds by the clock that no mutant needs: processes that wait for each other use no time of the processor.
LONGEST = 600.0


class Test(NamedTuple):
    """What was noted of a test: the processor's time that it took, in s, and lines that it runs, by file."""

    seconds: float
    lines: dict[str, list[int]]


class Outcome(NamedTuple):
    """What became of a mutant: by which test it was killed, if any, and after how many tests."""

    killer: str | None
    num_tests: int


def prepare() -> None:
    """Imports all but this project, for the processes to come, and makes tests repeat themselves."""
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    RUNNING.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(MACHINE_CODE, ignore_errors=True)
    os.environ["DRAKE_QUAD_CACHE"] = str(MACHINE_CODE)
    for name in THIRD_PARTY:
        importlib.import_module(name)
    settings.register_profile(
        "mutants",
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    settings.load_profile("mutants")


class Plugin:
    """Runs the chosen tests in their order, notes what they run, and ends the process if one takes too long."""

    def __init__(self, chosen: dict[str, float] | None = None) -> None:
        self.chosen = chosen
        self.noted: dict[str, Test] = {}
        self.failed: list[str] = []
        self.lines: dict[str, set[int]] = defaultdict(set)

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if self.chosen is not None:
            order = {name: place for place, name in enumerate(self.chosen)}
            items[:] = sorted((item for item in items if item.nodeid in order), key=lambda item: order[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        self.lines.clear()
        if self.chosen is None:
            # Every test shall be seen to run the formulas that it needs, of which machine code may be there.
            sys.modules["drake_quad.framework.formulas"]._kernels.clear()
            sys.monitoring.restart_events()
        else:
            limit_time(item.nodeid, 10.0 * self.chosen[item.nodeid] + LEAST)
        start = processor_time()
        result = yield
        seconds = processor_time() - start
        self.noted[item.nodeid] = Test(seconds, {file: sorted(lines) for file, lines in self.lines.items()})
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)

    def note_lines(self) -> None:
        """Has lines noted as they run, each once in a test."""
        monitoring, prefix = sys.monitoring, f"{ROOT}/drake_quad/"

        def note(code: Any, line: int) -> Any:
            if code.co_filename.startswith(prefix):
                self.lines[code.co_filename[len(str(ROOT)) + 1 :]].add(line)
            return monitoring.DISABLE

        monitoring.use_tool_id(monitoring.COVERAGE_ID, "mutants")
        monitoring.register_callback(monitoring.COVERAGE_ID, monitoring.events.LINE, note)
        monitoring.set_events(monitoring.COVERAGE_ID, monitoring.events.LINE)


def processor_time() -> float:
    """Of this process and of those that it started and saw end, in s."""
    return sum(os.times()[:4])


def limit_time(what: str, seconds: float) -> None:
    """Ends this process if it takes more of the processor's time, and leaves what it did."""
    (RUNNING / str(os.getpid())).write_text(what)
    signal.setitimer(signal.ITIMER_PROF, seconds)


def note(file: str) -> tuple[dict[str, Test], list[str]]:
    """Runs the tests of a file and returns what was noted and what failed."""
    plugin = Plugin()
    # What an import runs is no test's, though it be the first to import.
    for module in pkgutil.walk_packages([str(ROOT / "drake_quad")], "drake_quad."):
        # A module that needs a library that is not installed is run by no test.
        with contextlib.suppress(ImportError):
            importlib.import_module(module.name)
    plugin.note_lines()
    status = run_pytest(plugin, file)
    if status not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED):
        raise RuntimeError(f"the tests of {file} do not run: pytest ends with status {status}")
    return plugin.noted, plugin.failed


def kill(file: str, mutant: Mutant, tests: dict[str, float]) -> Outcome:
    """Runs tests on a mutant until one fails."""
    path, text = str(ROOT / file), mutant.applied(Path(file).read_text())
    if file.startswith(MAKER):
        os.environ["DRAKE_QUAD_CACHE"] = ""
    code_of = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, name: str) -> Any:
        return compile(text, path, "exec") if loader.path == path else code_of(loader, name)

    SourceFileLoader.get_code = get_code
    plugin = Plugin(tests)
    for test_file in dict.fromkeys(name.split("::")[0] for name in tests):
        limit_time(test_file, 60.0)
        status = run_pytest(plugin, test_file)
        # Where what tests are made of is changed, there may be none of these.
        if status not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            killer = plugin.failed[0] if plugin.failed else f"{test_file} (not even collected)"
            return Outcome(killer, len(plugin.noted))
    return Outcome(None, len(plugin.noted))


def run_pytest(plugin: Plugin, file: str) -> int:
    options = ["-x"] if plugin.chosen is not None else []
    command = [file, "-p", "no:cacheprovider", "--assert=plain", "--tb=no", *options]
    # Between tests, pytest looks for garbage many times over: what is there now is none.
    gc.freeze()
    with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        return int(pytest.main(command, plugins=[plugin]))


def forked(jobs: list[tuple[Any, ...]], processes: int, what: str) -> Iterator[tuple[int, Any]]:
    """The places and results of jobs, a function and its arguments each, as they end.

    Every one is in a process of its own. If that ends before it has one, the result is an `Outcome` that says so.
    """
    context, waiting = multiprocessing.get_context("fork"), enumerate(jobs)
    running: dict[Any, tuple[int, Any, float]] = {}
    bar = tqdm(total=len(jobs), desc=what, smoothing=0.02)
    try:
        while True:
            while len(running) < processes and (following := next(waiting, None)):
                here, there = context.Pipe(duplex=False)
                process = context.Process(target=do, args=(there, *following[1]))
                process.start()
                there.close()
                running[here] = following[0], process, time.monotonic() + LONGEST
            if not running:
                return
            for here in connection.wait(list(running), timeout=1.0):
                place, process, _ = running.pop(here)
                yield place, received(here, process)
                bar.update()
            for _, process, last in running.values():
                if time.monotonic() > last:
                    os.killpg(process.pid, signal.SIGKILL)
    finally:
        bar.close()
        for _, process, _ in running.values():
            os.killpg(process.pid, signal.SIGKILL)


def do(there: Any, function: Any, *arguments: Any) -> None:
    """Runs a job in a forked process and sends what it returns."""
    os.setsid()
    # A shell may have had it ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    there.send(function(*arguments))
    there.close()


def received(here: Any, process: Any) -> Any:
    """What a process sends before it ends, or how it ended otherwise."""
    running = RUNNING / str(process.pid)
    try:
        result = here.recv()
        process.join()
    except EOFError:
        process.join()
        how = signal.Signals(-process.exitcode).name if process.exitcode < 0 else f"status {process.exitcode}"
        result = Outcome(f"{running.read_text()} (ended by {how})", 0)
    running.unlink(missing_ok=True)
    return result
