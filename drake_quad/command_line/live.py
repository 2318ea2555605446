"""Fly a scenario live in the browser, with sliders for wind, mass and gains, and buttons for a gust and a failure."""

import argparse

from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.fly import start_meshcat
from drake_quad.command_line.options import (
    add_controller,
    add_overrides,
    check_ranges,
    parser_without_options,
    scenario_from_arguments,
)
from drake_quad.command_line.output import remark


def options() -> argparse.ArgumentParser:
    result = parser_without_options(__doc__, "drake-quad live laboratory:low_wind")
    result.add_argument(
        "scenario",
        nargs="?",
        default="laboratory:low_wind",
        help="FILE or FILE:NAME, or the name of a shipped scenario (default: %(default)s)",
    )
    add_overrides(result)
    result.add_argument("--sample", type=int, help="number of the sample to fly; 0 is the first sample of a study")
    add_controller(result)
    result.add_argument(
        "--rate",
        type=float,
        default=1.0,
        help="ratio of simulated time to real time; 0 to run as fast as possible (default: 1)",
    )
    result.add_argument(
        "--time", type=float, metavar="SECONDS", help="end after this simulated time (default: when you click on stop)"
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, {"rate": (0.0, 1e6), "time": (0.0, 1e6)})
    scenario = scenario_from_arguments(arguments)
    # Meshcat is slow to import, so it is imported after the input has been checked.
    from drake_quad.visualization.live import LiveFlight

    print_flight_remarks([scenario])
    # `print_flight_remarks` reports a vehicle that ignores wind only if the scenario has wind. The sliders can add wind
    # to any scenario.
    if not scenario.laboratory.wind and (flaw := scenario.vehicle.explain_missing_wind_effect()):
        remark(f"the sliders for wind and the gust have no effect, since {flaw}")
    sample = scenario.sample if arguments.sample is None else arguments.sample
    meshcat = start_meshcat()
    flight = LiveFlight(scenario, meshcat, sample=sample or 0, rate=arguments.rate)
    print("open the controls at the top right of the page for sliders and buttons")
    print("keys: g for a gust, m for a motor failure, r to start again, Escape to stop (or Ctrl-C here)", flush=True)
    frames = flight.fly(float("inf") if arguments.time is None else arguments.time)
    try:
        for _ in frames:
            pass
    except KeyboardInterrupt:
        pass
    print("the flight has ended")
