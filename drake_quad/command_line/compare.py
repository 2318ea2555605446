"""Fly several controllers on the same samples in several laboratories, and compare their errors."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad import InputError, Scenario
from drake_quad.command_line.flight_remarks import print_comparison_remarks, print_flight_remarks
from drake_quad.command_line.options import (
    add_controller,
    add_overrides,
    add_vector,
    add_wired,
    check_ranges,
    controlled_scenarios,
    parser_without_options,
)
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import FLIGHT_BAR, progress_bar
from drake_quad.files import output_folder, write_table
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.batch import check_pairs
from drake_quad.statistics.estimates import mean_interval
from drake_quad.statistics.interval import plus_minus
from drake_quad.statistics.replicates import Replicates
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import compare, values_without_crashes
from drake_quad.studies.study import sample_replicates
from drake_quad.visualization.comparison_plots import plot_comparison
from drake_quad.visualization.style import save_figures

_DEFAULT_SCENARIOS = tuple(f"laboratory:{name}" for name in ("nominal", "low_wind", "high_wind"))
_DEFAULT_CONTROLLERS = ("pd", "pd_t1fnn", "pd_t2fnn", "pid", "pd_feed_forward")


def options() -> argparse.ArgumentParser:
    result = parser_without_options(__doc__, "drake-quad compare --scenario outdoor --samples 50")
    result.add_argument(
        "--scenario",
        action="append",
        metavar="FILE[:NAME]",
        help="scenario with the laboratory; can be given several times (default: laboratory:nominal,"
        " laboratory:low_wind and laboratory:high_wind)",
    )
    default = f"(default: {', '.join(_DEFAULT_CONTROLLERS)} of controllers/paper)"
    add_controller(result, several=f"can be given several times, and the first is the baseline {default}")
    result.add_argument("--samples", type=int, help="number of samples that each controller flies (default: 20)")
    add_overrides(result)
    result.add_argument("--quick", action="store_true", help="simulate 4 samples for 6 s each, as a quick test")
    result.add_argument(
        "--output", type=Path, default=Path("out/comparison"), help="output folder (default: %(default)s)"
    )
    add_wired(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, {"samples": (1, 10_000)})
    samples = arguments.samples or (4 if arguments.quick else 20)
    scenarios_by_laboratory = scenarios_from_arguments(arguments)
    print_flight_remarks(scenario for scenarios in scenarios_by_laboratory.values() for scenario in scenarios.values())
    for scenarios in scenarios_by_laboratory.values():
        print_comparison_remarks(scenarios)
        check_pairs(scenarios)
    folder = output_folder(arguments.output)
    flights: dict[str, dict[str, Metrics]] = {}
    for laboratory, scenarios in scenarios_by_laboratory.items():
        flights[laboratory] = {}
        for name, scenario in scenarios.items():
            with progress_bar("flying", **FLIGHT_BAR) as progress:
                flights[laboratory][name] = fly_samples(
                    scenario, range(samples), compiled=not arguments.wired, progress=progress
                )
    files = [
        write_flights(folder / "comparison.csv", flights),
        *save_figures({"comparison": plot_comparison(flights)}, folder, vector=arguments.vector),
    ]
    print(
        f"mean ± standard deviation over {samples} samples; the relative RMSE is the ratio of the mean RMSE to"
        " that of the first controller, with its 95 % interval"
    )
    replicates = {
        laboratory: sample_replicates(next(iter(scenarios.values())), range(samples))
        for laboratory, scenarios in scenarios_by_laboratory.items()
    }
    print_comparison(flights, replicates)
    print_files(files)


def scenarios_from_arguments(arguments: argparse.Namespace) -> dict[str, dict[str, Scenario]]:
    """Return the scenarios to fly, by laboratory and then by controller."""
    arguments.controller = arguments.controller or [f"controllers/paper:{name}" for name in _DEFAULT_CONTROLLERS]
    if arguments.quick:
        arguments.set = ["duration=6", *arguments.set]
    scenarios_by_laboratory: dict[str, dict[str, Scenario]] = {}
    for spec in arguments.scenario or _DEFAULT_SCENARIOS:
        scenarios = controlled_scenarios(arguments, spec)
        name = next(iter(scenarios.values())).name
        if name in scenarios_by_laboratory:
            raise InputError(f"--scenario {spec}: another scenario is also called {name}; rename one of them")
        scenarios_by_laboratory[name] = scenarios
    return scenarios_by_laboratory


def print_comparison(flights: Mapping[str, Mapping[str, Metrics]], replicates: Mapping[str, Replicates]) -> None:
    """Print a row for each laboratory and controller.

    Args:
        flights: flight metrics, by laboratory and then by controller.
        replicates: assignment of the samples to independent replicates, by laboratory.
    """
    rows = []
    for laboratory, metrics_by_controller in flights.items():
        first = next(iter(metrics_by_controller.values()))
        for name, metrics in metrics_by_controller.items():
            ratio = compare(metrics, first, replicates=replicates[laboratory]).ratio
            rows.append(
                (
                    laboratory,
                    name,
                    f"{mean_and_deviation(100.0 * values_without_crashes(metrics, 'rmse'))} cm",
                    f"{mean_and_deviation(100.0 * values_without_crashes(metrics, 'peak_error'))} cm",
                    mean_and_deviation(values_without_crashes(metrics, "effort_x")),
                    mean_and_deviation(values_without_crashes(metrics, "effort_y")),
                    "100 %" if metrics is first else ratio.percent(),
                    f"{int(metrics.crashed.sum())} crashed" if metrics.crashed.any() else "",
                )
            )
    print_columns(
        ("scenario", "controller", "RMSE", "peak", "effort X (m²/s⁴)", "effort Y (m²/s⁴)", "relative RMSE", ""), rows
    )


def mean_and_deviation(values: np.ndarray) -> str:
    """Return a text with the mean and the standard deviation of values."""
    if len(values) > 1:
        return plus_minus(values.mean(), values.std(ddof=1))
    return mean_interval(values).text()


def write_flights(path: Path, flights: Mapping[str, Mapping[str, Metrics]]) -> Path:
    """Write a CSV file with a row for each flight, and return its path."""
    flown = [
        (laboratory, name, metrics)
        for laboratory, metrics_by_controller in flights.items()
        for name, metrics in metrics_by_controller.items()
    ]
    names = dict.fromkeys(name for *_, metrics in flown for name in metrics._fields)
    rows: list[tuple[Any, ...]] = []
    for laboratory, name, metrics in flown:
        columns = [getattr(metrics, each, [""] * len(metrics.rmse)) for each in names]
        rows += [(laboratory, name, sample, *values) for sample, values in enumerate(zip(*columns, strict=True))]
    header = ("scenario", "controller", "sample", *names)
    return write_table(path, dict(zip(header, zip(*rows, strict=True), strict=True)), digits=9)
