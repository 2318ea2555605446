"""Certify how far all random parameters of a scenario may vary at once before hover becomes unstable.

The ranges of all distributions are multiplied by a scale about their centres. The command prints two scales. Below the
first scale, every combination of parameters is proved to be stable; the proof uses the structured singular value of the
exact sampled-data loop. At the second scale, the command has found an unstable loop. Combinations whose loop has no
equilibrium, because a command or the rotors saturate in hover, are reported separately.
"""

import argparse
import math
import time
from pathlib import Path

from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import add_controller, parser, resolve_output_folder, scenario_from_arguments
from drake_quad.command_line.output import (
    flying_command,
    print_columns,
    print_files,
    print_joint_disk_margin,
    print_scales,
    remark,
)
from drake_quad.command_line.progress import new_bar
from drake_quad.design.certificate import Certificate, certify_hover
from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_table
from drake_quad.linear.link_margins import joint_disk_margin
from drake_quad.number_parsing import parse_float
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.description import unit_at
from drake_quad.scenario.distributions import Uniform
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.hovering import at_rest, symmetric_hover
from drake_quad.scenario.initial import InitialState
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.numbers import number_at
from drake_quad.scenario.paths import distributions_in, map_leaves

_MAX_GAP = 0.1  # a larger relative gap between the stable and the failing scale causes a remark
_INITIAL_ERROR = 0.1  # m and rad, initial error of the flight that shows an instability
# Duration of a flight that shows an instability: this many growth time constants, but within the two limits.
_NUM_GROWTH_TIMES = 5.0
_MIN_FLIGHT_SECONDS = 20.0  # s, shortest flight that shows an instability
_MAX_FLIGHT_SECONDS = 300.0  # s, longest flight that shows an instability
_NO_EQUILIBRIUM_SECONDS = 10.0  # s, duration of the flight that shows a loop without an equilibrium


def options() -> argparse.ArgumentParser:
    """Return the argument parser of the command."""
    result = parser(
        __doc__,
        "drake-quad certify laboratory:nominal --vary vehicle.mass=10% --vary vehicle.rotor_time_constant=10%",
        output="out/certify",
        scenario="robustness",
    )
    result.add_argument(
        "--vary",
        metavar="FIELD=PERCENT%",
        action="append",
        default=[],
        help="vary a field by up to this percentage of its value, as in vehicle.mass=10%%; the distributions of the"
        " scenario are then replaced by their medians; can be given several times",
    )
    add_controller(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    scenario = with_ranges(scenario_from_arguments(arguments), arguments.vary)
    folder = output_folder(resolve_output_folder(arguments, scenario))
    print_flight_remarks([scenario])
    began = time.perf_counter()
    with new_bar(desc=scenario.name, unit=" loops") as bar:

        def show(count: int, step: str) -> None:
            bar.set_postfix_str(step, refresh=False)
            bar.update(count)

        found = certify_hover(scenario, progress=show)
    seconds = time.perf_counter() - began
    median = median_scenario(scenario)
    print_certificate(scenario, found)
    if found.stable_scale > 0.0:
        print_joint_disk_margin(joint_disk_margin(median))
    print(f"computed from {found.num_loops:,} exact linear models of the loop in {seconds:.0f} s")
    files = write_tables(folder, median, found)
    for name, failing, lines in failing_flights(median, found):
        files.append(folder / name)
        save_scenario(failing, files[-1])
        print(f"\n{lines[0]}\n  {flying_command('fly', failing, files[-1])}", *lines[1:], sep="\n")
    print_files(files)


def failing_flights(median: Scenario, found: Certificate) -> list[tuple[str, Scenario, list[str]]]:
    """Return flights that show how hover fails.

    Returns:
        For each flight its file name, its scenario, and the lines to print: the first line before the command that
        flies the scenario, the other lines after it.
    """
    flights = []
    if found.growth is not None:
        loop, time_constant = found.growth
        flights.append(
            (
                "unstable.yaml",
                hovering_at(median, loop.values, duration=_flight_seconds(time_constant), offset=_INITIAL_ERROR),
                [
                    f"to see the instability, fly in hover with the parameters at scale {loop.scale:.3g}:",
                    f"the vehicle starts {100.0 * _INITIAL_ERROR:.0f} cm from its reference along each axis,",
                    f"and an oscillation grows by a factor of e in {time_constant:.1f} s, until the commands saturate"
                    " or the vehicle crashes",
                ],
            )
        )
    if found.without_equilibrium.values:
        flights.append(
            (
                "no_equilibrium.yaml",
                hovering_at(median, found.without_equilibrium.values, duration=_NO_EQUILIBRIUM_SECONDS),
                [
                    "to see a loop without an equilibrium, fly in hover at scale"
                    f" {found.without_equilibrium.scale:.3g}:",
                    "a command or the rotors saturate, and the vehicle cannot stay at its reference",
                ],
            )
        )
    return flights


def with_ranges(scenario: Scenario, texts: list[str]) -> Scenario:
    """Return the scenario in which the fields of `--vary` have uniform distributions.

    Raises:
        InputError: if a text does not have the form FIELD=PERCENT%, or FIELD is not a number of the scenario.
    """
    if not texts:
        if not distributions_in(scenario):
            raise InputError(
                f"{scenario.name} contains no distribution; give ranges of fields, as in --vary vehicle.mass=10%"
            )
        return scenario
    median, ranges = median_scenario(scenario), {}
    for text in texts:
        path, _, percent = text.partition("=")
        try:
            fraction = 0.01 * parse_float(percent.removesuffix("%"))
        except (ValueError, argparse.ArgumentTypeError):
            fraction = math.nan
        if not percent.endswith("%") or not 0.0 < fraction < 1.0:
            raise InputError(
                f"--vary {text} must have the form FIELD=PERCENT%, with a percentage between 0 % and 100 %, as in"
                " vehicle.mass=10%"
            )
        value = number_at(median, path)
        if value == 0.0:
            raise InputError(f"--vary {text}: {path} is 0, so its range would have no width; vary another field")
        low, high = sorted((value * (1.0 - fraction), value * (1.0 + fraction)))
        ranges[path] = Uniform.model_validate({"uniform": {"min": low, "max": high}})
    return map_leaves(median, lambda path, value: ranges.get(path, value))


def hovering_at(median: Scenario, values: dict[str, float], *, duration: float, offset: float = 0.0) -> Scenario:
    """Return a scenario in which the vehicle hovers in still air, as in the loops that `certify` examines.

    Args:
        median: scenario without distributions.
        values: values that replace those of the scenario, by path.
        duration: duration of the flight, s.
        offset: initial deviation from the reference along each axis, m, and in yaw, rad.
    """
    failing = map_leaves(median, lambda path, value: values.get(path, value))
    initial = InitialState(position=(offset, offset, offset), attitude=(0.0, 0.0, offset))
    settings = {"crash": median.crash, "duration": duration, "initial": initial}
    return symmetric_hover(at_rest(failing)).model_copy(update=settings)


def _flight_seconds(growth_time: float) -> float:
    """Return the duration of a flight in which an instability becomes obvious, s."""
    seconds = 10.0 * math.ceil(0.1 * _NUM_GROWTH_TIMES * growth_time)
    return min(max(seconds, _MIN_FLIGHT_SECONDS), _MAX_FLIGHT_SECONDS)


def print_certificate(scenario: Scenario, found: Certificate) -> None:
    """Print the scales up to which hover is stable and from which it fails, and the parameters at which it fails."""
    print_scales(scenario.name, found)
    failures = {"unstable": found.unstable, "no equilibrium": found.without_equilibrium}
    median, columns = median_scenario(scenario), {name: each for name, each in failures.items() if each.values}
    rows = []
    for path in found.parameters if columns else ():
        unit = unit_at(median, path)
        numbers = [number_at(median, path), *(each.values[path] for each in columns.values())]
        rows.append((path, *(f"{number:.4g}" for number in numbers), "" if unit == "1" else unit))
    print_columns(("parameter", "median", *columns, "unit"), rows)
    if found.without_equilibrium.values:
        remark(
            "a combination without an equilibrium saturates a command or the rotors, so the vehicle cannot hover there;"
            " its loop is neither stable nor unstable"
        )
    if found.gap > _MAX_GAP:
        remark(
            f"the stable and the failing scale are more than {100.0 * _MAX_GAP:.0f} % apart: between them, hover is not"
            " proved to be stable, and no instability was found"
        )
    if found.left_out:
        remark(f"these distributions do not act on hover in still air and are left out: {', '.join(found.left_out)}")


def write_tables(folder: Path, median: Scenario, found: Certificate) -> list[Path]:
    """Write a table of the scales up to which hover is stable and from which it fails, and a table of the parameters.

    All ranges of random parameters are multiplied by the scale. The second table contains the certified range of each
    parameter, and the values of all parameters at the scales at which hover fails.
    """
    scales = {
        "stable_up_to_scale": found.stable_scale,
        "unstable_at_scale": found.unstable.scale,
        "no_equilibrium_at_scale": found.without_equilibrium.scale,
    }
    box = found.certified_box
    parameters: dict[str, list[float | str]] = {
        "parameter": [*found.parameters],
        "unit": [unit_at(median, path) for path in found.parameters],
        "median": [number_at(median, path) for path in found.parameters],
        "certified_from": [box[path][0] for path in found.parameters],
        "certified_to": [box[path][1] for path in found.parameters],
        "value_of_unstable_loop": [found.unstable.values.get(path, math.nan) for path in found.parameters],
        "value_without_equilibrium": [
            found.without_equilibrium.values.get(path, math.nan) for path in found.parameters
        ],
    }
    return [
        write_table(folder / "scales.csv", {name: [scale] for name, scale in scales.items()}),
        write_table(folder / "parameters.csv", parameters),
    ]
