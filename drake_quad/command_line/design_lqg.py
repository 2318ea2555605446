"""Designs linear-quadratic-Gaussian control for a scenario, and states the margins that it keeps.

The wind is that of the scenario along its plan, the plants are those of its distributions, or what its numbers may be
off by.
"""

import argparse
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from drake_quad.command_line.options import add_controller, check_ranges, folder_of, parser, scenario_of
from drake_quad.command_line.output import print_columns, print_files, print_margins
from drake_quad.design.lqg import LqgDesign, LqgLimits, design_lqg
from drake_quad.files import output_folder, write_atomically
from drake_quad.linear.link_margins import link_margins
from drake_quad.scenario.batch import middle_of
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.saving import save_scenario

_RANGES = {"sensitivity": (1.2, 10.0), "delay-margin": (0.0, 10.0), "snap": (0.1, 1e4), "acceleration": (0.01, 1e3)}


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    result = parser(__doc__, "drake-quad design-lqg laboratory:low_wind --sensitivity 2.5", output="out/lqg")
    add_controller(result)
    default = LqgLimits()
    result.add_argument(
        "--sensitivity", type=float, default=default.sensitivity, metavar="PEAK", help="at most (%(default)s)"
    )
    result.add_argument(
        "--delay-margin",
        type=float,
        default=default.delay,
        metavar="SECONDS",
        help="at least (%(default)s)",
    )
    result.add_argument(
        "--snap",
        type=float,
        default=default.snap,
        metavar="SIZE",
        help="root mean square of the command along x and y with torques over the link, m/s⁴, at most (%(default)s, or"
        " twice that of the torque that it has to hold)",
    )
    result.add_argument(
        "--acceleration",
        type=float,
        default=default.acceleration,
        metavar="SIZE",
        help="of that along z, and along x and y with an autopilot, m/s² (%(default)s)",
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    check_ranges(arguments, _RANGES)
    scenario = scenario_of(arguments, load=load_undesigned)
    limits = LqgLimits(arguments.sensitivity, arguments.delay_margin, arguments.snap, arguments.acceleration)
    design = design_lqg(scenario, limits)
    designed = scenario.model_copy(update={"control": design.control})
    folder = output_folder(folder_of(arguments, scenario.name))
    files = [
        write_atomically(folder / "lqg.yaml", lambda path: write_control(design, path, arguments.command)),
        write_atomically(folder / "scenario.yaml", lambda path: save_scenario(designed, path)),
    ]
    print_plants(design)
    print()
    print_margins(link_margins(middle_of(designed)))
    print(f"\na scenario takes the control by `extends: [FILE:NAME, {files[0]}]`, in this order; or fly it as it is:")
    print(f"  drake-quad study {files[1]} --samples 32")
    print_files(files)


def write_control(design: LqgDesign, path: Path, command: str) -> None:
    """Write the control as YAML that a scenario can extend, below a comment with the command that designed it."""
    yaml = YAML()
    yaml.default_flow_style = None
    control: dict[str, Any] = design.control.model_dump(mode="json", exclude_none=True)
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {command}\n")
        yaml.dump({"lqg": {"control": control}}, file)


def print_plants(design: LqgDesign) -> None:
    """Print the plants, each with the predicted RMS errors of the position."""
    rows = []
    for plant, x, z in zip(design.plants, design.lateral, design.vertical, strict=True):
        answer = "–" if plant.response is None else f"{plant.response.natural_frequency:.2f} rad/s"
        rows.append(
            (
                f"{1e3 * plant.lag:.0f} ms",
                answer,
                f"{plant.latency_frames}",
                f"{plant.delay_ticks}",
                *(f"{100.0 * each.error:.2f} cm" for each in (x, z)),
            )
        )
    print("root mean square of the error that the linear model predicts, in the scenario's wind and noise")
    print_columns(("rotors' lag", "attitude", "frames late", "delay (ticks)", "x and y", "z"), rows)
