"""Writes the controller of a flight controller's firmware, with the gains of a vehicle's parameters, as a layer.

Parameters are those of PX4 (a file of QGroundControl, or a ULog) or of a Crazyflie (a file of its client or of cflib).
What a file lacks has the default of the firmware. The scenario says which vehicle the firmware is on.
"""

import argparse
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from drake_quad.command_line.options import folder_of, all_overrides_of, parser
from drake_quad.command_line.output import print_files, remark
from drake_quad.design.firmware.layer import FIRMWARE, firmware_layer
from drake_quad.design.firmware.parameters import FirmwareParameters, defaults_of, read_parameters
from drake_quad.files import output_folder, write_whole
from drake_quad.scenario.files.loading import load_undesigned


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    example = "drake-quad firmware vehicles/crazyflie --parameters crazyflie"
    result = parser(__doc__, example, output="out/firmware", scenario="vehicles/crazyflie")
    result.add_argument(
        "--parameters",
        required=True,
        metavar="FILE",
        help=f"file with the parameters, or {' or '.join(FIRMWARE)} for the defaults of that firmware",
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    scenario = load_undesigned(arguments.scenario, all_overrides_of(arguments))
    name = arguments.parameters
    parameters = defaults_of(name) if name in FIRMWARE else read_parameters(Path(name))
    layer = firmware_layer(parameters, scenario)
    folder = output_folder(folder_of(arguments, scenario.name))
    path = write_whole(
        folder / "controller.yaml", lambda target: write_layer(layer, parameters, target, arguments.command)
    )
    if parameters.missing:
        remark(f"{len(parameters.missing)} parameters have the defaults of the firmware: {_some(parameters.missing)}")
    print(f"a scenario takes the controller by `extends: [FILE:NAME, {path}]`, in this order")
    print_files([path])


def write_layer(layer: dict[str, Any], parameters: FirmwareParameters, path: Path, command: str) -> None:
    """Write a layer as YAML that a scenario can extend, under the command that made it and its source."""
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 110
    missing = ""
    if parameters.missing:
        missing = f"# defaults, since the file does not have them: {_some(parameters.missing)}\n"
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {command}\n# {FIRMWARE[parameters.firmware]}\n{missing}")
        yaml.dump({"controller": layer}, file)


def _some(names: tuple[str, ...]) -> str:
    """Return the first names, and how many follow."""
    first = ", ".join(names[:5])
    return first if len(names) <= 5 else f"{first} and {len(names) - 5} more"
