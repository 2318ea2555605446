"""What the command lines of all scripts share: arguments, progress bars, tables and exit codes."""

import argparse
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from interruption import SENTENCE, raise_interruptions

from drake_quad import InputError, Scenario, load_scenario
from drake_quad.scenario import Mission, Override, load_mission
from drake_quad.scenario.models import NAME
from drake_quad.visualization.style import Vector

if TYPE_CHECKING:
    from drake_quad.identification.flown_again.prediction import Predictions

# Of what is predicted: factor and unit for the eye.
_PREDICTED = {
    "position": (1e2, "cm"),
    "height": (1e2, "cm"),
    "attitude": (180.0 / math.pi, "°"),
    "body_rates": (1.0, "rad/s"),
}


def parser(description: str, example: str, *, output: str | None, scenario: str) -> argparse.ArgumentParser:
    """Returns a parser with the arguments that every script has.

    Args:
        description: a sentence that says what the script does.
        example: a command line that can be run as it is.
        output: folder that by default holds a folder for each scenario; None for a script that writes nothing.
        scenario: the default one, a file of `diagrams/`.
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
    """The folder to write to: that of --output, or else the default one for a scenario of this name."""
    chosen: Path = arguments.output or arguments.default_output / name
    return chosen


def add_vector(options: argparse.ArgumentParser) -> None:
    """Adds the option that writes figures for print."""
    options.add_argument("--vector", choices=get_args(Vector), help="write each figure also as a vector drawing")


def check_ranges(arguments: argparse.Namespace, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Raises InputError if a number is out of its range, given by the option without its dashes."""
    for option, (least, most) in ranges.items():
        value = getattr(arguments, option.replace("-", "_"))
        if not least <= value <= most:
            raise InputError(f"--{option} is {value:g}, but must be between {least:g} and {most:g}")


def add_wired(options: argparse.ArgumentParser) -> None:
    """Adds the option that flies diagrams as they are wired."""
    options.add_argument(
        "--wired", action="store_true", help="fly diagrams as they are wired, not compiled to machine code: slower"
    )


def overrides_of(assignments: Iterable[str], option: str = "--set") -> list[Override]:
    """The overrides that an option of the command line asks for; errors will name the option."""
    return [Override(assignment, f"{option} {assignment}") for assignment in assignments]


def all_overrides_of(arguments: argparse.Namespace) -> list[Override]:
    """The overrides that --set and --seed ask for."""
    seed = [] if arguments.seed is None else [Override(f"seed={arguments.seed}", f"--seed {arguments.seed}")]
    return [*overrides_of(arguments.set), *seed]


def scenario_of(arguments: argparse.Namespace, *, further: Sequence[Override] = ()) -> Scenario:
    """Loads the scenario that the arguments name, with the overrides that they ask for and further ones."""
    return load_scenario(arguments.scenario, [*all_overrides_of(arguments), *further])


def controlled_scenarios(arguments: argparse.Namespace) -> dict[str, Scenario]:
    """Loads the scenario once for each --controller, which is laid over it; without any, as it is.

    Returns:
        The scenarios, by the names of the controllers; or the only one, by its own.
    """
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


def mission_of(arguments: argparse.Namespace) -> Mission:
    """Loads the route and the nominal vehicle that the arguments name, with their overrides."""
    return load_mission(arguments.scenario, overrides_of(arguments.set))


def new_bar(*items: Any, **options: Any) -> Any:
    """Returns a progress bar of tqdm, which is only seen on a terminal and only while it is under way."""
    from tqdm import tqdm

    # Worker processes are forked only from a process with a single thread, and tqdm's monitor would be a second one.
    tqdm.monitor_interval = 0
    return tqdm(*items, leave=False, disable=None, **options)


@contextmanager
def flight_progress() -> Iterator[Callable[[float, float], None]]:
    """Shows a bar on a terminal if a flight takes long; gives the function to tell the time flown and to fly, s."""
    with new_bar(total=0.0, desc="flying", delay=1.0, bar_format=_BAR) as bar:

        def show(flown: float, duration: float) -> None:
            bar.total = duration
            bar.update(flown - bar.n)

        yield show


@contextmanager
def study_progress(name: str) -> Iterator[Callable[[int, int], None]]:
    """Shows a bar on a terminal; gives the function that is told how many samples are done, and how many there are."""
    with new_bar(desc=name, unit=" flights", mininterval=0.2) as bar:

        def show(done: int, total: int) -> None:
            if bar.total is None:
                bar.reset(total)
                bar.initial = done
            bar.update(done - bar.n)

        yield show


def bar_over(items: Sequence[str], words: str) -> Iterator[str]:
    """Gives items one after another and shows a bar on a terminal."""
    with new_bar(items, desc=words) as bar:
        for item in bar:
            bar.set_postfix_str(item)
            yield item


_BAR = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f} of {total:.0f} s flown, {remaining} to go"


def print_table(rows: list[tuple[str, str, str]]) -> None:
    """Prints rows of name, value and unit in aligned columns."""
    names, values = (max(len(row[i]) for row in rows) for i in (0, 1))
    for name, value, unit in rows:
        print(f"{name:<{names}}  {value:>{values}} {unit}".rstrip())


def print_columns(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Prints a table with a header; the first and the last column are aligned to the left, the others to the right."""
    table = [header, *rows]
    widths = [max(len(line[i]) for line in table) for i in range(len(header))]
    for line in table:
        cells = [cell.rjust(width) for cell, width in zip(line, widths, strict=True)]
        print("  ".join([line[0].ljust(widths[0]), *cells[1:-1], line[-1]]).rstrip())


def print_margins(found: dict[str, Any]) -> None:
    """Prints margins of `link_margins`, with a row for each signal that there is a loop around."""
    rows = [
        (
            name,
            f"{margins.sensitivity:.2f}",
            f"{1e3 * margins.delay:.0f} ms",
            f"{margins.phase:.1f}°",
            f"{margins.gain:.1f} dB",
            f"{margins.gain_reduction:.1f} dB",
            f"{margins.crossover:.2f} rad/s",
            f"{margins.bandwidth:.2f} rad/s",
        )
        for name, margins in found.items()
        if margins is not None
    ]
    print("margins where commands go over the link, of the exact linear model of the whole loop")
    print_columns(("signal", "max |S|", "delay", "phase", "gain", "less gain", "crossover", "bandwidth"), rows)


def remark(sentence: str) -> None:
    """Prints something that the user may not have meant, to the standard error."""
    print(f"remark: {sentence}", file=sys.stderr)


def print_predictions(predictions: "Predictions") -> None:
    """Prints how far off vehicles are at horizons, and by how much the first of two is better than the other."""
    names, rows = predictions.vehicles, []
    for quantity, (size, unit) in _PREDICTED.items():
        for horizon in predictions.horizons if quantity in predictions.errors else ():
            if predictions.starts(horizon):
                errors = [predictions.rmse(quantity, name, horizon).text(".3g", size=1.0 / size) for name in names]
                if len(names) == 2:
                    errors.append(predictions.better(quantity, *names, horizon).text(".0f", size=0.01))
                rows.append((quantity.replace("_", " "), f"{horizon:g} s", *errors, unit))
    print_columns(("", "horizon", *names, *(["better by, %"] if len(names) == 2 else []), ""), rows)


def print_files(files: list[Path]) -> None:
    """Prints the names of the files that were written."""
    print("wrote")
    for file in files:
        print(f"  {file}")


def run(main: Callable[[], None]) -> None:
    """Runs a script and exits: with 0 if all went well, 1 if the computation failed, 2 if the input was wrong.

    An error is told in one sentence.
    """
    raise_interruptions()
    try:
        main()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nobody reads what would still be printed
        sys.exit(1)
    except (RuntimeError, OSError) as error:
        print(f"failed: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt as interruption:
        print(str(interruption) or SENTENCE, file=sys.stderr)
        sys.exit(1)
