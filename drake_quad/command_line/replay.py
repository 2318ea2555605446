"""Write a page that replays many samples of a scenario, or several controllers, together in a browser."""

import argparse

from drake_quad import Flight
from drake_quad.command_line.flight_remarks import print_comparison_remarks, print_flight_remarks
from drake_quad.command_line.options import (
    add_controller,
    check_ranges,
    controlled_scenarios,
    parser,
    resolve_output_folder,
)
from drake_quad.command_line.output import print_files
from drake_quad.files import output_folder
from drake_quad.flight.simulation import simulate_samples
from drake_quad.visualization.replay.page import save_replay, save_swarm


def options() -> argparse.ArgumentParser:
    result = parser(__doc__, "drake-quad replay robustness --samples 100", output="out/replay", scenario="robustness")
    result.add_argument(
        "--samples", type=int, default=100, help="number of samples of each scenario (default: %(default)s)"
    )
    result.add_argument("--first", type=int, default=0, help="number of the first sample (default: %(default)s)")
    add_controller(result, several="can be given several times; each flies the same samples and has its own colour")
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, {"samples": (1, 1000), "first": (0, 1e9)})
    scenarios = controlled_scenarios(arguments)
    print_flight_remarks(scenarios.values())
    print_comparison_remarks(scenarios)
    samples = range(arguments.first, arguments.first + arguments.samples)
    flights = {name: simulate_samples(each, samples) for name, each in scenarios.items()}
    file = (
        output_folder(resolve_output_folder(arguments, next(iter(scenarios.values())), name="_".join(flights)))
        / "replay.html"
    )
    if arguments.samples == 1:
        save_replay({name: first for name, (first,) in flights.items()}, file)
    else:
        save_swarm(flights, file)
    print_crashes(flights)
    print_files([file])


def print_crashes(flights: dict[str, list[Flight]]) -> None:
    """Print the numbers of flights and crashes of each scenario."""
    for name, group in flights.items():
        print(f"{name}: {len(group)} flights, {sum(bool(flight.metrics.crashed) for flight in group)} crashed")
