"""Controllers of flight-controller firmware, as `drake-quad design --firmware` writes them."""

import argparse
import tempfile
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from drake_quad.command_line.options import all_overrides_of, folder_of
from drake_quad.command_line.output import print_files, remark
from drake_quad.design.firmware.layer import FIRMWARE, firmware_layer
from drake_quad.design.firmware.parameters import FirmwareParameters, defaults_of, read_parameters
from drake_quad.files import output_folder, write_atomically, write_text
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.paths import distributions_in


def take_firmware(arguments: argparse.Namespace) -> None:
    """Write the controller of a firmware as a layer, and the scenario with it.

    Args:
        arguments: arguments of the command, whose `firmware` is the file with the parameters, or the name of a firmware
            for its defaults.

    Raises:
        InputError: if the file cannot be read, or the scenario cannot take the controller.
    """
    name, overrides = arguments.firmware, all_overrides_of(arguments)
    parameters = defaults_of(name) if name in FIRMWARE else read_parameters(Path(name))
    scenario = load_undesigned(arguments.scenario, overrides)
    layer = firmware_layer(parameters, scenario)
    folder = output_folder(folder_of(arguments, scenario.name))
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary, "controller.yaml")
        write_layer(layer, parameters, path, arguments.command)
        with_it = load_undesigned(arguments.scenario, overrides, layers=[path])
        text = path.read_text(encoding="utf-8")
    path = write_text(folder / "controller.yaml", text)
    flown = write_atomically(folder / "scenario.yaml", lambda target: save_scenario(with_it, target))
    if parameters.missing:
        count = len(parameters.missing)
        were = "parameter has the default" if count == 1 else "parameters have the defaults"
        remark(f"{count} {were} of the firmware: {_some(parameters.missing)}")
    print(FIRMWARE[parameters.firmware])
    print(f"a scenario takes it by `extends: [FILE:NAME, {path}]`, in this order; or fly it as it is:")
    print(f"  drake-quad {'study' if distributions_in(with_it) else 'fly'} {flown}")
    print_files([path, flown])


def write_layer(layer: dict[str, Any], parameters: FirmwareParameters, path: Path, command: str) -> None:
    """Write a layer as YAML that a scenario can extend, below a comment with the command and the source."""
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
    """Return the first names and the number of the rest as text."""
    first = ", ".join(names[:5])
    return first if len(names) <= 5 else f"{first} and {len(names) - 5} more"
