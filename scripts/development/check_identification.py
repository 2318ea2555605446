"""Check how many 95 % confidence intervals of identified parameters contain the true value.

The script simulates vehicles with random parameters under one of six conditions, identifies each vehicle from its log,
and counts for each parameter the intervals that contain the true value. It saves the results after each batch of
flights, so an interrupted run can be continued.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from drake_quad.command_line.running import run

import numpy as np

from drake_quad import InputError
from drake_quad.command_line.options import check_ranges, parse_overrides, parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.errors import short_repr
from drake_quad.files import output_folder
from drake_quad.identification.evidence import quantile
from drake_quad.identification.synthetic_flights import SYNTHETIC_FLIGHTS, CheckedParameter, CheckTask, check_batch
from drake_quad.statistics.estimates import proportion_interval
from drake_quad.studies.processes import Workers
from drake_quad.studies.worker_pool import run_tasks

_DIAGRAMS = Path(__file__).parents[2] / "diagrams"
_COMMENT = "# "  # beginning of the first line of a results file; the rest of the line describes the flights
_HEADER = ("sample", *CheckedParameter._fields)  # names of the columns, in the second line of a results file
_BATCH_SIZE = 5  # flights
# Smallest and largest allowed value of each option.
_OPTION_RANGES = {"samples": (1, 10_000), "processes": (1, 256), "seed": (0, 2**31)}


def main() -> None:
    options = parser_without_options(
        __doc__, "python scripts/development/check_identification.py wind --samples 100 --processes 2"
    )
    options.add_argument("flights", choices=[*SYNTHETIC_FLIGHTS], help="condition of the flights")
    options.add_argument("--samples", type=int, default=100, help="number of flights (default: %(default)s)")
    options.add_argument("--processes", type=int, default=1, help="number of worker processes (default: %(default)s)")
    options.add_argument("--seed", type=int, default=11, help="random seed (default: %(default)s)")
    options.add_argument(
        "--set", metavar="FIELD=VALUE", action="append", default=[], help="override a field of the flown scenario"
    )
    options.add_argument(
        "--output",
        type=Path,
        metavar="FILE",
        help="file of results, continued if it exists (default: out/check_identification/FLIGHTS.csv)",
    )
    arguments = options.parse_args()
    check_ranges(arguments, _OPTION_RANGES)
    path = arguments.output or Path("out/check_identification") / f"{arguments.flights}.csv"
    if path.suffix != ".csv":
        raise InputError(f"--output {path}: the name must end in .csv")
    output_folder(path.parent)
    overrides = [f"seed={arguments.seed}", *(each.assignment for each in parse_overrides(arguments.set))]
    SYNTHETIC_FLIGHTS[arguments.flights].simulated_scenario(_DIAGRAMS, overrides)
    description = " ".join([arguments.flights, *overrides])
    done = read_rows(path, description)
    missing = [sample for sample in range(arguments.samples) if sample not in done]
    batches = [missing[i : i + _BATCH_SIZE] for i in range(0, len(missing), _BATCH_SIZE)]
    tasks = [CheckTask(arguments.flights, _DIAGRAMS, overrides, batch) for batch in batches]
    try:
        with new_bar(total=len(missing), desc="flights") as bar:
            for results in check_batches(tasks, arguments.processes):
                write_rows(path, description, results)
                done |= results
                bar.update(len(results))
    except KeyboardInterrupt:
        message = f"interrupted: {len(done)} flights are saved in {path}; run the same command again to continue"
        raise KeyboardInterrupt(message) from None
    print_coverage({sample: rows for sample, rows in done.items() if sample < arguments.samples})
    print_files([path])


def check_batches(tasks: Sequence[CheckTask], processes: int) -> Iterator[dict[int, list[CheckedParameter]]]:
    """Yield the results of each batch, keyed by sample, as soon as the batch is complete."""
    waiting = iter(tasks)
    with Workers(processes) as workers:
        for outcome in run_tasks(workers, check_batch, lambda: next(waiting, None)):
            if outcome.result is None:
                raise RuntimeError(outcome.reason)
            yield outcome.result


def read_rows(path: Path, description: str) -> dict[int, list[CheckedParameter]]:
    """Return the saved results, keyed by sample.

    A flight in which no parameter was identified has a single row with an empty name, and an empty list here.

    Args:
        path: path of the file.
        description: description of the flights, which must equal that in the first line of the file.

    Raises:
        InputError: if the file has another format, is truncated, or contains results of other flights.
    """
    if not path.exists():
        return {}
    results: dict[int, list[CheckedParameter]] = {}
    unreadable = InputError(
        f"--output {path}: the file is truncated or was not written by this script; delete it or give another path"
    )
    try:
        text = path.read_text(encoding="utf-8")
        first, _, rest = text.partition("\n")
        lines = csv.reader(rest.splitlines())
        if not text.endswith("\n") or not first.startswith(_COMMENT) or next(lines, None) != list(_HEADER):
            raise unreadable
        saved = first.removeprefix(_COMMENT).strip()
        if saved != description:
            raise InputError(
                f"--output {path}: the file contains flights of {short_repr(saved)}, not of {short_repr(description)};"
                " delete it or give another path"
            )
        for sample, name, *numbers in lines:
            rows = results.setdefault(int(sample), [])
            if name:
                rows.append(CheckedParameter(name, *map(float, numbers)))
    except InputError:
        raise
    except (OSError, ValueError, TypeError, csv.Error):
        raise unreadable from None
    return results


def write_rows(path: Path, description: str, results: dict[int, list[CheckedParameter]]) -> None:
    """Append results to the file in a single write, so that an interruption leaves no incomplete flight."""
    text = io.StringIO()
    lines = csv.writer(text)
    if not path.exists():
        text.write(f"{_COMMENT}{description}\n")
        lines.writerow(_HEADER)
    for sample, rows in results.items():
        lines.writerows((sample, *row) for row in rows)
        if not rows:
            lines.writerow((sample, *("",) * len(CheckedParameter._fields)))
    with path.open("ab", buffering=0) as file:
        file.write(text.getvalue().encode())


def print_coverage(results: dict[int, list[CheckedParameter]]) -> None:
    """Print how often the intervals of each parameter contain the true value, and how large its errors are.

    The fraction of intervals that contain the true value is printed with its own 95 % interval.
    """
    by_name: dict[str, list[CheckedParameter]] = {}
    for rows in results.values():
        for row in rows:
            by_name.setdefault(row.name, []).append(row)
    table = []
    for name, rows in by_name.items():
        true, value, deviation, freedom = np.array([row[1:] for row in rows]).T
        error = value - true
        covered = int(np.sum(np.abs(error) < quantile(freedom) * deviation))
        fraction, rms = proportion_interval(covered, len(rows)), np.sqrt(np.mean(error**2))
        spread = np.std(error) or np.nan
        table.append(
            (
                name,
                f"{covered} of {len(rows)}",
                fraction.percent(),
                f"{np.mean(error) / spread:+.2f}",
                f"{np.sqrt(np.mean(deviation**2)) / rms:.2f}",
                f"{rms:.2g}",
                f"{len(results) - len(rows)}",
            )
        )
    print(f"{len(results)} flights; coverage by the 95 % intervals, for identified parameters only")
    header = ("parameter", "covered", "coverage", "bias/sd", "sd/RMS error", "RMS error", "not identified")
    print_columns(header, table)


if __name__ == "__main__":
    run(main)
