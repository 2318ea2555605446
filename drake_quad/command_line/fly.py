"""Fly one scenario or a world, print the metrics, and write signals, plots and a replay for a browser."""

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
from drake_quad.command_line.fly_world import fly_world
from drake_quad.command_line.options import (
    add_controller,
    add_vector,
    add_wired,
    check_extra,
    check_ranges,
    parser,
    resolve_output_folder,
    scenario_from_arguments,
)
from drake_quad.command_line.output import print_files, print_table, remark
from drake_quad.command_line.progress import FLIGHT_BAR, progress_bar
from drake_quad.exported.machines import MACHINES
from drake_quad.files import output_folder
from drake_quad.flight.formats.flight_format import FORMATS, FlightFormat
from drake_quad.flight.mission import plan_route
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import draw_sample
from drake_quad.worlds.language import is_world


def options() -> argparse.ArgumentParser:
    result = parser(__doc__, "drake-quad fly figure_eight --set vehicle.mass=0.7", output="out")
    result.add_argument("--sample", type=int, help="number of the sample to fly; 0 is the first sample of a study")
    add_controller(result)
    result.add_argument(
        "--on",
        choices=[*MACHINES],
        default="host",
        help="computer that runs exported C code: this one, or a microcontroller that QEMU emulates (default: host)",
    )
    add_wired(result)
    result.add_argument("--meshcat", action="store_true", help="show the flight live in a browser on this machine")
    result.add_argument(
        "--rate",
        type=float,
        default=1.0,
        help="ratio of simulated time to real time with --meshcat; 0 to run as fast as possible (default: 1)",
    )
    result.add_argument(
        "--save-network",
        metavar="FILE",
        help="write the learned weights of the network; `control.network.learned: FILE` loads them for another flight",
    )
    for flight_format in FORMATS:
        result.add_argument(f"--{flight_format.option}", action="store_true", help=flight_format.help)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, {"rate": (0.0, 1e6)})
    formats = _formats(arguments)
    if is_world(arguments.scenario):
        fly_world(arguments, formats)
        return
    scenario = scenario_from_arguments(arguments)
    if arguments.save_network and scenario.control.network is None:
        raise InputError("--save-network requires a scenario with a network, but control.network is not given")
    folder = output_folder(resolve_output_folder(arguments, scenario))
    sample = scenario.sample if arguments.sample is None else arguments.sample
    meshcat = start_meshcat() if arguments.meshcat else None
    print_flight_remarks([scenario])
    drawn = draw_sample(scenario, sample or 0)
    plan = plan_route(drawn)
    prepare = None if meshcat is None else live_view(meshcat, drawn, plan, arguments.rate)
    with progress_bar("flying", **FLIGHT_BAR) as progress:
        compiled = False if arguments.wired else None
        flight = simulate(scenario, sample=sample, plan=plan, compiled=compiled, prepare=prepare, progress=progress)
    # Matplotlib takes half a second to import, so it is imported after all input has been checked.
    from drake_quad.visualization.plots import save_plots
    from drake_quad.visualization.replay.page import save_replay

    replay = save_replay({scenario.name: flight}, folder / "replay.html")
    files = [*flight.save(folder), *save_plots(flight, folder, vector=arguments.vector), replay]
    files += [flight_format.write(flight, folder / flight_format.file_name) for flight_format in formats]
    if arguments.save_network:
        files.append(save_network(flight, arguments.save_network))
    sample_rows = [("sample", str(sample), f"(seed {scenario.seed})")] if sample is not None else []
    print_table([*sample_rows, *summary(flight), *instruction_rows(scenario)])
    if flight.cause is not None:
        remark(f"the flight ended because {flight.cause}")
    print_files(files)
    if meshcat is not None:
        show_replay(meshcat, scenario.name, flight)


def _formats(arguments: argparse.Namespace) -> list[FlightFormat]:
    """Return the formats of further files that the arguments request."""
    formats = [flight_format for flight_format in FORMATS if getattr(arguments, flight_format.option)]
    for flight_format in formats:
        if flight_format.library is not None:
            module, extra = flight_format.library
            check_extra(f"--{flight_format.option}", extra, module)
    return formats


def instruction_rows(scenario: Scenario) -> list[tuple[str, str, str]]:
    """Return a row with the largest number of instructions per step, if exported code ran on an emulated board."""
    count = getattr(getattr(scenario.control, "system", None), "max_instructions", 0)
    return [("instructions per step", f"{count:,}", "at most")] if count else []


def start_meshcat() -> Meshcat:
    """Start Meshcat and print its address; in a terminal, wait until a browser is connected."""
    from drake_quad.visualization.replay.scene import local_meshcat

    meshcat = local_meshcat()
    print(f"open {meshcat.web_url()} in a browser on this machine", flush=True)
    if sys.stdin.isatty():
        print("the flight starts as soon as the page is open", flush=True)
        while meshcat.GetNumActiveConnections() == 0:
            time.sleep(0.1)
    return meshcat


def live_view(meshcat: Meshcat, scenario: Scenario, plan: Plan, rate: float) -> Callable[[Simulator], None]:
    """Draw the scene of a flight, and return a function that connects a simulator to the scene.

    The simulator then draws the vehicle in the scene while it runs.

    Args:
        meshcat: server that shows the scene.
        scenario: scenario of the flight.
        plan: plan of the flight.
        rate: ratio of simulated time to real time; 0 to run as fast as possible.
    """
    from drake_quad.visualization.replay.visualizer import QuadrotorVisualizer

    visualizer = QuadrotorVisualizer(meshcat, scenario, plan)

    def prepare(simulator: Simulator) -> None:
        simulator.set_target_realtime_rate(rate)
        visualizer.watch(simulator)

    return prepare


def show_replay(meshcat: Meshcat, name: str, flight: Flight) -> None:
    """Send the whole flight to the browser for replay; wait for Enter if the command runs in a terminal."""
    from drake_quad.visualization.replay.page import draw_replay

    meshcat.Delete()
    draw_replay(meshcat, {name: flight})
    if sys.stdin.isatty():
        with suppress(EOFError):  # Ctrl-D ends the command like Enter
            input("the browser now shows a replay of the whole flight; press Enter to end ")


def summary(flight: Flight) -> list[tuple[str, str, str]]:
    """Return a row of name, value and unit for each metric. A dash replaces a value that is not finite."""
    rows = [("flight time", flight.crash.removesuffix(" s") or f"{flight.time[-1]:.2f}", "s")]
    for name, metric in flight.metrics.definitions.items():
        if metric.display is not None:
            value = getattr(flight.metrics, name) / metric.display.size
            text = f"{value:.{metric.display.digits}f}" if math.isfinite(value) else "–"
            rows.append((metric.label, text, metric.display.unit))
    return rows
