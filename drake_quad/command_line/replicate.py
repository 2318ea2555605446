"""Flies the paper's experiment again, and writes a report with its table, its figures and a verdict on each claim."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from drake_quad import Scenario, load_scenario
from drake_quad.command_line.options import add_vector, add_wired, bare_parser
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar, progress_bar
from drake_quad.files import output_folder
from drake_quad.replication.experiment import QUICK, ExperimentSizes, fly_experiment
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell
from drake_quad.replication.report import CAPTIONS, findings_of, write_report
from drake_quad.replication.results import read_experiment
from drake_quad.replication.table_ii import TableEntry, number_or_dash, percent_or_dash
from drake_quad.studies.processes import Workers


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    result = bare_parser(__doc__, "drake-quad replicate --quick")
    result.add_argument("--quick", action="store_true", help="fewer samples, to see whether everything works")
    result.add_argument("--workers", type=int, help="processes (default: as many as there are cores)")
    result.add_argument("--resume", action="store_true", help="keep the cells that are in the folder already")
    result.add_argument("--output", type=Path, help="folder (default: out/paper, or out/paper_quick)")
    add_wired(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    sizes = QUICK if arguments.quick else ExperimentSizes()
    folder = output_folder(arguments.output or Path("out/paper_quick" if arguments.quick else "out/paper"))
    try:
        with Workers(arguments.workers) as workers, progress_bar("flying") as progress:
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
    found = read_experiment(folder)
    findings = findings_of(found)
    with new_bar(total=len(CAPTIONS), desc="drawing") as bar:
        files = write_report(folder, found, findings, flights, vector=arguments.vector, progress=bar.update)
    print_errors(findings.entries)
    print_columns(("claim", "verdict"), [(claim.statement, claim.verdict) for claim in findings.claims])
    print_files(files)


def load(cell: Cell) -> Scenario:
    """Return the scenario of a cell of Table II."""
    return load_scenario(f"paper:{cell.scenario}")


def print_errors(entries: Sequence[TableEntry]) -> None:
    """Print the errors of Table II next to those of the paper."""
    rows = [
        (
            WINDS[entry.cell.wind],
            CONTROLLERS[entry.cell.controller],
            entry.mean.text(),
            number_or_dash(entry.printed.mean),
            percent_or_dash(entry.deviation),
        )
        for entry in entries
        if entry.quantity == "rmse"
    ]
    print_columns(("", "", "RMSE (m)", "printed", "off by"), rows)
