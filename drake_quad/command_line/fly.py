"""Flies one scenario, prints its metrics and writes signals, plots and a replay to open in a browser."""

import argparse
import math
import sys
import time
from collections.abc import Callable
from contextlib import suppress

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from drake_quad import Flight, InputError, Scenario, save_network, simulate
from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import add_vector, check_extra, folder_of, parser, scenario_of
from drake_quad.command_line.output import print_files, print_table, remark
from drake_quad.command_line.progress import flight_progress
from drake_quad.files import output_folder
from drake_quad.flight.mcap_file import save_mcap
from drake_quad.flight.mission import plan_route
from drake_quad.flight.px4_table import save_px4_table
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import draw_sample


def options() -> argparse.ArgumentParser:
    """The options of the command."""
    result = parser(
        "fly",
        __doc__,
        example="drake-quad fly figure_eight --set vehicle.mass=0.7",
        output="out",
        scenario="figure_eight",
    )
    result.add_argument("--sample", type=int, help="which sample of the scenario's study to fly, from 0 on")
    result.add_argument("--compiled", action="store_true", help="compile the diagram to machine code first")
    result.add_argument("--meshcat", action="store_true", help="show the flight live in a browser on this machine")
    result.add_argument(
        "--rate", type=float, default=1.0, help="of real time, with --meshcat; 0 is as fast as can be (default: 1)"
    )
    result.add_argument(
        "--save-network",
        metavar="FILE",
        help="write what the network has learned, for `control.network.learned: FILE` of another flight",
    )
    result.add_argument(
        "--mcap", action="store_true", help="write the flight also as flight.mcap, which Foxglove shows"
    )
    result.add_argument(
        "--px4", action="store_true", help="write the flight also as px4.csv, with the names of PX4's logs"
    )
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    if not (math.isfinite(arguments.rate) and arguments.rate >= 0.0):
        raise InputError(f"--rate is {arguments.rate}, but must be 0 or more")
    if arguments.compiled and arguments.meshcat:
        raise InputError("--meshcat shows the diagram as it is wired, which --compiled does not fly; give one of them")
    scenario = scenario_of(arguments)
    if arguments.save_network and scenario.control.network is None:
        raise InputError("--save-network needs a network, but the scenario has none")
    if arguments.mcap:
        check_extra("--mcap", "mcap", "mcap.writer")
    folder = output_folder(folder_of(arguments, scenario.name))
    sample = scenario.sample if arguments.sample is None else arguments.sample
    meshcat = opened_meshcat() if arguments.meshcat else None
    print_flight_remarks([scenario])
    drawn = draw_sample(scenario, sample or 0)
    plan = plan_route(drawn)
    prepare = None if meshcat is None else live_view(meshcat, drawn, plan, arguments.rate)
    with flight_progress() as progress:
        flight = simulate(
            scenario, sample=sample, plan=plan, compiled=arguments.compiled, prepare=prepare, progress=progress
        )
    # Matplotlib takes half a second to load, which an error need not wait for.
    from drake_quad.visualization.plots import save_plots
    from drake_quad.visualization.replay.page import save_replay

    replay = save_replay({scenario.name: flight}, folder / "replay.html")
    files = [*flight.save(folder), *save_plots(flight, folder, vector=arguments.vector), replay]
    if arguments.mcap:
        files.append(save_mcap(flight, folder / "flight.mcap"))
    if arguments.px4:
        files.append(save_px4_table(flight, folder / "px4.csv"))
    if arguments.save_network:
        files.append(save_network(flight, arguments.save_network))
    which = [("sample", str(sample), f"of seed {scenario.seed}")] if sample is not None else []
    print_table([*which, *summary(flight)])
    if flight.cause is not None:
        remark(f"the flight ended since {flight.cause}")
    print_files(files)
    if meshcat is not None:
        show_again(meshcat, scenario.name, flight)


def opened_meshcat() -> Meshcat:
    """Starts Meshcat; on a terminal, waits until somebody has opened it in a browser."""
    from drake_quad.visualization.replay.scene import local_meshcat

    meshcat = local_meshcat()
    print(f"open {meshcat.web_url()} in a browser on this machine", flush=True)
    if sys.stdin.isatty():
        print("the flight begins when it is there", flush=True)
        while meshcat.GetNumActiveConnections() == 0:
            time.sleep(0.1)
    return meshcat


def live_view(meshcat: Meshcat, scenario: Scenario, plan: Plan, rate: float) -> Callable[[Simulator], None]:
    """Draws the scene of a flight, and returns a function that has a simulator show the flight in it."""
    from drake_quad.visualization.replay.live import LiveView

    view = LiveView(meshcat, scenario, plan)
    return lambda simulator: view.watch(simulator, rate)


def show_again(meshcat: Meshcat, name: str, flight: Flight) -> None:
    """Send the whole flight to the browser for replay; on a terminal, wait for Enter."""
    from drake_quad.visualization.replay.page import draw_replay

    meshcat.Delete()
    draw_replay(meshcat, {name: flight})
    if sys.stdin.isatty():
        with suppress(EOFError):  # Ctrl-D ends the command like Enter
            input("the browser can now replay the whole flight; press Enter to end ")


def summary(flight: Flight) -> list[tuple[str, str, str]]:
    """The metrics as rows of name, value and unit, with a dash for a value that could not be measured."""
    metrics = flight.metrics

    def number(value: float, digits: int) -> str:
        return f"{value:.{digits}f}" if math.isfinite(value) else "–"

    end = flight.crash.removesuffix(" s") or f"{flight.time[-1]:.2f}"
    return [
        ("flown", end, "s, compiled" if flight.compiled else "s"),
        ("RMSE", number(100.0 * metrics.rmse, 2), "cm"),
        *((f"RMSE on {axis.upper()}", number(100.0 * getattr(metrics, f"rmse_{axis}"), 2), "cm") for axis in "xyz"),
        ("peak error", number(100.0 * metrics.peak_error, 2), "cm"),
        *(
            (f"control effort on {axis.upper()}", number(getattr(metrics, f"effort_{axis}"), 4), "m²/s⁴")
            for axis in "xyz"
        ),
        ("rotors saturated", number(100.0 * metrics.saturation_share, 1), "% of the ticks"),
    ]
