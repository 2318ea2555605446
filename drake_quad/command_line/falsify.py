"""Search for the worst case of a scenario, and compare it with the nominal flight.

The evolution strategy CMA-ES varies the random parameters within some standard deviations, and searches for the worst
value of a metric. To search for a violation of a requirement, give the name of the requirement to --minimize. The
search then minimises its robustness, which is negative if the requirement is violated.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from drake_quad.command_line.options import (
    check_extra,
    check_metric,
    check_ranges,
    scenario_from_arguments,
)
from drake_quad.command_line.output import flying_command, print_columns, print_files
from drake_quad.command_line.progress import counting_bar
from drake_quad.command_line.searches import open_search, search_parser
from drake_quad.errors import InputError
from drake_quad.files import write_table
from drake_quad.flight.simulation import simulate
from drake_quad.laboratory.metrics import metric_definitions
from drake_quad.scenario.description import unit_at
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.studies.falsification import MIN_FLIGHTS, WorstCase, find_worst_case
from drake_quad.visualization.falsification_plots import plot_search, plot_worst_flight
from drake_quad.visualization.style import save_figures

_NUM_TABLE_ROWS = 12  # rows of the printed table, each with one random parameter


def options() -> argparse.ArgumentParser:
    result = search_parser(__doc__, "drake-quad falsify robustness --maximize peak_error --flights 4000")
    goal = result.add_mutually_exclusive_group()
    goal.add_argument("--maximize", metavar="METRIC", help="metric whose large values are bad (default: peak_error)")
    goal.add_argument(
        "--minimize", metavar="METRIC", help="metric whose small values are bad, such as the name of a requirement"
    )
    result.add_argument(
        "--sigma",
        type=float,
        default=3.0,
        help="largest distance of a parameter from its median, in standard deviations (default: %(default)g)",
    )
    result.add_argument("--flights", type=int, default=20_000, help="largest number of flights (default: %(default)s)")
    result.add_argument(
        "--noise",
        type=int,
        default=4,
        metavar="N",
        help="number of samples of wind and noise with which each candidate flies (default: %(default)s)",
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    check_extra("falsify", "robustness", "cma")
    check_ranges(arguments, {"sigma": (0.1, 8.0), "noise": (1, 100), "flights": (1, 1e9)})
    if arguments.flights < MIN_FLIGHTS * arguments.noise:
        raise InputError(
            f"--flights {arguments.flights}: one generation needs {MIN_FLIGHTS} candidates with {arguments.noise}"
            f" samples of noise each, so at least {MIN_FLIGHTS * arguments.noise} flights"
        )
    scenario = scenario_from_arguments(arguments)
    metric = arguments.minimize or arguments.maximize or "peak_error"
    check_metric(scenario, metric, option="--minimize" if arguments.minimize else "--maximize")
    began = time.perf_counter()
    with (
        open_search(arguments, scenario) as (folder, options),
        counting_bar(scenario.name, arguments.flights) as show,
    ):
        found = find_worst_case(
            scenario,
            metric,
            maximise=arguments.minimize is None,
            sigma=arguments.sigma,
            max_flights=arguments.flights,
            num_noise=arguments.noise,
            progress=show,
            **options,
        )
    seconds = time.perf_counter() - began
    flights = [simulate(each, compiled=not arguments.wired) for each in (found.scenario, found.nominal)]
    worst, nominal = flights
    unit = metric_definitions(scenario.metrics_type)[metric].unit
    print(
        f"{scenario.name}: the worst of {found.num_flights:,} flights in {seconds:.0f} s, within {arguments.sigma:g}"
        " standard deviations:"
    )
    if found.is_crash:
        print(f"  the vehicle crashes at {worst.metrics.crash_time:.2f} s")
    values = [f"{getattr(flight.metrics, metric):.4g} {'' if unit == '1' else unit}".rstrip() for flight in flights]
    print(f"  {metric} {values[0]}, nominal {values[1]}")
    print_parameters(found)
    file = folder / "worst.yaml"
    save_scenario(found.scenario, file)
    figures = {"worst": plot_worst_flight(worst, nominal), "search": plot_search(found)}
    files = [file, write_parameters(folder / "parameters.csv", found)]
    files += save_figures(figures, folder, vector=arguments.vector)
    print("to fly the worst case again, or to see it in a replay:")
    print(f"  {flying_command('fly', found.scenario, file)}")
    print(f"  {flying_command('replay', found.scenario, file, '--samples', '1')}")
    print_files(files)


def print_parameters(found: WorstCase) -> None:
    """Print the random parameters that differ most from their medians, in standard deviations."""
    rows = []
    for i in np.argsort(-np.abs(found.point))[:_NUM_TABLE_ROWS]:
        name = found.names[i]
        values, unit = ("–", "–"), ""
        if name in found.values:
            nominal, worst = found.values[name]
            values, unit = (f"{nominal:.4g}", f"{worst:.4g}"), unit_at(found.nominal, name)
        rows.append((name, *values, f"{found.point[i]:+.2f}", "" if unit == "1" else unit))
    print_columns(("random parameter", "nominal", "worst", "deviations", "unit"), rows)


def write_parameters(path: Path, found: WorstCase) -> Path:
    """Write a table with the nominal and the worst value of each random parameter."""
    return write_table(
        path,
        {
            "parameter": [*found.values],
            "nominal": [nominal for nominal, _ in found.values.values()],
            "worst": [worst for _, worst in found.values.values()],
        },
    )
