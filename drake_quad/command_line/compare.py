"""Flies several controllers in several laboratories, all on the same samples, and compares them."""

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from drake_quad import InputError, Scenario
from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import (
    add_controller,
    add_overrides,
    add_vector,
    add_wired,
    bare_parser,
    check_ranges,
    controlled_scenarios,
)
from drake_quad.command_line.output import print_columns, print_files, remark
from drake_quad.command_line.progress import FLIGHT_BAR, progress_bar
from drake_quad.files import output_folder, write_table
from drake_quad.flight.remarks import unequal_conditions
from drake_quad.laboratory.metrics import Metrics
from drake_quad.statistics.estimates import mean_interval
from drake_quad.statistics.interval import plus_minus
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import compare, values_without_crashes
from drake_quad.visualization.comparison_plots import plot_comparison
from drake_quad.visualization.style import save_figures

_SCENARIOS = tuple(f"laboratory:{name}" for name in ("nominal", "low_wind", "high_wind"))
_CONTROLLERS = ("pd", "pd_t1fnn", "pd_t2fnn", "pid", "pd_feed_forward")


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    result = bare_parser(__doc__, "drake-quad compare --scenario outdoor --samples 50")
    result.add_argument(
        "--scenario",
        action="append",
        metavar="FILE[:NAME]",
        help="in which to fly; can be given several times (default: nominal, low_wind, high_wind of laboratory)",
    )
    default = f"(default: {', '.join(_CONTROLLERS)} of controllers/paper)"
    add_controller(result, several=f"several are compared with the first {default}")
    result.add_argument("--samples", type=int, help="flights of each pair (default: 20)")
    add_overrides(result)
    result.add_argument("--quick", action="store_true", help="4 samples over 6 s of flight")
    result.add_argument("--output", type=Path, default=Path("out/comparison"), help="folder (default: %(default)s)")
    add_wired(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    check_ranges(arguments, {"samples": (1, 10_000)})
    samples = arguments.samples or (4 if arguments.quick else 20)
    pairs = scenarios_of(arguments)
    print_flight_remarks(scenario for found in pairs.values() for scenario in found.values())
    for found in pairs.values():
        for sentence in unequal_conditions(found):
            remark(sentence)
    folder = output_folder(arguments.output)
    flights: dict[str, dict[str, Metrics]] = {}
    for place, found in pairs.items():
        flights[place] = {}
        for name, scenario in found.items():
            with progress_bar("flying", **FLIGHT_BAR) as progress:
                flights[place][name] = fly_samples(
                    scenario, range(samples), compiled=not arguments.wired, progress=progress
                )
    files = [
        write_flights(folder / "comparison.csv", flights),
        *save_figures({"comparison": plot_comparison(flights)}, folder, vector=arguments.vector),
    ]
    print(
        f"{samples} samples each; mean and standard deviation; the share is the ratio of the mean RMSE to that of the"
        " first controller, with 95 % confidence"
    )
    print_comparison(flights)
    print_files(files)


def scenarios_of(arguments: argparse.Namespace) -> dict[str, dict[str, Scenario]]:
    """Return the scenarios to fly, by laboratory and controller."""
    arguments.controller = arguments.controller or [f"controllers/paper:{name}" for name in _CONTROLLERS]
    if arguments.quick:
        arguments.set = ["duration=6", *arguments.set]
    found: dict[str, dict[str, Scenario]] = {}
    for place in arguments.scenario or _SCENARIOS:
        scenarios = controlled_scenarios(arguments, place)
        name = next(iter(scenarios.values())).name
        if name in found:
            raise InputError(f"--scenario {place}: another scenario is called {name}; give each its own name")
        found[name] = scenarios
    return found


def print_comparison(flights: Mapping[str, Mapping[str, Metrics]]) -> None:
    """Print a row for each laboratory and controller."""
    rows = []
    for place, found in flights.items():
        first = next(iter(found.values()))
        for name, metrics in found.items():
            rows.append(
                (
                    place,
                    name,
                    f"{spread(100.0 * values_without_crashes(metrics, 'rmse'))} cm",
                    f"{spread(100.0 * values_without_crashes(metrics, 'peak_error'))} cm",
                    spread(values_without_crashes(metrics, "effort_x")),
                    spread(values_without_crashes(metrics, "effort_y")),
                    "100 %" if metrics is first else compare(metrics, first).ratio.percent(),
                    f"{int(metrics.crashed.sum())} crashed" if metrics.crashed.any() else "",
                )
            )
    print_columns(("scenario", "controller", "RMSE", "peak", "effort X (m²/s⁴)", "effort Y", "share", ""), rows)


def spread(values: np.ndarray) -> str:
    """Return the mean and the standard deviation of values as text."""
    if len(values) > 1:
        return plus_minus(values.mean(), values.std(ddof=1))
    return mean_interval(values).text()


def write_flights(path: Path, flights: Mapping[str, Mapping[str, Metrics]]) -> Path:
    """Write a CSV file with a row for each flight, and return its path."""
    rows = [
        (place, name, sample, *values)
        for place, found in flights.items()
        for name, metrics in found.items()
        for sample, values in enumerate(np.transpose(metrics))
    ]
    header = ("scenario", "controller", "sample", *Metrics._fields)
    return write_table(path, dict(zip(header, zip(*rows, strict=True), strict=True)), digits=9)
