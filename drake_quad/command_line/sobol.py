"""Attribute the variance of a metric to the random parameters, by Sobol indices.

The first-order index is the fraction of the variance that a parameter explains alone. The total index also includes
interactions with other parameters. Wind and noise count as one parameter.
"""

import argparse
import time
from pathlib import Path

from drake_quad.command_line.options import (
    check_extra,
    check_metric,
    scenario_from_arguments,
)
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import progress_bar
from drake_quad.command_line.searches import open_search, search_parser
from drake_quad.files import write_table
from drake_quad.laboratory.metrics import metric_definitions
from drake_quad.studies.sobol_indices import CRASHED, SobolIndex, sobol_indices
from drake_quad.visualization.sensitivity_plots import plot_sobol_indices
from drake_quad.visualization.style import save_figures

_NUM_TABLE_ROWS = 12  # rows of the printed table, each with one parameter


def options() -> argparse.ArgumentParser:
    result = search_parser(__doc__, "drake-quad sobol robustness --metric rmse --points 16")
    result.add_argument(
        "--metric", metavar="NAME", default="rmse", help=f"metric, or {CRASHED} for crashes (default: %(default)s)"
    )
    result.add_argument(
        "--points",
        type=int,
        default=256,
        help="number of points N, a power of two; for d random parameters, (d + 3) N vehicles fly"
        " (default: %(default)s)",
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    check_extra("sobol", "robustness", "SALib")
    scenario = scenario_from_arguments(arguments)
    check_metric(scenario, arguments.metric, [*metric_definitions(scenario.metrics_type), CRASHED])
    began = time.perf_counter()
    with (
        open_search(arguments, scenario) as (folder, options),
        progress_bar(scenario.name, unit=" flights") as progress,
    ):
        indices = sobol_indices(
            scenario,
            arguments.metric,
            num_points=arguments.points,
            progress=progress,
            **options,
        )
    seconds = time.perf_counter() - began
    print(f"{scenario.name}: fractions of the variance of {arguments.metric}, with 95 % intervals, in {seconds:.0f} s")
    rows = [(each.name, each.first_order.text(), each.total.text(), "") for each in indices[:_NUM_TABLE_ROWS]]
    print_columns(("random parameter", "first order", "total", ""), rows)
    files = [write_indices(folder / "sobol.csv", indices)]
    figures = {"sobol": plot_sobol_indices(indices, arguments.metric)}
    print_files([*files, *save_figures(figures, folder, vector=arguments.vector)])


def write_indices(path: Path, indices: tuple[SobolIndex, ...]) -> Path:
    """Write a table with the indices of all parameters."""
    columns: dict[str, list[object]] = {"parameter": [each.name for each in indices]}
    for kind in ("first_order", "total"):
        for part in ("value", "low", "high"):
            columns[f"{kind}_{part}"] = [getattr(getattr(each, kind), part) for each in indices]
    return write_table(path, columns)
