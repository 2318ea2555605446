"""Flies the paper's experiment again, and writes a report with its table, its figures and a verdict on each claim."""

import argparse
import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import as_file
from importlib.resources import files as resources
from pathlib import Path

from drake_quad import Scenario, load_scenario
from drake_quad.command_line.options import add_vector, add_wired, bare_parser
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.files import output_folder, read_table, write_text
from drake_quad.replication.experiment import QUICK, Sizes, fly_experiment
from drake_quad.replication.figures import paper_figures
from drake_quad.replication.findings import findings_of, write_findings
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell
from drake_quad.replication.report import FIGURES, report_markdown
from drake_quad.replication.results import read_experiment
from drake_quad.replication.table_ii import Entry
from drake_quad.studies.processes import Workers
from drake_quad.studies.report import report_html
from drake_quad.visualization.in_print import save_small
from drake_quad.visualization.style import save_vector


def options() -> argparse.ArgumentParser:
    """The options of the command."""
    result = bare_parser(
        "replicate",
        __doc__,
        example="drake-quad replicate --quick",
    )
    result.add_argument("--quick", action="store_true", help="fewer samples, to see whether everything works")
    result.add_argument("--workers", type=int, help="processes (default: as many as there are cores)")
    result.add_argument("--resume", action="store_true", help="keep the cells that are in the folder already")
    result.add_argument("--output", type=Path, help="folder (default: out/paper, or out/paper_quick)")
    add_wired(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Runs the command."""
    sizes = QUICK if arguments.quick else Sizes()
    folder = output_folder(arguments.output or Path("out/paper_quick" if arguments.quick else "out/paper"))
    try:
        with Workers(arguments.workers) as workers, flights_bar(sizes.flights) as progress:
            flights = fly_experiment(
                load,
                sizes,
                folder,
                workers,
                resume=arguments.resume,
                compiled=not arguments.wired,
                progress=progress,
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted: the cells that are done are in {folder}; --resume goes on") from None
    with as_file(resources("drake_quad.replication") / "calibration.csv") as path:
        shutil.copyfile(path, folder / "calibration.csv")
    found = read_experiment(folder)
    findings = findings_of(found, read_table(folder / "calibration.csv"))
    files = write_findings(folder, findings)
    drawings = output_folder(folder / "figures")
    with new_bar(total=len(FIGURES), desc="drawing") as bar:
        for name, figure in paper_figures(found, flights):
            save_small(figure, drawings / f"{name}.png")
            if arguments.vector is not None:
                save_vector(figure, drawings / f"{name}.{arguments.vector}", arguments.vector)
            bar.update()
    text = report_markdown(found, findings)
    files.append(write_text(folder / "report.md", text))
    files.append(write_text(folder / "report.html", report_html(text, folder)))
    print_errors(findings.entries)
    print_columns(("claim", "verdict"), [(claim.words, claim.verdict) for claim in findings.claims])
    print_files([*files, drawings])


def load(cell: Cell) -> Scenario:
    """The scenario of a cell."""
    return load_scenario(f"paper:{cell.scenario}")


@contextmanager
def flights_bar(total: int) -> Iterator[Callable[[str, int], None]]:
    """Shows a bar on a terminal; gives the function that is told what was flown and how many flights are done."""
    with new_bar(total=total, desc="flying", unit=" flights") as bar:

        def show(what: str, done: int) -> None:
            bar.set_postfix_str(what, refresh=False)
            bar.update(done - bar.n)

        bar.refresh()
        yield show


def print_errors(entries: Sequence[Entry]) -> None:
    """Print the errors of Table II next to those of the paper."""
    rows = []
    for entry in entries:
        if entry.quantity == "rmse":
            is_printed = math.isfinite(entry.off)
            rows.append(
                (
                    WINDS[entry.cell.wind],
                    CONTROLLERS[entry.cell.controller],
                    entry.mean.text(),
                    f"{entry.printed.mean:.3f}" if is_printed else "–",
                    f"{100.0 * entry.off:+.1f} %" if is_printed else "–",
                )
            )
    print_columns(("", "", "RMSE (m)", "printed", "off by"), rows)
