"""Changes the sources in one place at a time and tells which changes no test notices: `make mutants`.

First every test runs once, formulas interpreted, and it is noted which lines it runs and how long it takes. Then, for
each mutant, the tests that run its line run until one fails: those of the file of its name first, then the quickest.
A mutant has its own process, forked from one that has imported everything but this project; its machine code is not
made: what comes from the changed file stays Python. A test that takes ten times as long as before has failed.

A mutant that survives is either in `survivors.yaml`, with the reason why it may, or a hole in the tests. The exit
status is 1 if the holes are more than 5 % of the mutants.
"""

import argparse
import csv
import difflib
import gc
import hashlib
import importlib
import json
import multiprocessing
import os
import random
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
from mutation import Mutant, mutants_of
from ruamel.yaml import YAML
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
OUTPUT = ROOT / "out" / "mutants"
PACKAGES = ("vehicle", "control", "laboratory", "reference", "analysis")
# What writes reports is looked at, not computed with.
LEFT_OUT = {"analysis/replication/report.py", "analysis/replication/assumptions.py"}
# Tests whose work is done by other processes, which see no mutant, and those of pages and of the compiler.
WITHOUT = tuple(
    f"tests/{name}"
    for name in (
        "test_docs.py",
        "test_compiled.py",
        "analysis/monte_carlo/test_cluster.py",
        "visualization/",
        "mutants/",
    )
)
THIRD_PARTY = (
    "pydrake.all", "control", "dask.distributed", "markdown", "matplotlib.pyplot", "mpl_toolkits.mplot3d", "numba",
    "minsnap_trajectories", "pydantic", "pyit2fls", "scipy.integrate", "scipy.optimize", "scipy.signal", "scipy.stats",
)  # fmt: skip
# Seconds of tests, by the processor's time, that a mutant is worth; and that a test may always take.
WORTH, LEAST = 20.0, 10.0
# Seconds by the clock that no mutant needs: processes that wait for each other use no time of the processor.
LONGEST = 600.0
MOST_HOLES = 0.05


class Test(NamedTuple):
    """What was noted of a test: the processor's time that it took, in s, and lines that it runs, by file."""

    seconds: float
    lines: dict[str, list[int]]


class Outcome(NamedTuple):
    """What became of a mutant: by which test it was killed, if any, and after how many tests."""

    killer: str | None
    num_tests: int


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", default="500", help="of mutants, drawn evenly over the lines; or all")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--only", default="", help="mutants of the files whose path begins so, from drake_quad/ on")
    arguments = parser.parse_args()
    prepare()
    tests = noted_tests(arguments.processes)
    mutants = drawn(arguments.number, arguments.seed, arguments.only)
    jobs = [(kill, file, mutant, worth_running(tests, file, mutant)) for file, mutant in mutants]
    results = []
    for place, outcome in forked(jobs, arguments.processes, "mutants"):
        results.append((*mutants[place], outcome))
        if outcome.killer is None:
            tqdm.write(f"survived: {difference(*mutants[place])}", file=sys.stderr, end="")
    return report(sorted(results, key=lambda result: (result[0], result[1].line)))


def prepare() -> None:
    """Imports all but this project, for the processes to come, and makes tests repeat themselves."""
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    OUTPUT.mkdir(parents=True, exist_ok=True)
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


# -- mutants


def drawn(number: str, seed: int, only: str) -> list[tuple[str, Mutant]]:
    """So many mutants: one of each line, lines in disorder, then another one of each."""
    generator, by_line = random.Random(seed), defaultdict(list)
    for package in PACKAGES:
        for path in sorted(Path("drake_quad", package).rglob("*.py")):
            if str(path).startswith(only) and str(path.relative_to("drake_quad")) not in LEFT_OUT:
                for mutant in mutants_of(path.read_text()):
                    by_line[str(path), mutant.line].append((str(path), mutant))
    lines = [generator.sample(mutants, len(mutants)) for _, mutants in sorted(by_line.items())]
    generator.shuffle(lines)
    rounds = range(max(map(len, lines)))
    in_order = [mutants[place] for place in rounds for mutants in lines if place < len(mutants)]
    return in_order if number == "all" else in_order[: int(number)]


def worth_running(tests: dict[str, Test], file: str, mutant: Mutant) -> dict[str, float]:
    """Tests that may kill a mutant, in order, and how long each one took, in s.

    What another test of a file has left, as a fixture of the module does, is not seen in lines: the other tests of such
    a file come last. What is declared is run by none: tests that run any line of the file, or those of the package.
    """
    package = file.split("/")[1]
    mirrored = f"tests/{Path(file).parent.relative_to('drake_quad')}/test_{Path(file).name}"

    def runs(name: str, test: Test) -> bool:
        lines = test.lines.get(file, [])
        return bool(lines) if mutant.declared else any(line in mutant.lines for line in lines)

    files = {name.split("::")[0] for name, test in tests.items() if runs(name, test)}
    if mutant.declared:
        files |= {name.split("::")[0] for name in tests if name.startswith(f"tests/{package}/")}

    def rank(item: tuple[str, Test]) -> tuple[bool, bool, float]:
        name, test = item
        return not runs(name, test), not name.startswith(mirrored), test.seconds

    chosen, total = {}, 0.0
    for name, test in sorted(tests.items(), key=rank):
        if name.split("::")[0] in files and total + test.seconds <= WORTH:
            chosen[name] = test.seconds
            total += test.seconds
    return chosen


# -- what forked processes do


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
            sys.monitoring.restart_events()
        else:
            limit_time(item.nodeid, 10.0 * self.chosen[item.nodeid] + LEAST)
        start = time.process_time()
        result = yield
        seconds = time.process_time() - start
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


def limit_time(what: str, seconds: float) -> None:
    """Ends this process if it takes more of the processor's time, and leaves what it did."""
    Path(OUTPUT, "running", str(os.getpid())).write_text(what)
    signal.setitimer(signal.ITIMER_PROF, seconds)


def note(file: str) -> tuple[dict[str, Test], list[str]]:
    """Runs the tests of a file and returns what was noted of them, and those that fail."""
    os.environ["DRAKE_QUAD_INTERPRETED"] = os.pathsep.join(str(ROOT / "drake_quad" / name) for name in PACKAGES)
    plugin = Plugin()
    plugin.note_lines()
    run_pytest(plugin, file)
    return plugin.noted, plugin.failed


def kill(file: str, mutant: Mutant, tests: dict[str, float]) -> Outcome:
    """Runs tests on a mutant until one fails."""
    path, text = str(ROOT / file), mutant.applied(Path(file).read_text())
    os.environ["DRAKE_QUAD_INTERPRETED"] = path
    code_of = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, name: str) -> Any:
        return compile(text, path, "exec") if loader.path == path else code_of(loader, name)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]
    plugin = Plugin(tests)
    for test_file in dict.fromkeys(name.split("::")[0] for name in tests):
        limit_time(test_file, 60.0)
        status = run_pytest(plugin, test_file)
        if status != pytest.ExitCode.OK:
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


# -- the processes


def forked(jobs: list[tuple[Any, ...]], processes: int, what: str) -> Iterator[tuple[int, Any]]:
    """The places and results of jobs, a function and its arguments each, as they end.

    Every one is in a process of its own. If that is ended, by its time or by the system, the result is an `Outcome`.
    """
    context, waiting = multiprocessing.get_context("fork"), enumerate(jobs)
    running: dict[Any, tuple[int, Any, float]] = {}
    Path(OUTPUT, "running").mkdir(exist_ok=True)
    with tqdm(total=len(jobs), desc=what, smoothing=0.02) as bar:
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


def do(there: Any, function: Any, *arguments: Any) -> None:
    """Runs a job in a forked process and sends what it returns."""
    os.setsid()
    there.send(function(*arguments))
    there.close()


def received(here: Any, process: Any) -> Any:
    note = Path(OUTPUT, "running", str(process.pid))
    try:
        result = here.recv()
    except EOFError:
        process.join()
        if process.exitcode > 0:
            raise RuntimeError("a process of the mutation run failed; see its traceback above") from None
        result = Outcome(f"{note.read_text()} (ended by {signal.Signals(-process.exitcode).name})", 0)
    process.join()
    note.unlink(missing_ok=True)
    return result


# -- what is found


def noted_tests(processes: int) -> dict[str, Test]:
    """What is noted of each test that passes with formulas interpreted; kept for as long as no source changes."""
    kept = OUTPUT / "tests.json"
    known = json.loads(kept.read_text()) if kept.exists() else {}
    paths = sorted(
        path for folder in ("drake_quad", "scripts", "diagrams", "tests") for path in Path(folder).rglob("*.*")
    )
    files = [str(path) for path in paths if path.match("test_*.py") and not str(path).startswith(WITHOUT)]
    others = [path for path in paths if path.suffix in (".py", ".yaml", ".csv") and not path.match("test_*.py")]
    sources = b"".join(path.read_bytes() for path in others if path.parent.name != "mutants")
    digests = {file: hashlib.sha256(sources + Path(file).read_bytes()).hexdigest() for file in files}
    new = [file for file in files if known.get(file, {}).get("digest") != digests[file]]
    known = {file: known[file] for file in files if file not in new}
    for place, result in forked([(note, file) for file in new], processes, "test files"):
        if isinstance(result, Outcome):
            raise RuntimeError(f"{result.killer} does not end")
        noted, failed = result
        for name in dict.fromkeys(failed):
            print(f"left out, as it fails where formulas are interpreted: {name}", file=sys.stderr)
        passing = {name: test for name, test in noted.items() if name not in failed}
        known[new[place]] = {"digest": digests[new[place]], "tests": passing}
        kept.write_text(json.dumps(known))
    return {name: Test(*test) for file in known.values() for name, test in file["tests"].items()}


def report(results: list[tuple[str, Mutant, Outcome]]) -> int:
    """Writes and prints what became of the mutants; returns the exit status."""
    listed = {
        (entry["file"], entry["before"], after): entry["reason"]
        for entry in YAML(typ="safe").load(Path(__file__).with_name("survivors.yaml")) or []
        for after in entry["after"]
    }
    survived = [(file, mutant) for file, mutant, outcome in results if outcome.killer is None]
    holes = [(file, mutant) for file, mutant in survived if (file, mutant.before, mutant.after) not in listed]
    with (OUTPUT / "mutants.csv").open("w", newline="") as table:
        writer = csv.writer(table)
        writer.writerow(["file", "line", "kind", "before", "after", "killer", "tests"])
        for file, mutant, outcome in results:
            row = [file, mutant.line, mutant.kind, mutant.before, mutant.after]
            writer.writerow([*row, outcome.killer or "", outcome.num_tests])
    with (OUTPUT / "survivors.txt").open("w") as table:
        for file, mutant in survived:
            reason = listed.get((file, mutant.before, mutant.after), "not listed")
            table.write(f"{difference(file, mutant)}    {reason}\n\n")
    print(f"{'':12}{'mutants':>9}{'killed':>9}{'survived':>10}{'listed':>8}{'killed':>9}")
    for package in (*PACKAGES, ""):
        start = f"drake_quad/{package}"
        count = sum(file.startswith(start) for file, _, _ in results)
        alive, unlisted = (sum(file.startswith(start) for file, _ in found) for found in (survived, holes))
        share = f"{(count - alive) / count:9.1%}" if count else f"{'':9}"
        print(f"{package or 'all':12}{count:9}{count - alive:9}{alive:10}{alive - unlisted:8}{share}")
    print(f"wrote\n  {OUTPUT / 'mutants.csv'}\n  {OUTPUT / 'survivors.txt'}")
    return int(len(holes) > MOST_HOLES * len(results))


def difference(file: str, mutant: Mutant) -> str:
    """Where a mutant is, and the lines that it changes, as they were and as they are."""
    text = Path(file).read_text()
    changes = difflib.unified_diff(text.splitlines(), mutant.applied(text).splitlines(), n=0, lineterm="")
    return f"{file}:{mutant.line} ({mutant.kind})\n" + "".join(f"    {line}\n" for line in list(changes)[3:])


if __name__ == "__main__":
    sys.exit(main())
