"""What the scripts' command lines have in common."""

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

from interruption import SENTENCE, raise_interruptions

from tqdm import tqdm

from drake_quad import InputError, Scenario, load_scenario
from drake_quad.framework.formulas import telling_of_compilation
from drake_quad.scenario import Journey, Override, load_journey
from drake_quad.scenario.models import NAME
from drake_quad.visualization.style import Vector

# The thread that watches bars would be in the way of worker processes, which are forked from a process with one thread.
tqdm.monitor_interval = 0


def parser(description: str, example: str, *, output: str | None, scenario: str) -> argparse.ArgumentParser:
    """Returns a parser with the arguments that every script has.

    Args:
        description: what the script does, a sentence.
        example: a command line that runs.
        output: folder in which what the script writes has a folder by default, called after the scenario; None for a
            script that writes nothing.
        scenario: default scenario, a file of `diagrams/`.
    """
    result = argparse.ArgumentParser(
        description=description,
        epilog=f"example: {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    shipped = os.path.relpath(Path(__file__).parent.parent / "diagrams" / scenario)
    result.add_argument("scenario", nargs="?", default=shipped, help="FILE or FILE:NAME (default: %(default)s)")
    result.add_argument(
        "--set",
        metavar="FIELD=VALUE",
        action="append",
        default=[],
        help="override a field, as in nominal.mass=0.7 or route.waypoints.2=[1,0,1]",
    )
    result.add_argument("--seed", type=int, help="seed of everything random (default: the scenario's)")
    if output is not None:
        result.set_defaults(default_output=Path(output))
        result.add_argument(
            "--output", type=Path, metavar="FOLDER", help=f"to write to (default: {output}/NAME, after the scenario)"
        )
    return result


def folder_of(arguments: argparse.Namespace, name: str) -> Path:
    """The folder to write to: the one that a person says, or else one called after the scenario."""
    chosen: Path = arguments.output or arguments.default_output / name
    return chosen


def add_vector(options: argparse.ArgumentParser) -> None:
    """Adds the option that draws figures for print."""
    options.add_argument("--vector", choices=get_args(Vector), help="write each figure also as a vector drawing")


def overrides_of(assignments: Iterable[str], option: str = "--set") -> list[Override]:
    """The overrides that an option of the command line gives."""
    return [Override(assignment, f"{option} {assignment}") for assignment in assignments]


def all_overrides_of(arguments: argparse.Namespace) -> list[Override]:
    """The overrides that the arguments --set and --seed give."""
    seed = [] if arguments.seed is None else [Override(f"seed={arguments.seed}", f"--seed {arguments.seed}")]
    return [*overrides_of(arguments.set), *seed]


def scenario_of(arguments: argparse.Namespace, *, further: Sequence[Override] = ()) -> Scenario:
    """Loads the scenario that the arguments name, with their overrides and further ones."""
    return load_scenario(arguments.scenario, [*all_overrides_of(arguments), *further])


def controlled_scenarios(arguments: argparse.Namespace) -> dict[str, Scenario]:
    """Loads the scenario with each of the arguments' controllers laid over it, by their names; itself without any."""
    if not arguments.controller:
        scenario = scenario_of(arguments)
        return {scenario.name: scenario}
    overrides = all_overrides_of(arguments)
    found: dict[str, Scenario] = {}
    for controller in arguments.controller:
        name = Path(controller.rpartition(":")[2]).stem
        if not re.fullmatch(NAME, name):
            raise InputError(f"--controller {controller}: {name!r} is no name for a folder; use letters and digits")
        if name in found:
            raise InputError(f"--controller {controller}: {name} is to be flown already; give each its own name")
        found[name] = load_scenario(arguments.scenario, overrides, layers=[controller])
    return found


def journey_of(arguments: argparse.Namespace) -> Journey:
    """Loads the route and the nominal vehicle that the arguments name, with their overrides."""
    return load_journey(arguments.scenario, overrides_of(arguments.set))


@contextmanager
def flight_progress() -> Iterator[Callable[[float, float], None]]:
    """Gives a function of the time flown and to fly (s) that keeps a bar on a terminal, if it takes long."""
    with tqdm(total=0.0, desc="flying", delay=1.0, leave=False, bar_format=_BAR, disable=None) as bar:

        def show(flown: float, duration: float) -> None:
            bar.total = duration
            bar.update(flown - bar.n)

        yield show


@contextmanager
def study_progress(name: str) -> Iterator[Callable[[int, int], None]]:
    """Gives a function of the number of samples that are done, and of all, that keeps a bar on a terminal."""
    with tqdm(desc=name, unit=" flights", leave=False, disable=None, mininterval=0.2) as bar:

        def show(done: int, total: int) -> None:
            if bar.total is None:
                bar.reset(total)
                bar.initial = done
            bar.update(done - bar.n)

        yield show


def bar_over(items: Sequence[str], words: str) -> Iterator[str]:
    """Gives items one after the other, with a bar on a terminal."""
    with tqdm(items, desc=words, leave=False, disable=None) as bar:
        for item in bar:
            bar.set_postfix_str(item)
            yield item


_BAR = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f} of {total:.0f} s flown, {remaining} to go"


def print_table(rows: list[tuple[str, str, str]]) -> None:
    """Prints rows of name, value and unit, aligned."""
    names, values = (max(len(row[i]) for row in rows) for i in (0, 1))
    for name, value, unit in rows:
        print(f"{name:<{names}}  {value:>{values}} {unit}".rstrip())


def print_columns(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Prints a table with a header; the first and the last column to the left, the others to the right."""
    table = [header, *rows]
    widths = [max(len(line[i]) for line in table) for i in range(len(header))]
    for line in table:
        cells = [cell.rjust(width) for cell, width in zip(line, widths, strict=True)]
        print("  ".join([line[0].ljust(widths[0]), *cells[1:-1], line[-1]]).rstrip())


def remark(sentence: str) -> None:
    """Prints what a person may not have meant."""
    print(f"remark: {sentence}", file=sys.stderr)


def print_files(files: list[Path]) -> None:
    """Prints what was written."""
    print("wrote")
    for file in files:
        print(f"  {file}")


COMPILING = "compiling what is flown for the first time on this machine: up to half a minute"


def run(main: Callable[[], None]) -> None:
    """Runs a script: 0 done, 1 the computation failed, 2 the input was wrong, each with one sentence."""
    raise_interruptions()
    try:
        with telling_of_compilation(lambda: print(COMPILING, file=sys.stderr)):
            main()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nobody reads what is still to be printed
        sys.exit(1)
    except (RuntimeError, OSError) as error:
        print(f"failed: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt as interruption:
        print(str(interruption) or SENTENCE, file=sys.stderr)
        sys.exit(1)
