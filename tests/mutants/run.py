"""Changes the sources in one place at a time and tells which changes no test notices: `make mutants`.

First every test runs once, and it is noted which lines it runs and how long it takes; the lines of a formula run when
machine code is made of it. Then, for each mutant, the tests that run its line run until one fails: those of the file of
its name first, then the quickest. A mutant has its own process, forked from one that has imported everything but this
project. A test that takes ten times as long as before has failed.

A mutant that survives is either in `survivors.yaml`, with the reason why it may, or a hole in the tests. The exit
status is 1 if the holes are more than 5 % of the mutants.
"""

import argparse
import csv
import difflib
import hashlib
import json
import os
import random
import sys
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

from mutation import Mutant, mutants_of
from ruamel.yaml import YAML
from testing import ROOT, Outcome, Test, forked, kill, note, prepare
from tqdm import tqdm

OUTPUT = ROOT / "out" / "mutants"
PACKAGES = (
    "vehicle", "control", "laboratory", "reference", "analysis", "studies", "replication", "randomness", "assembly",
    "framework", "compilation", "flight", "scenario",
)  # fmt: skip
# What writes and draws a report is looked at, not computed with; what speaks to a cluster is tested by processes of its
# own.
LEFT_OUT = {
    "studies/cluster.py",
    "evaluation/entries.py",
    "evaluation/figures.py",
    "evaluation/report.py",
    "replication/assumptions.py",
    "replication/figures.py",
    "replication/report.py",
}
# Tests whose work is done by other processes, which see no mutant, and those of pages.
WITHOUT = tuple(
    f"tests/{name}"
    for name in (
        "test_docs.py",
        "studies/test_cluster.py",
        "visualization/",
        "mutants/",
    )
)
# Seconds of tests, by the processor's time, that a mutant is worth.
WORTH = 20.0
MOST_HOLES = 0.05


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", default="500", help="of mutants, drawn evenly over the lines; or all")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument(
        "--only", nargs="+", default=[""], help="mutants of the files whose paths begin so, from drake_quad/ on"
    )
    arguments = parser.parse_args()
    if sys.version_info < (3, 12):
        print("a mutation run needs Python 3.12 or newer, which tells what lines a test runs", file=sys.stderr)
        return 2
    prepare()
    tests = noted_tests(arguments.processes)
    mutants = drawn(arguments.number, arguments.seed, arguments.only)
    # What does not change must survive: else a test fails for another reason than a mutant.
    unchanged = [(file, mutant._replace(place=(0, 0), code="")) for file, mutant in one_of_each_package(mutants)]
    jobs = [(kill, file, mutant, worth_running(tests, file, mutant)) for file, mutant in unchanged + mutants]
    results: list[tuple[str, Mutant, Outcome]] = []
    # In the order of the draw, so that those until Ctrl-C are a fair sample, too.
    with suppress(KeyboardInterrupt):
        for place, outcome in forked(jobs, arguments.processes, "mutants"):
            if place < len(unchanged):
                if outcome.killer is not None:
                    raise RuntimeError(f"without a mutant, too, tests fail: {outcome.killer}")
                continue
            mutant = mutants[place - len(unchanged)]
            results.append((*mutant, outcome))
            if outcome.killer is None:
                tqdm.write(f"survived: {difference(*mutant)}", file=sys.stderr, end="")
    return report(sorted(results, key=lambda result: (result[0], result[1].line)))


def drawn(number: str, seed: int, only: list[str]) -> list[tuple[str, Mutant]]:
    """So many mutants: one of each line, lines in disorder, then another one of each."""
    generator, by_line = random.Random(seed), defaultdict(list)
    for package in PACKAGES:
        for path in sorted(Path("drake_quad", package).rglob("*.py")):
            if str(path).startswith(tuple(only)) and str(path.relative_to("drake_quad")) not in LEFT_OUT:
                for mutant in mutants_of(path.read_text()):
                    by_line[str(path), mutant.line].append((str(path), mutant))
    lines = [generator.sample(mutants, len(mutants)) for _, mutants in sorted(by_line.items())]
    generator.shuffle(lines)
    rounds = range(max(map(len, lines)))
    in_order = [mutants[place] for place in rounds for mutants in lines if place < len(mutants)]
    return in_order if number == "all" else in_order[: int(number)]


def one_of_each_package(mutants: list[tuple[str, Mutant]]) -> list[tuple[str, Mutant]]:
    """The first mutant of each package."""
    return list({file.split("/")[1]: (file, mutant) for file, mutant in reversed(mutants)}.values())


def worth_running(tests: dict[str, Test], file: str, mutant: Mutant) -> dict[str, float]:
    """Tests that may kill a mutant, in order, and how long each one took, in s.

    Those that run its line; what another test has left, as a fixture of the module does, is not seen in lines, so the
    other tests of the same files come last. Where none runs it, as it runs in an import or in another process: all of
    the files with one that runs any line of the mutant's file, and those of its package.
    """
    package = file.split("/")[1]
    mirrored = f"tests/{Path(file).parent.relative_to('drake_quad')}/test_{Path(file).name}"
    runners = {name for name, test in tests.items() if any(line in mutant.lines for line in test.lines.get(file, ()))}
    if mutant.declared or not runners:
        near = {name for name, test in tests.items() if file in test.lines or name.startswith(f"tests/{package}/")}
        files = {name.split("::")[0] for name in near}
        runners = {name for name in tests if name.split("::")[0] in files}
    files = {name.split("::")[0] for name in runners}

    def rank(name: str) -> tuple[bool, bool, float]:
        return name not in runners, not name.startswith(mirrored), tests[name].seconds

    chosen, total = {}, 0.0
    for name in sorted(tests, key=rank):
        if name.split("::")[0] in files and total + tests[name].seconds <= WORTH:
            chosen[name] = tests[name].seconds
            total += tests[name].seconds
    return chosen


def noted_tests(processes: int) -> dict[str, Test]:
    """What is noted of each test that passes; kept for as long as no source changes."""
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
            print(f"left out, as it fails: {name}", file=sys.stderr)
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
