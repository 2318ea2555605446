"""Design a linear-quadratic-Gaussian controller for a scenario, and print its stability margins.

The design uses the wind of the scenario along its plan. It covers several plants with different lags and delays. The
distributions of the scenario determine these plants. If there are none, the plants have typical deviations from the
given values.
"""

import argparse
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from drake_quad.command_line.flight_remarks import print_flight_remarks, remark_on_estimator
from drake_quad.command_line.options import (
    add_controller,
    add_stability_limits,
    check_ranges,
    parser,
    resolve_output_folder,
    scenario_from_arguments,
)
from drake_quad.command_line.output import flying_command, print_columns, print_files, print_margins
from drake_quad.design.lqg import LqgDesign, LqgLimits, design_lqg
from drake_quad.files import output_folder, write_atomically
from drake_quad.linear.link_margins import link_margins
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.saving import save_scenario

# Smallest and largest value of each option; the delay margin is in s, snap in m/s⁴, and acceleration in m/s².
_RANGES = {"sensitivity": (1.2, 10.0), "delay-margin": (0.0, 10.0), "snap": (0.1, 1e4), "acceleration": (0.01, 1e3)}


def options() -> argparse.ArgumentParser:
    result = parser(__doc__, "drake-quad design-lqg laboratory:low_wind --sensitivity 2.5", output="out/lqg")
    add_controller(result)
    default = LqgLimits()
    add_stability_limits(result, default.sensitivity, default.delay)
    result.add_argument(
        "--snap",
        type=float,
        default=default.snap,
        metavar="SIZE",
        help="largest root mean square of the command along x and y if torques are sent over the command link, m/s⁴"
        " (default: %(default)s, or twice the snap that compensates the disturbance torque, if this is larger)",
    )
    result.add_argument(
        "--acceleration",
        type=float,
        default=default.acceleration,
        metavar="SIZE",
        help="largest root mean square of the command along z, and with an autopilot also along x and y, m/s² (default:"
        " %(default)s)",
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, _RANGES)
    scenario = scenario_from_arguments(arguments, load=load_undesigned)
    print_flight_remarks([scenario])
    remark_on_estimator(scenario)
    limits = LqgLimits(arguments.sensitivity, arguments.delay_margin, arguments.snap, arguments.acceleration)
    design = design_lqg(scenario, limits)
    designed = scenario.model_copy(update={"control": design.control})
    folder = output_folder(resolve_output_folder(arguments, scenario))
    files = [
        write_atomically(folder / "lqg.yaml", lambda path: write_control(design, path, arguments.command)),
        write_atomically(folder / "scenario.yaml", lambda path: save_scenario(designed, path)),
    ]
    print_plants(design)
    print()
    print_margins(link_margins(median_scenario(designed)))
    print(f"\nto use the controller in a scenario, write `extends: [FILE:NAME, {files[0]}]`; to fly it:")
    print(f"  {flying_command('study', designed, files[1], '--samples 32')}")
    print_files(files)


def write_control(design: LqgDesign, path: Path, command: str) -> None:
    """Write the controller as YAML that a scenario can extend, with the command that designed it in a comment."""
    yaml = YAML()
    yaml.default_flow_style = None
    control: dict[str, Any] = design.control.model_dump(mode="json", exclude_none=True)
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {command}\n")
        yaml.dump({"lqg": {"control": control}}, file)


def print_plants(design: LqgDesign) -> None:
    """Print the plants of the design, each with the predicted RMS position errors."""
    rows = []
    for plant, x, z in zip(design.plants, design.lateral, design.vertical, strict=True):
        attitude = "–" if plant.response is None else f"{plant.response.natural_frequency:.2f} rad/s"
        rows.append(
            (
                f"{1e3 * plant.lag:.0f} ms",
                attitude,
                f"{plant.latency_frames}",
                f"{plant.delay_ticks}",
                *(f"{100.0 * each.error:.2f} cm" for each in (x, z)),
            )
        )
    print("RMS position errors that the linear model predicts in the scenario's wind and noise, for each plant")
    print_columns(("rotor lag", "attitude ω_n", "camera latency (frames)", "link delay (ticks)", "x and y", "z"), rows)
