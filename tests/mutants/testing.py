"""Tests in forked processes, with the original sources or with a mutant in place of one file.

The parent process has imported all libraries, but not this project.
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
# Folder in which each process writes the name of its current test.
RUNNING_TESTS = ROOT / "out" / "mutants" / "running"
# Cache of the machine code of formulas. Its keys depend on the formulas, so mutants of formulas have their own machine
# code. Mutants of the compiler itself do not use the cache.
MACHINE_CODE = ROOT / "out" / "mutants" / "machine_code"
COMPILER_FOLDERS = ("drake_quad/framework/", "drake_quad/compilation/")
PRELOADED_LIBRARIES = (
    "pydrake.all", "control", "dask.distributed", "markdown", "matplotlib.pyplot", "mpl_toolkits.mplot3d",
    "llvmlite.binding", "minsnap_trajectories", "pydantic", "pyit2fls", "scipy.integrate", "scipy.optimize",
    "scipy.signal", "scipy.stats",
)  # fmt: skip
# CPU time, s, added to the limit of a test. A test that runs alone sets up fixtures that it otherwise shares, and
# compiles their formulas.
MIN_CPU_LIMIT = 30.0
MAX_DURATION = 600.0  # s, time limit for a mutant; it ends deadlocks, which use no CPU time


class Test(NamedTuple):
    """Record of a test: its CPU time in s, and the lines that it runs, by file."""

    seconds: float
    lines: dict[str, list[int]]


class Outcome(NamedTuple):
    """Outcome of a mutant: the test that killed it, if any, and the number of tests that ran."""

    killer: str | None
    num_tests: int


def prepare() -> None:
    """Import all libraries for the forked processes, and make tests reproducible."""
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    RUNNING_TESTS.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(MACHINE_CODE, ignore_errors=True)
    os.environ["DRAKE_QUAD_CACHE"] = str(MACHINE_CODE)
    for name in PRELOADED_LIBRARIES:
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
    """Pytest plugin that runs chosen tests in a given order, records them, and limits their CPU time."""

    def __init__(self, chosen: dict[str, float] | None = None) -> None:
        self.chosen = chosen
        self.recorded: dict[str, Test] = {}
        self.failed: list[str] = []
        self.lines: dict[str, set[int]] = defaultdict(set)

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if self.chosen is not None:
            order = {name: index for index, name in enumerate(self.chosen)}
            items[:] = sorted((item for item in items if item.nodeid in order), key=lambda item: order[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        self.lines.clear()
        if self.chosen is None:
            # No machine code is cached, so every test runs the lines of its formulas and of the LLVM code generator.
            sys.modules["drake_quad.framework.formulas"]._kernels.clear()
            sys.modules["drake_quad.framework.machine_code"]._GENERATOR_DIGEST = None
            sys.monitoring.restart_events()
        else:
            limit_time(item.nodeid, 10.0 * self.chosen[item.nodeid] + MIN_CPU_LIMIT)
        start = processor_time()
        result = yield
        seconds = processor_time() - start
        self.recorded[item.nodeid] = Test(seconds, {file: sorted(lines) for file, lines in self.lines.items()})
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)

    def record_lines(self) -> None:
        """Record the lines of the package that run, once per test."""
        monitoring, prefix = sys.monitoring, f"{ROOT}/drake_quad/"

        def record(code: Any, line: int) -> Any:
            if code.co_filename.startswith(prefix):
                self.lines[code.co_filename[len(str(ROOT)) + 1 :]].add(line)
            return monitoring.DISABLE

        monitoring.use_tool_id(monitoring.COVERAGE_ID, "mutants")
        monitoring.register_callback(monitoring.COVERAGE_ID, monitoring.events.LINE, record)
        monitoring.set_events(monitoring.COVERAGE_ID, monitoring.events.LINE)


def processor_time() -> float:
    """Return the CPU time of this process and its ended child processes, s."""
    return sum(os.times()[:4])


def limit_time(name: str, seconds: float) -> None:
    """Write the name of the current test, and limit the CPU time until this process is ended."""
    (RUNNING_TESTS / str(os.getpid())).write_text(name)
    signal.setitimer(signal.ITIMER_PROF, seconds)


def record_tests(file: str) -> tuple[dict[str, Test], list[str]]:
    """Run the tests of a file, and return their records and the names of failed tests."""
    plugin = Plugin()
    # All modules are imported first, so that no test's record contains the lines that run at import.
    for module in pkgutil.walk_packages([str(ROOT / "drake_quad")], "drake_quad."):
        # No test uses modules whose libraries are not installed.
        with contextlib.suppress(ImportError):
            importlib.import_module(module.name)
    plugin.record_lines()
    status = run_pytest(plugin, file)
    if status not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED):
        raise RuntimeError(f"{file}: its tests cannot run; pytest ended with status {status}")
    return plugin.recorded, plugin.failed


def kill(file: str, mutant: Mutant, tests: dict[str, float]) -> Outcome:
    """Run tests on a mutant until one of them fails."""
    path, text = str(ROOT / file), mutant.applied(Path(file).read_text())
    if file.startswith(COMPILER_FOLDERS):
        os.environ["DRAKE_QUAD_CACHE"] = ""
    code_of = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, name: str) -> Any:
        return compile(text, path, "exec") if loader.path == path else code_of(loader, name)

    SourceFileLoader.get_code = get_code
    plugin = Plugin(tests)
    for test_file in dict.fromkeys(name.split("::")[0] for name in tests):
        limit_time(test_file, 60.0)
        status = run_pytest(plugin, test_file)
        # A mutant may change the parameters of tests, so that none of the chosen tests exists.
        if status not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            killer = plugin.failed[0] if plugin.failed else f"{test_file} (not even collected)"
            return Outcome(killer, len(plugin.recorded))
    return Outcome(None, len(plugin.recorded))


def run_pytest(plugin: Plugin, file: str) -> int:
    options = ["-x"] if plugin.chosen is not None else []
    command = [file, "-p", "no:cacheprovider", "--assert=plain", "--tb=no", *options]
    # Existing objects are not garbage. Frozen objects are skipped by the garbage collections that pytest often
    # requests.
    gc.freeze()
    with Path(os.devnull).open("w") as devnull, redirect_stdout(devnull), redirect_stderr(devnull):
        return int(pytest.main(command, plugins=[plugin]))


def run_forked(jobs: list[tuple[Any, ...]], processes: int, description: str) -> Iterator[tuple[int, Any]]:
    """Run each job in its own process, and yield the indices and results of jobs as they end.

    A job is a function and its arguments. If a process ends without a result, the result is an `Outcome` with the
    reason.
    """
    context, waiting = multiprocessing.get_context("fork"), enumerate(jobs)
    running: dict[Any, tuple[int, Any, float]] = {}
    bar = tqdm(total=len(jobs), desc=description, smoothing=0.02)
    try:
        while True:
            while len(running) < processes and (following := next(waiting, None)):
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=run_job, args=(sender, *following[1]))
                process.start()
                sender.close()
                running[receiver] = following[0], process, time.monotonic() + MAX_DURATION
            if not running:
                return
            for receiver in connection.wait(list(running), timeout=1.0):
                index, process, _ = running.pop(receiver)
                yield index, receive(receiver, process)
                bar.update()
            for _, process, deadline in running.values():
                if time.monotonic() > deadline:
                    os.killpg(process.pid, signal.SIGKILL)
    finally:
        bar.close()
        for _, process, _ in running.values():
            os.killpg(process.pid, signal.SIGKILL)


def run_job(sender: Any, function: Any, *arguments: Any) -> None:
    """Run a job in a forked process, and send its result."""
    os.setsid()
    # A shell may have disabled SIGINT.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sender.send(function(*arguments))
    sender.close()


def receive(receiver: Any, process: Any) -> Any:
    """Return the result that a process sends, or an `Outcome` with the reason why it ended without one."""
    running = RUNNING_TESTS / str(process.pid)
    try:
        result = receiver.recv()
        process.join()
    except EOFError:
        process.join()
        cause = signal.Signals(-process.exitcode).name if process.exitcode < 0 else f"status {process.exitcode}"
        result = Outcome(f"{running.read_text()} (ended by {cause})", 0)
    running.unlink(missing_ok=True)
    return result
