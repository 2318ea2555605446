"""Repeat the experiment of the paper, and write a report with its table, its figures and a verdict on each claim."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from drake_quad import Scenario, load_scenario
from drake_quad.command_line.options import add_vector, add_wired, parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar, progress_bar
from drake_quad.files import output_folder
from drake_quad.replication.experiment import QUICK, ExperimentSizes, fly_experiment
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell
from drake_quad.replication.report import CAPTIONS, collect_findings, write_report
from drake_quad.replication.results import read_experiment
from drake_quad.replication.table_ii import TableEntry, number_or_dash, percent_or_dash
from drake_quad.studies.processes import Workers


def options() -> argparse.ArgumentParser:
    result = parser_without_options(__doc__, "drake-quad replicate --quick")
    result.add_argument("--quick", action="store_true", help="simulate fewer samples, as a quick test")
    result.add_argument("--workers", type=int, help="number of worker processes (default: number of cores)")
    result.add_argument("--resume", action="store_true", help="keep the table cells that the folder already contains")
    result.add_argument(
        "--output", type=Path, help="output folder (default: out/paper, or out/paper_quick with --quick)"
    )
    add_wired(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
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
        raise KeyboardInterrupt(
            f"interrupted: the finished table cells are in {folder}; --resume continues from them"
        ) from None
    experiment = read_experiment(folder)
    findings = collect_findings(experiment)
    with new_bar(total=len(CAPTIONS), desc="drawing") as bar:
        files = write_report(folder, experiment, findings, flights, vector=arguments.vector, progress=bar.update)
    print_errors(findings.entries)
    print_columns(("claim", "verdict"), [(claim.statement, claim.verdict) for claim in findings.claims])
    print_files(files)


def load(cell: Cell) -> Scenario:
    """Load the scenario of a cell (a combination of controller and wind) of the paper's Table II."""
    return load_scenario(f"paper:{cell.scenario}")


def print_errors(entries: Sequence[TableEntry]) -> None:
    """Print the simulated errors beside the errors in Table II of the paper."""
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
    print_columns(("wind", "controller", "RMSE (m)", "RMSE in the paper (m)", "deviation"), rows)
