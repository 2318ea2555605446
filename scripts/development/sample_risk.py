"""Estimate the probability of a rare event by plain Monte Carlo sampling, for comparison with `drake-quad risk`.

A study with ten million samples would write gigabytes. This script only counts the flights in which the event occurs.
"""

import argparse

from drake_quad.command_line.running import run

from drake_quad import StudyFleet, plan_route
from drake_quad.command_line.options import (
    add_controller,
    add_overrides,
    check_ranges,
    parser_without_options,
    scenario_from_arguments,
)
from drake_quad.command_line.progress import counting_bar
from drake_quad.statistics.estimates import proportion_interval
from drake_quad.studies.risk import Event

_NUM_VEHICLES = 2048  # largest number of vehicles that fly at the same time


def main() -> None:
    """Read the command line, and count the events."""
    options = parser_without_options(
        __doc__,
        "python scripts/development/sample_risk.py --controller controllers/designed/robustness:lqg --set duration=1"
        " --event 'peak_error > 0.37'",
    )
    options.add_argument("scenario", nargs="?", default="robustness", help="FILE:NAME (default: %(default)s)")
    add_overrides(options)
    options.add_argument("--event", default="crash", help="event as in drake-quad risk (default: %(default)s)")
    options.add_argument("--flights", type=int, default=10_000_000, help="number of flights (default: %(default)s)")
    options.add_argument("--first", type=int, default=0, help="index of the first sample (default: %(default)s)")
    add_controller(options)
    arguments = options.parse_args()
    run(lambda: count_events(arguments))


def count_events(arguments: argparse.Namespace) -> None:
    """Fly the samples, and print the probability of the event with its 95 % interval."""
    check_ranges(arguments, {"flights": (1, 2**31), "first": (0, 2**31 - 1)})
    scenario = scenario_from_arguments(arguments)
    event = Event.parse(arguments.event, scenario)
    fleet = StudyFleet(scenario, plan_route(scenario), min(_NUM_VEHICLES, arguments.flights))
    count, end = 0, arguments.first + arguments.flights
    with counting_bar(str(event), arguments.flights) as show:
        for first in range(arguments.first, end, fleet.num_vehicles):
            samples = range(first, min(first + fleet.num_vehicles, end))
            count += int((event.performance(fleet.fly(samples)) >= 0.0).sum())
            show(len(samples), f"{count} events")
    probability = proportion_interval(count, arguments.flights)
    print(
        f"{scenario.name}: {event} occurs in {count:,} of {arguments.flights:,} flights, {probability.value:.2e}"
        f" [{probability.low:.1e}, {probability.high:.1e}]"
    )


if __name__ == "__main__":
    main()
