"""Flight of a world with several vehicles, for the command `fly`."""

import argparse
import math
from collections.abc import Sequence

from drake_quad import InputError
from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import overrides_from_arguments, resolve_output_folder
from drake_quad.command_line.output import print_columns, print_files, remark
from drake_quad.files import output_folder
from drake_quad.flight.formats.flight_format import FlightFormat
from drake_quad.worlds.language import load_world, save_world
from drake_quad.worlds.simulation import WorldFlight, simulate_world

# Options that need a single vehicle, by the name of their argument.
_SINGLE_VEHICLE_OPTIONS = {
    "controller": "--controller",
    "meshcat": "--meshcat",
    "save_network": "--save-network",
    "vector": "--vector",
}


def fly_world(arguments: argparse.Namespace, formats: Sequence[FlightFormat]) -> None:
    """Fly the world that the arguments name, print its results, and write a folder for each vehicle and a replay."""
    for name, option in _SINGLE_VEHICLE_OPTIONS.items():
        if getattr(arguments, name):
            raise InputError(f"{option} needs a scenario with one vehicle, but {arguments.scenario} has several")
    world = load_world(arguments.scenario, overrides_from_arguments(arguments))
    if arguments.on != "host":
        raise InputError(f"--on {arguments.on} needs --controller FOLDER, and a scenario with one vehicle")
    first = next(iter(world.vehicles.values()))
    folder = output_folder(resolve_output_folder(arguments, first, name=world.name))
    print_flight_remarks([*world.vehicles.values()])
    sample = first.sample if arguments.sample is None else arguments.sample
    flown = simulate_world(world, sample=sample or 0, compiled=not arguments.wired)
    # Matplotlib takes half a second to import, so it is imported after all input has been checked.
    from drake_quad.visualization.replay.page import save_replay

    files = [save_replay(flown.flights, folder / "replay.html"), save_world(world, folder / "world.yaml")]
    for name, flight in flown.flights.items():
        files += flight.save(folder / name)
        files += [each.write(flight, folder / name / each.file_name) for each in formats]
    if sample is not None:
        print(f"sample {sample} (seed {first.seed})")
    print_world(flown)
    print_files(files)


def print_world(flown: WorldFlight) -> None:
    """Print the metrics of each vehicle, and the smallest distance between two vehicles."""
    others = {each.vehicle: each.other for each in flown.collisions}
    rows = []
    for name, flight in flown.flights.items():
        numbers = [100.0 * value for value in (flight.metrics.rmse, flight.metrics.peak_error)]
        texts = [f"{value:.2f}" if math.isfinite(value) else "–" for value in numbers]
        end = f"collides with {others[name]}" if name in others else flight.crash.partition(" at ")[0]
        rows.append((name, *texts, f"{flight.time[-1]:.2f}" if len(flight.time) else "0.00", end))
        if flight.cause is not None:
            remark(f"the flight of {name} ended because {flight.cause}")
    print_columns(("vehicle", "RMSE (cm)", "peak error (cm)", "flight time (s)", ""), rows)
    if len(flown.flights) > 1:
        print(f"smallest distance between two vehicles: {flown.smallest_distance:.3f} m")
