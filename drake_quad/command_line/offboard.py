"""Fly the route of a scenario with a real quadrotor that runs PX4 or ArduPilot, over MAVLink.

The command sends either the reference of the route, which the autopilot follows with its own controllers, or the
commands of the scenario's controller. The route is shifted so that it begins where the vehicle hovers. Setpoints hold
this position until the pilot switches to the mode Offboard (PX4) or Guided (ArduPilot).

The flight ends if the vehicle leaves the geofence or exceeds another limit, if telemetry or a control tick is late, if
the pilot or a failsafe changes the mode, or with Ctrl-C. Read the page "Fly a real vehicle" first.
"""

import argparse
import math
from pathlib import Path

from drake_quad.command_line.options import (
    add_controller,
    add_overrides,
    check_ranges,
    parser_without_options,
    scenario_from_arguments,
)
from drake_quad.command_line.output import print_files
from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_atomically
from drake_quad.offboard.companion import SETPOINTS, Companion
from drake_quad.offboard.flight import OffboardFlight, Outcome
from drake_quad.offboard.limits import Fence, Limits
from drake_quad.offboard.link import END_MODES, OffboardError, VehicleLink
from drake_quad.scenario.files.saving import save_scenario

_DEFAULTS = Limits()
# Smallest and largest value of each option: m/s, degrees, degrees/s, m, baud.
_OPTION_RANGES = {
    "max_speed": (0.1, 100.0),
    "max_tilt": (1.0, 80.0),
    "max_rate": (1.0, 2000.0),
    "max_error": (0.05, 100.0),
    "baud": (1, 10**7),
}
LOG = "offboard.csv"
"""Name of the file with measurements, references and commands."""


def options() -> argparse.ArgumentParser:
    result = parser_without_options(
        __doc__, "drake-quad offboard figure_eight --address udpin:127.0.0.1:14540 --dry-run"
    )
    result.add_argument("scenario", help="FILE or FILE:NAME, or the name of a shipped scenario")
    add_overrides(result)
    add_controller(result)
    result.add_argument(
        "--address",
        default="udpin:127.0.0.1:14540",
        help="address of the vehicle in the notation of pymavlink, such as udpin:0.0.0.0:14540, tcp:127.0.0.1:5760 or"
        " /dev/ttyUSB0 (default: %(default)s)",
    )
    result.add_argument("--baud", type=int, default=57_600, help="baud rate of a serial port (default: %(default)s)")
    result.add_argument(
        "--send",
        choices=SETPOINTS,
        default="position",
        help="kind of setpoints: position is the reference, attitude and rates are the commands of the controller"
        " (default: %(default)s)",
    )
    result.add_argument("--dry-run", action="store_true", help="send neither setpoints nor modes to the vehicle")
    result.add_argument(
        "--engage", action="store_true", help="command the mode Offboard or Guided instead of waiting for the pilot"
    )
    result.add_argument(
        "--end", choices=END_MODES, default="hold", help="what the vehicle does after the flight (default: %(default)s)"
    )
    result.add_argument(
        "--system", type=int, metavar="NUMBER", help="MAVLink identifier of the vehicle, if there are several"
    )
    result.add_argument(
        "--fence",
        nargs=6,
        type=float,
        metavar=("X1", "X2", "Y1", "Y2", "Z1", "Z2"),
        help="geofence: smallest and largest coordinate to the north, to the west and upwards from the origin of the"
        " autopilot's local frame, m (default: the box around the route with a margin of 2 m)",
    )
    for name, metavar, default, text in (
        ("speed", "METRES/SECOND", _DEFAULTS.speed, "speed"),
        ("tilt", "DEGREES", math.degrees(_DEFAULTS.tilt), "commanded tilt"),
        ("rate", "DEGREES/SECOND", math.degrees(_DEFAULTS.rate), "commanded body rate"),
        ("error", "METRES", _DEFAULTS.error, "distance from the reference"),
    ):
        result.add_argument(
            f"--max-{name}", type=float, default=default, metavar=metavar, help=f"largest {text} (default: {default:g})"
        )
    result.add_argument(
        "--output", type=Path, default=Path("out/offboard"), help="output folder (default: out/offboard)"
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, _OPTION_RANGES)
    limits = Limits(
        _fence(arguments.fence),
        arguments.max_speed,
        math.radians(arguments.max_tilt),
        math.radians(arguments.max_rate),
        arguments.max_error,
    )
    companion = Companion(scenario_from_arguments(arguments), arguments.send, limits)
    folder = output_folder(arguments.output)
    log, saved_scenario = folder / LOG, folder / "scenario.yaml"
    link = VehicleLink(arguments.address, baud=arguments.baud, system=arguments.system)
    try:
        flight = OffboardFlight(
            link,
            companion,
            limits=limits,
            end_mode=arguments.end,
            engages=arguments.engage,
            dry_run=arguments.dry_run,
            report=lambda text: print(text, flush=True),
        )
        outcome = flight.run(log)
    finally:
        link.close()
    _print_outcome(outcome, dry_run=arguments.dry_run)
    if outcome.num_ticks:
        # The commands for logs read the vehicle from the scenario in the same folder.
        print_files([log, write_atomically(saved_scenario, lambda path: save_scenario(companion.scenario, path))])
    if not outcome.completed:
        raise OffboardError(f"the flight ended early: {outcome.reason}")


def _fence(numbers: list[float] | None) -> Fence | None:
    """Return the geofence that an option describes."""
    if numbers is None:
        return None
    fence = Fence(tuple(numbers[0::2]), tuple(numbers[1::2]))
    if not all(low < high for low, high in zip(*fence, strict=True)):
        raise InputError("--fence: the first number of each pair must be smaller than the second")
    return fence


def _print_outcome(outcome: Outcome, *, dry_run: bool) -> None:
    print(outcome.reason)
    if outcome.num_ticks and not dry_run:
        print(f"RMSE {100 * outcome.rmse:.1f} cm, largest error {100 * outcome.largest_error:.1f} cm")
    if math.isfinite(outcome.thrusts[0]):
        low, high = outcome.thrusts
        print(
            f"commanded tilt up to {math.degrees(outcome.largest_tilt):.1f}°, thrust {low:.2f} to {high:.2f} of the"
            f" maximum; tilt, rates or thrust limited in {outcome.num_limited} of {outcome.num_ticks} ticks"
        )
