"""Check how many of the 95 % intervals of an identification contain the true parameter.

The script simulates vehicles with random parameters under one of six conditions, identifies each from its log, and
prints for each parameter how many intervals contain the true value. Results are saved after each batch of flights, and
an interrupted run continues where it stopped.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from drake_quad.command_line.running import run

import numpy as np

from drake_quad import InputError
from drake_quad.command_line.options import bare_parser, check_ranges, overrides_of
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.errors import shown
from drake_quad.files import output_folder
from drake_quad.identification.known_flights import KNOWN_FLIGHTS, CheckedParameter, Task, check_batch
from drake_quad.identification.results.estimates import quantile
from drake_quad.statistics.estimates import share_interval
from drake_quad.studies.crew import outcomes_of
from drake_quad.studies.processes import Workers

_DIAGRAMS = Path(__file__).parents[2] / "diagrams"
# The first line of the file names the flights, and the second one the columns.
_COMMENT, _HEADER = "# ", ("sample", *CheckedParameter._fields)
# Number of flights that are simulated together.
_BATCH = 5
_RANGES = {"samples": (1, 10_000), "processes": (1, 256), "seed": (0, 2**31)}


def main() -> None:
    options = bare_parser(
        __doc__, "python scripts/development/check_identification.py wind --samples 100 --processes 2"
    )
    options.add_argument("flights", choices=[*KNOWN_FLIGHTS], help="condition of the flights")
    options.add_argument("--samples", type=int, default=100, help="flights (default: %(default)s)")
    options.add_argument("--processes", type=int, default=1, help="that identify at a time (default: %(default)s)")
    options.add_argument("--seed", type=int, default=11, help="of what is drawn (default: %(default)s)")
    options.add_argument(
        "--set", metavar="FIELD=VALUE", action="append", default=[], help="override a field of what flies"
    )
    options.add_argument(
        "--output",
        type=Path,
        metavar="FILE",
        help="to write, and to go on with (default: out/check_identification/FLIGHTS.csv)",
    )
    arguments = options.parse_args()
    check_ranges(arguments, _RANGES)
    path = arguments.output or Path("out/check_identification") / f"{arguments.flights}.csv"
    if path.suffix != ".csv":
        raise InputError(f"--output {path}: must end in .csv")
    output_folder(path.parent)
    overrides = [f"seed={arguments.seed}", *(each.assignment for each in overrides_of(arguments.set))]
    KNOWN_FLIGHTS[arguments.flights].simulated_scenario(_DIAGRAMS, overrides)
    flown = " ".join([arguments.flights, *overrides])
    done = read_rows(path, flown)
    missing = [sample for sample in range(arguments.samples) if sample not in done]
    batches = [missing[i : i + _BATCH] for i in range(0, len(missing), _BATCH)]
    tasks = [Task(arguments.flights, _DIAGRAMS, overrides, batch) for batch in batches]
    try:
        with new_bar(total=len(missing), desc="flights") as bar:
            for found in in_processes(tasks, arguments.processes):
                write_rows(path, flown, found)
                done |= found
                bar.update(len(found))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted: {len(done)} flights are in {path}; the same command goes on") from None
    print_coverage({sample: rows for sample, rows in done.items() if sample < arguments.samples})
    print_files([path])


def in_processes(tasks: Sequence[Task], processes: int) -> Iterator[dict[int, list[CheckedParameter]]]:
    """Yield the results of each batch when it is complete."""
    waiting = iter(tasks)
    with Workers(processes) as workers:
        for outcome in outcomes_of(workers, check_batch, lambda: next(waiting, None)):
            if outcome.result is None:
                raise RuntimeError(outcome.reason)
            yield outcome.result


def read_rows(path: Path, flown: str) -> dict[int, list[CheckedParameter]]:
    """Return saved results by sample; a flight that identified no parameter has a row without a name.

    Args:
        path: path of the file.
        flown: description of the flights, which must match the first line of the file.

    Raises:
        InputError: the file has another format, is truncated, or has results of other flights.
    """
    if not path.exists():
        return {}
    found: dict[int, list[CheckedParameter]] = {}
    foreign = InputError(f"--output {path}: is not of this script, or was cut off")
    try:
        text = path.read_text(encoding="utf-8")
        first, _, rest = text.partition("\n")
        lines = csv.reader(rest.splitlines())
        if not text.endswith("\n") or not first.startswith(_COMMENT) or next(lines, None) != list(_HEADER):
            raise foreign
        before = first.removeprefix(_COMMENT).strip()
        if before != flown:
            raise InputError(f"--output {path}: is of {shown(before)}, not of {shown(flown)}")
        for sample, name, *numbers in lines:
            rows = found.setdefault(int(sample), [])
            if name:
                rows.append(CheckedParameter(name, *map(float, numbers)))
    except InputError:
        raise
    except (OSError, ValueError, TypeError, csv.Error):
        raise foreign from None
    return found


def write_rows(path: Path, flown: str, found: dict[int, list[CheckedParameter]]) -> None:
    """Append results to the file in a single write, so that it contains no partial flight."""
    text = io.StringIO()
    lines = csv.writer(text)
    if not path.exists():
        text.write(f"{_COMMENT}{flown}\n")
        lines.writerow(_HEADER)
    for sample, rows in found.items():
        lines.writerows((sample, *row) for row in rows)
        if not rows:
            lines.writerow((sample, *("",) * len(CheckedParameter._fields)))
    with path.open("ab", buffering=0) as file:
        file.write(text.getvalue().encode())


def print_coverage(found: dict[int, list[CheckedParameter]]) -> None:
    """Print the coverage of the intervals as a share of flights with a 95 % interval, and the size of the errors."""
    by_name: dict[str, list[CheckedParameter]] = {}
    for rows in found.values():
        for row in rows:
            by_name.setdefault(row.name, []).append(row)
    table = []
    for name, rows in by_name.items():
        true, value, deviation, freedom = np.array([row[1:] for row in rows]).T
        off = value - true
        held = int(np.sum(np.abs(off) < quantile(freedom) * deviation))
        share, rms = share_interval(held, len(rows)), np.sqrt(np.mean(off**2))
        spread = np.std(off) or np.nan
        table.append(
            (
                name,
                f"{held} of {len(rows)}",
                share.percent(),
                f"{np.mean(off) / spread:+.2f}",
                f"{np.sqrt(np.mean(deviation**2)) / rms:.2f}",
                f"{rms:.2g}",
                f"{len(found) - len(rows)}",
            )
        )
    print(f"{len(found)} flights; 95 % intervals that hold the true number, where the log tells it")
    header = ("number", "interval holds", "share", "bias/sd", "said/error", "error, RMS", "not told")
    print_columns(header, table)


if __name__ == "__main__":
    run(main)
