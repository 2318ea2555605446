"""Flight of a world with several vehicles, for the command `fly`."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from drake_quad import InputError
from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import overrides_from_arguments
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.files import output_folder
from drake_quad.flight.formats.flight_format import FlightFormat
from drake_quad.worlds.language import load_world
from drake_quad.worlds.simulation import WorldFlight, simulate_world

# Options that need a single vehicle, by the name of their argument.
_SINGLE_VEHICLE_OPTIONS = {"controller": "--controller", "meshcat": "--meshcat", "save_network": "--save-network"}


def fly_world(arguments: argparse.Namespace, formats: Sequence[FlightFormat]) -> None:
    """Fly the world that the arguments name, print its results, and write a folder for each vehicle and a replay."""
    for name, option in _SINGLE_VEHICLE_OPTIONS.items():
        if getattr(arguments, name):
            raise InputError(f"{option} needs a scenario with one vehicle, but {arguments.scenario} has several")
    world = load_world(arguments.scenario, overrides_from_arguments(arguments))
    folder = output_folder(Path(arguments.output) if arguments.output is not None else Path("out") / world.name)
    print_flight_remarks([*world.vehicles.values()])
    sample = arguments.sample if arguments.sample is not None else 0
    flown = simulate_world(world, sample=sample, compiled=not arguments.wired)
    # Matplotlib takes half a second to import, so it is imported after all input has been checked.
    from drake_quad.visualization.replay.page import save_replay

    files = [save_replay(flown.flights, folder / "replay.html")]
    for name, flight in flown.flights.items():
        files += flight.save(folder / name)
        files += [each.write(flight, folder / name / each.file_name) for each in formats]
    print_world(flown)
    print_files(files)


def print_world(flown: WorldFlight) -> None:
    """Print the metrics of each vehicle, and the smallest distance between two vehicles."""
    others = {each.vehicle: each.other for each in flown.collisions}
    rows = []
    for name, flight in flown.flights.items():
        time = flight.crash.removesuffix(" s") or f"{flight.time[-1]:.2f}"
        numbers = f"{100.0 * flight.metrics.rmse:.2f}", f"{100.0 * flight.metrics.peak_error:.2f}"
        rows.append((name, *numbers, time, f"collides with {others[name]}" if name in others else ""))
    print_columns(("vehicle", "RMSE (cm)", "peak error (cm)", "flight time (s)", ""), rows)
    if len(flown.flights) > 1:
        print(f"smallest distance between two vehicles: {flown.smallest_distance:.3f} m")
