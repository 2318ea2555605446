"""Mutation test of the sources: `make mutants`.

Each mutant is the source with one small change. A mutant that no test kills reveals a gap in the tests.

The run has two parts. First, every test runs once, and its duration and the lines that it runs are recorded. (The
lines of a formula run when it is compiled to machine code.) Then, for each mutant, the tests that run its line are run
until one of them fails. Tests in the file of the same name run first, then all others in order of their duration. Each
mutant is tested in its own process, which is forked from a process that has imported all libraries, but not this
project. A test that takes more than ten times its recorded CPU time plus 30 s counts as failed.

`survivors.yaml` lists mutants that no test can kill, each with the reason. The score of a package is the fraction of
killed mutants among those that are not listed there. The exit status is 1 if the score of any package is below 95 %.
"""

import argparse
import csv
import difflib
import hashlib
import importlib.util
import json
import os
import random
import sys
from collections import defaultdict
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path

from mutation import Mutant, mutants_of
from ruamel.yaml import YAML
from testing import MAX_DURATION, ROOT, Outcome, Test, kill, prepare, record_tests, run_forked
from tqdm import tqdm

OUTPUT = ROOT / "out" / "mutants"
SURVIVORS = Path(__file__).with_name("survivors.yaml")
MIN_SCORE = 0.95  # smallest fraction of killed mutants that passes
# Package name in the report for modules directly in drake_quad/.
TOP_LEVEL_MODULES = "(modules)"
# Files that are not mutated, because their code runs in other processes, where a mutant has no effect.
EXCLUDED_FILES = ("studies/cluster.py",)
# Folders whose code and tests need an optional library, with its name. They are not mutated if it is not installed.
OPTIONAL_LIBRARIES = {"gym/stable_baselines3/": "stable_baselines3"}
# Tests that are not run, because their code runs in other processes, or because they test the documentation.
EXCLUDED_TESTS = tuple(f"tests/{name}" for name in ("test_docs.py", "studies/test_cluster.py", "mutants/"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--number",
        default="40",
        help="number of mutants of each package, which are drawn evenly from its lines; or 'all'",
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed for drawing the mutants")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument(
        "--only",
        nargs="+",
        default=[""],
        help="mutate only files whose path in drake_quad/ begins with one of these prefixes",
    )
    parser.add_argument(
        "--tests", nargs="+", default=[""], help="run only tests whose path in tests/ begins with one of these prefixes"
    )
    parser.add_argument(
        "--seconds", type=float, default=40.0, help="limit on the total recorded CPU time of one mutant's tests, s"
    )
    arguments = parser.parse_args()
    if sys.version_info < (3, 12):
        print(
            "the mutation test needs Python 3.12 or newer, which can record the lines that a test runs", file=sys.stderr
        )
        return 2
    prepare()
    mutants = draw_mutants(arguments.number, arguments.seed, arguments.only)
    if not mutants:
        print(f"--only: no path of a file in drake_quad/ begins with {' or '.join(arguments.only)}", file=sys.stderr)
        return 2
    tests = recorded_tests(arguments.processes, arguments.tests)
    # Tests must pass with the unchanged sources. Otherwise, a failure could have another cause than the mutant.
    unchanged = [(file, mutant._replace(span=(0, 0), code="")) for file, mutant in one_of_each_package(mutants)]
    jobs = [
        (kill, file, mutant, tests_to_run(tests, file, mutant, arguments.seconds))
        for file, mutant in unchanged + mutants
    ]
    results: list[tuple[str, Mutant, Outcome]] = []
    # Mutants run in the order of the draw, so that the results before Ctrl-C are also a random sample.
    with suppress(KeyboardInterrupt):
        for index, outcome in run_forked(jobs, arguments.processes, "mutants"):
            if index < len(unchanged):
                if outcome.killer is not None:
                    raise RuntimeError(f"{outcome.killer}: fails without a mutant; fix the test or the sources first")
                continue
            mutant = mutants[index - len(unchanged)]
            results.append((*mutant, outcome))
            if outcome.killer is None:
                tqdm.write(f"survived: {difference(*mutant)}", file=sys.stderr, end="")
    return report(sorted(results, key=lambda result: (result[0], result[1].line)))


def package_of(file: str) -> str:
    """Return the folder in drake_quad/ to which a file belongs, or `TOP_LEVEL_MODULES`."""
    _, package, *inside = Path(file).parts
    return package if inside else TOP_LEVEL_MODULES


def draw_mutants(number: str, seed: int, only: list[str]) -> list[tuple[str, Mutant]]:
    """Draw random mutants of each package, and return pairs of a file and a mutant.

    A line gets a second mutant only after every line of its package has one. Packages alternate.

    Args:
        number: number of mutants of each package, or "all".
        seed: seed of the draw.
        only: only files whose path in drake_quad/ begins with one of these prefixes are mutated.
    """
    generator = random.Random(seed)
    by_line: dict[str, dict[tuple[str, int], list[tuple[str, Mutant]]]] = defaultdict(lambda: defaultdict(list))
    missing = [folder for folder, library in OPTIONAL_LIBRARIES.items() if importlib.util.find_spec(library) is None]
    for folder in missing:
        print(
            f"drake_quad/{folder}: not mutated, because {OPTIONAL_LIBRARIES[folder]} is not installed", file=sys.stderr
        )
    for path in sorted(Path("drake_quad").rglob("*.py")):
        inside = str(path.relative_to("drake_quad"))
        if inside.startswith(tuple(only)) and not inside.startswith((*EXCLUDED_FILES, *missing)):
            for mutant in mutants_of(path.read_text()):
                by_line[package_of(str(path))][str(path), mutant.line].append((str(path), mutant))
    chosen = []
    for package in by_line.values():
        lines = [generator.sample(mutants, len(mutants)) for _, mutants in sorted(package.items())]
        generator.shuffle(lines)
        rounds = range(max(map(len, lines)))
        in_order = [mutants[index] for index in rounds for mutants in lines if index < len(mutants)]
        chosen.append(in_order if number == "all" else in_order[: int(number)])
    return [mutant for mutants in zip_longest(*chosen) for mutant in mutants if mutant is not None]


def one_of_each_package(mutants: list[tuple[str, Mutant]]) -> list[tuple[str, Mutant]]:
    """Return the first mutant of each package."""
    return list({package_of(file): (file, mutant) for file, mutant in reversed(mutants)}.values())


def tests_to_run(tests: dict[str, Test], file: str, mutant: Mutant, seconds: float) -> dict[str, float]:
    """Return the tests that may kill a mutant, in the order in which to run them, with their durations (s).

    Tests that run the mutant's line come first. The other tests of the same test files follow, because the lines that a
    shared fixture runs are recorded for only one of the tests that use the fixture. If no test runs the line, it runs
    at import or in another process. The result then has all tests of the test files that run any line of the mutant's
    file or that test its package.

    Args:
        tests: records of all tests, by name.
        file: path of the source that the mutant changes.
        mutant: mutant of this source.
        seconds: limit of the total CPU time of the tests, s. Tests that would exceed it are omitted.
    """
    folder = Path(file).parent.relative_to("drake_quad")
    mirrored = str(Path("tests") / folder / f"test_{Path(file).name}")
    package = "tests/test_" if package_of(file) == TOP_LEVEL_MODULES else f"tests/{package_of(file)}/"
    runners = {name for name, test in tests.items() if any(line in mutant.lines for line in test.lines.get(file, ()))}
    if mutant.declared or not runners:
        candidates = {name for name, test in tests.items() if file in test.lines or name.startswith(package)}
        files = {name.split("::")[0] for name in candidates}
        runners = {name for name in tests if name.split("::")[0] in files}
    files = {name.split("::")[0] for name in runners}

    def rank(name: str) -> tuple[bool, bool, bool, float]:
        foreign = mutant.declared and not name.startswith(package)
        return name not in runners, not name.startswith(mirrored), foreign, tests[name].seconds

    chosen, total = {}, 0.0
    for name in sorted(tests, key=rank):
        if name.split("::")[0] in files and total + tests[name].seconds <= seconds:
            chosen[name] = tests[name].seconds
            total += tests[name].seconds
    return chosen


def recorded_tests(processes: int, only: list[str]) -> dict[str, Test]:
    """Return the record of each passing test. Records are saved and reused until a source changes.

    Args:
        processes: number of test files that run at the same time.
        only: only test files whose path in tests/ begins with one of these prefixes are run.
    """
    records_file = OUTPUT / "tests.json"
    records = json.loads(records_file.read_text()) if records_file.exists() else {}
    paths = sorted(
        path for folder in ("drake_quad", "scripts", "diagrams", "tests") for path in Path(folder).rglob("*.*")
    )
    begin = tuple(f"tests/{path}" for path in only)
    files = [str(path) for path in paths if path.match("test_*.py") and not str(path).startswith(EXCLUDED_TESTS)]
    files = [file for file in files if file.startswith(begin)]
    source_files = [path for path in paths if path.suffix in (".py", ".yaml", ".csv") and not path.match("test_*.py")]
    sources = b"".join(path.read_bytes() for path in source_files if path.parent.name != "mutants")
    digests = {file: hashlib.sha256(sources + Path(file).read_bytes()).hexdigest() for file in files}
    new = [file for file in files if records.get(file, {}).get("digest") != digests[file]]
    for index, result in run_forked([(record_tests, file) for file in new], processes, "test files"):
        if isinstance(result, Outcome):
            raise RuntimeError(f"cannot record which code the tests run, because of {result.killer}")
        recorded, failed = result
        for name in dict.fromkeys(failed):
            print(f"{name}: not used, because it fails without a mutant", file=sys.stderr)
        passing = {name: test for name, test in recorded.items() if name not in failed}
        records[new[index]] = {"digest": digests[new[index]], "tests": passing}
        records_file.write_text(json.dumps(records))
    return {name: Test(*test) for file in files for name, test in records[file]["tests"].items()}


def report(results: list[tuple[str, Mutant, Outcome]]) -> int:
    """Write and print a report on the outcomes of the mutants, and return the exit status."""
    listed = {
        (entry["file"], entry["before"], after): entry["reason"]
        for entry in YAML(typ="safe").load(SURVIVORS) or []
        for after in entry["after"]
    }
    survived = [(file, mutant) for file, mutant, outcome in results if outcome.killer is None]
    unlisted_survivors = [
        (file, mutant) for file, mutant in survived if (file, mutant.before, mutant.after) not in listed
    ]
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
    packages = sorted({package_of(file) for file, _, _ in results})
    print(f"{'package':16}{'mutants':>9}{'killed':>9}{'listed':>9}{'unlisted':>10}{'score':>9}")
    below = []
    for package in (*packages, "all"):
        count, alive, unlisted = (
            sum(package in (package_of(file), "all") for file, *_ in result)
            for result in (results, survived, unlisted_survivors)
        )
        killed = count - alive
        score = killed / (killed + unlisted) if killed + unlisted else 1.0
        print(f"{package:16}{count:9}{killed:9}{alive - unlisted:9}{unlisted:10}{score:9.1%}")
        if package != "all" and score < MIN_SCORE:
            below.append(package)
    num_timeouts = sum("SIGKILL" in (outcome.killer or "") for *_, outcome in results)
    if num_timeouts:
        print(
            f"{num_timeouts} mutants count as killed because their tests took more than {MAX_DURATION:.0f} s; run them"
            " again if the machine was suspended during the run"
        )
    print(f"wrote\n  {OUTPUT / 'mutants.csv'}\n  {OUTPUT / 'survivors.txt'}")
    if below:
        print(f"score below {MIN_SCORE:.0%}: {', '.join(below)}", file=sys.stderr)
    return int(bool(below))


def difference(file: str, mutant: Mutant) -> str:
    """Return the position of a mutant and the lines that it changes, before and after."""
    text = Path(file).read_text()
    changes = difflib.unified_diff(text.splitlines(), mutant.applied(text).splitlines(), n=0, lineterm="")
    return f"{file}:{mutant.line} ({mutant.kind})\n" + "".join(f"    {line}\n" for line in list(changes)[3:])


if __name__ == "__main__":
    sys.exit(main())
