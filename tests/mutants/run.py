"""Mutation test of the sources: `make mutants`.

Each mutant is the source with one small change. A mutant that no test kills points to a hole in the tests.

The run has two parts. First, every test runs once, and the lines that it runs and its duration are recorded. (The
lines of a formula run when machine code is made of it.) Then each mutant runs the tests that run its line until one of
them fails. Tests in the file of the same name come first, the others follow by duration. Each mutant runs in its own
process, which is forked from one that has imported every library but not this project. A test that takes ten times
longer than before counts as failed.

`survivors.yaml` lists mutants that no test can kill, each with the reason. The score of a package is the share of
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
from testing import ROOT, Outcome, Test, forked, kill, note, prepare
from tqdm import tqdm

OUTPUT = ROOT / "out" / "mutants"
SURVIVORS = Path(__file__).with_name("survivors.yaml")
MIN_SCORE = 0.95
# Modules that belong to no package, such as drake_quad/geometry/axes.py, are reported under this name.
MODULES = "(modules)"
# Files whose code runs in other processes, where a mutant has no effect.
LEFT_OUT = ("studies/cluster.py",)
# Folders whose code and tests need an optional library. They are left out where it is not installed.
OPTIONAL = {"gym/stable_baselines3/": "stable_baselines3"}
# Tests whose code runs in other processes, and tests of the pages of the documentation.
WITHOUT = tuple(f"tests/{name}" for name in ("test_docs.py", "studies/test_cluster.py", "mutants/"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--number", default="40", help="number of mutants of each package, drawn evenly over its lines; or 'all'"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the draw")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument(
        "--only", nargs="+", default=[""], help="mutate only files whose path in drake_quad/ begins with one of these"
    )
    parser.add_argument(
        "--tests", nargs="+", default=[""], help="run only tests whose path in tests/ begins with one of these"
    )
    parser.add_argument(
        "--seconds", type=float, default=40.0, help="CPU time that the tests of one mutant may take together, s"
    )
    arguments = parser.parse_args()
    if sys.version_info < (3, 12):
        print("a mutation test needs Python 3.12 or newer, to record the lines that a test runs", file=sys.stderr)
        return 2
    prepare()
    mutants = drawn(arguments.number, arguments.seed, arguments.only)
    if not mutants:
        print(f"no mutants: no file in drake_quad/ begins with {' or '.join(arguments.only)}", file=sys.stderr)
        return 2
    tests = noted_tests(arguments.processes, arguments.tests)
    # Sources without a change must pass. Otherwise a test fails for another reason than the mutant.
    unchanged = [(file, mutant._replace(place=(0, 0), code="")) for file, mutant in one_of_each_package(mutants)]
    jobs = [
        (kill, file, mutant, worth_running(tests, file, mutant, arguments.seconds))
        for file, mutant in unchanged + mutants
    ]
    results: list[tuple[str, Mutant, Outcome]] = []
    # Results follow the order of the draw, so that those before Ctrl-C are a fair sample, too.
    with suppress(KeyboardInterrupt):
        for place, outcome in forked(jobs, arguments.processes, "mutants"):
            if place < len(unchanged):
                if outcome.killer is not None:
                    raise RuntimeError(f"a test fails without any mutant: {outcome.killer}")
                continue
            mutant = mutants[place - len(unchanged)]
            results.append((*mutant, outcome))
            if outcome.killer is None:
                tqdm.write(f"survived: {difference(*mutant)}", file=sys.stderr, end="")
    return report(sorted(results, key=lambda result: (result[0], result[1].line)))


def package_of(file: str) -> str:
    """Return the package that a file in drake_quad/ belongs to."""
    _, package, *inside = Path(file).parts
    return package if inside else MODULES


def drawn(number: str, seed: int, only: list[str]) -> list[tuple[str, Mutant]]:
    """Draw mutants of each package, and return files and mutants.

    Every line of a package has one mutant before any line has a second one. Packages alternate.

    Args:
        number: number of mutants of each package, or "all".
        seed: seed of the draw.
        only: beginnings of the paths of files in drake_quad/ to draw from.
    """
    generator = random.Random(seed)
    by_line: dict[str, dict[tuple[str, int], list[tuple[str, Mutant]]]] = defaultdict(lambda: defaultdict(list))
    missing = [folder for folder, library in OPTIONAL.items() if importlib.util.find_spec(library) is None]
    for folder in missing:
        print(f"left out because {OPTIONAL[folder]} is not installed: drake_quad/{folder}", file=sys.stderr)
    for path in sorted(Path("drake_quad").rglob("*.py")):
        inside = str(path.relative_to("drake_quad"))
        if inside.startswith(tuple(only)) and not inside.startswith((*LEFT_OUT, *missing)):
            for mutant in mutants_of(path.read_text()):
                by_line[package_of(str(path))][str(path), mutant.line].append((str(path), mutant))
    chosen = []
    for package in by_line.values():
        lines = [generator.sample(mutants, len(mutants)) for _, mutants in sorted(package.items())]
        generator.shuffle(lines)
        rounds = range(max(map(len, lines)))
        in_order = [mutants[place] for place in rounds for mutants in lines if place < len(mutants)]
        chosen.append(in_order if number == "all" else in_order[: int(number)])
    return [mutant for mutants in zip_longest(*chosen) for mutant in mutants if mutant is not None]


def one_of_each_package(mutants: list[tuple[str, Mutant]]) -> list[tuple[str, Mutant]]:
    """Return the first mutant of each package."""
    return list({package_of(file): (file, mutant) for file, mutant in reversed(mutants)}.values())


def worth_running(tests: dict[str, Test], file: str, mutant: Mutant, seconds: float) -> dict[str, float]:
    """Return the tests that may kill a mutant, in the order in which to run them, and their durations, s.

    These are the tests that run the mutant's line. Other tests of the same files follow, because what a fixture of the
    module has run is not recorded for the tests that share it. If no test runs the line, it runs at import or in
    another process: then all tests are returned of the files that run any line of the mutant's file or that test its
    package.

    Args:
        tests: record of each test.
        file: path of the source that the mutant changes.
        mutant: one change of that source.
        seconds: CPU time that the tests may take together, s. Tests that would exceed it are left out.
    """
    folder = Path(file).parent.relative_to("drake_quad")
    mirrored = str(Path("tests") / folder / f"test_{Path(file).name}")
    package = "tests/test_" if package_of(file) == MODULES else f"tests/{package_of(file)}/"
    runners = {name for name, test in tests.items() if any(line in mutant.lines for line in test.lines.get(file, ()))}
    if mutant.declared or not runners:
        near = {name for name, test in tests.items() if file in test.lines or name.startswith(package)}
        files = {name.split("::")[0] for name in near}
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


def noted_tests(processes: int, only: list[str]) -> dict[str, Test]:
    """Return the record of each test that passes. Records are kept until a source changes.

    Args:
        processes: number of test files that run at the same time.
        only: beginnings of the paths of test files in tests/.
    """
    kept = OUTPUT / "tests.json"
    known = json.loads(kept.read_text()) if kept.exists() else {}
    paths = sorted(
        path for folder in ("drake_quad", "scripts", "diagrams", "tests") for path in Path(folder).rglob("*.*")
    )
    begin = tuple(f"tests/{path}" for path in only)
    files = [str(path) for path in paths if path.match("test_*.py") and not str(path).startswith(WITHOUT)]
    files = [file for file in files if file.startswith(begin)]
    others = [path for path in paths if path.suffix in (".py", ".yaml", ".csv") and not path.match("test_*.py")]
    sources = b"".join(path.read_bytes() for path in others if path.parent.name != "mutants")
    digests = {file: hashlib.sha256(sources + Path(file).read_bytes()).hexdigest() for file in files}
    new = [file for file in files if known.get(file, {}).get("digest") != digests[file]]
    for place, result in forked([(note, file) for file in new], processes, "test files"):
        if isinstance(result, Outcome):
            raise RuntimeError(f"{result.killer} does not end")
        noted, failed = result
        for name in dict.fromkeys(failed):
            print(f"left out because it fails: {name}", file=sys.stderr)
        passing = {name: test for name, test in noted.items() if name not in failed}
        known[new[place]] = {"digest": digests[new[place]], "tests": passing}
        kept.write_text(json.dumps(known))
    return {name: Test(*test) for file in files for name, test in known[file]["tests"].items()}


def report(results: list[tuple[str, Mutant, Outcome]]) -> int:
    """Write and print the outcomes of the mutants, and return the exit status."""
    listed = {
        (entry["file"], entry["before"], after): entry["reason"]
        for entry in YAML(typ="safe").load(SURVIVORS) or []
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
    packages = sorted({package_of(file) for file, _, _ in results})
    print(f"{'package':16}{'mutants':>9}{'killed':>9}{'listed':>9}{'holes':>9}{'score':>9}")
    below = []
    for package in (*packages, "all"):
        count, alive, unlisted = (
            sum(package in (package_of(file), "all") for file, *_ in found) for found in (results, survived, holes)
        )
        killed = count - alive
        score = killed / (killed + unlisted) if killed + unlisted else 1.0
        print(f"{package:16}{count:9}{killed:9}{alive - unlisted:9}{unlisted:9}{score:9.1%}")
        if package != "all" and score < MIN_SCORE:
            below.append(package)
    late = sum("SIGKILL" in (outcome.killer or "") for *_, outcome in results)
    if late:
        print(f"{late} mutants count as killed because they took 600 s by the clock; a paused machine does so, too")
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
