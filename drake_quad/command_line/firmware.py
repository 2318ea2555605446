"""Implementation of `drake-quad design --firmware`, which writes the controller of a flight-controller firmware."""

import argparse
import tempfile
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import overrides_from_arguments, resolve_output_folder
from drake_quad.command_line.output import flying_command, print_files, remark
from drake_quad.design.firmware.layer import FIRMWARE, firmware_layer
from drake_quad.design.firmware.parameters import FirmwareParameters, default_parameters, read_parameters
from drake_quad.files import output_folder, write_atomically, write_text
from drake_quad.flight.mission import plan_route
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.paths import distributions_in


def write_firmware_controller(arguments: argparse.Namespace) -> None:
    """Write the controller of a firmware as a file that scenarios can extend, and the scenario with this controller.

    Args:
        arguments: arguments of the command. `firmware` is the path of a parameter file, or the name of a firmware for
            its default parameters.

    Raises:
        InputError: if the file cannot be read, the scenario cannot use the controller, or its rotors cannot fly the
            route.
    """
    name, overrides = arguments.firmware, overrides_from_arguments(arguments)
    parameters = default_parameters(name) if name in FIRMWARE else read_parameters(Path(name))
    scenario = load_undesigned(arguments.scenario, overrides)
    layer = firmware_layer(parameters, scenario)
    folder = output_folder(resolve_output_folder(arguments, scenario))
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary, "controller.yaml")
        write_layer(layer, parameters, path, arguments.command)
        designed = load_undesigned(arguments.scenario, overrides, layers=[path])
        text = path.read_text(encoding="utf-8")
    print_flight_remarks([designed])
    plan_route(designed)  # raises an error if the rotors cannot carry the vehicle along its route
    path = write_text(folder / "controller.yaml", text)
    scenario_file = write_atomically(folder / "scenario.yaml", lambda target: save_scenario(designed, target))
    if parameters.missing:
        count = len(parameters.missing)
        phrase = "parameter is" if count == 1 else "parameters are"
        remark(
            f"{count} {phrase} missing in the file and set to the firmware's default:"
            f" {_shortened_list(parameters.missing)}"
        )
    print(FIRMWARE[parameters.firmware])
    command = "study" if distributions_in(designed) else "fly"
    print(f"to use the controller in a scenario, write `extends: [FILE:NAME, {path}]`; to {command} this scenario:")
    print(f"  {flying_command(command, designed, scenario_file)}")
    print_files([path, scenario_file])


def write_layer(layer: dict[str, Any], parameters: FirmwareParameters, path: Path, command: str) -> None:
    """Write the controller as YAML that scenarios can extend, with the command and the source in a comment."""
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 110
    missing = ""
    if parameters.missing:
        missing = f"# missing in the parameter file and set to defaults: {_shortened_list(parameters.missing)}\n"
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {command}\n# {FIRMWARE[parameters.firmware]}\n{missing}")
        yaml.dump({"controller": layer}, file)


def _shortened_list(names: tuple[str, ...]) -> str:
    """Return a text with the first five names, and the number of the remaining names."""
    first = ", ".join(names[:5])
    return first if len(names) <= 5 else f"{first} and {len(names) - 5} more"
