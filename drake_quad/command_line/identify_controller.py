"""Identify the position law of a controller from its flight logs, and write it as a controller for scenarios.

The command prints the gains on position and velocity, the integral gain, the feed-forward, the filter, the limit and
the delay with 95 % intervals, and the parameters that the logs do not identify. To use the written controller, extend
it in a scenario, or give it to `drake-quad study` by `--controller`.
"""

import argparse
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from drake_quad.command_line.identify import initial_vehicle_name, load_initial_vehicle, output_file, vehicle_name
from drake_quad.command_line.options import parse_overrides, parser_without_options
from drake_quad.command_line.output import print_columns, print_files, remark
from drake_quad.errors import InputError
from drake_quad.files import write_atomically
from drake_quad.identification.position_law.control import control_layer
from drake_quad.identification.position_law.law import PositionLaw, identify_position_law
from drake_quad.logs.reading import read_log
from drake_quad.scenario.files.loading import Override
from drake_quad.statistics.interval import plus_minus

# Description of each form of a position law. The form determines how the output of the law is converted to commands of
# attitude and thrust.
_FORM_DESCRIPTIONS = {
    "acceleration": "thrust along the commanded attitude",
    "heading": "thrust along the commanded roll and pitch at the measured yaw",
    "decoupled": "tilt from the horizontal acceleration only, and vertical thrust",
    "projected": "component of the commanded force along the measured thrust axis",
    "tilt": "roll, pitch and thrust, independently of each other",
}


def options() -> argparse.ArgumentParser:
    result = parser_without_options(
        __doc__, "drake-quad identify-controller tests/data/crazyflie/crazyswarm2/log08.xz --mass 0.0333"
    )
    result.add_argument("log", nargs="+", type=Path, help="flight logs with the same controller")
    result.add_argument("--vehicle", help="FILE or FILE:NAME of the vehicle whose parameters the controller uses")
    result.add_argument("--mapping", help="YAML file that maps columns to signals, or the name of a shipped mapping")
    result.add_argument("--mass", type=float, metavar="KG", help="mass that the controller uses")
    result.add_argument(
        "--set", metavar="FIELD=VALUE", action="append", default=[], help="override a field of the vehicle"
    )
    result.add_argument(
        "--output", type=Path, metavar="FILE", help="file to write (default: out/identified/NAME_controller.yaml)"
    )
    result.set_defaults(name=None)
    return result


def main(arguments: argparse.Namespace) -> None:
    path = output_file(arguments, f"{vehicle_name(arguments)}_controller.yaml")
    overrides = parse_overrides(arguments.set)
    if arguments.mass is not None:
        overrides.append(Override(f"nominal.mass={arguments.mass}", f"--mass {arguments.mass:g}"))
    records = [read_log(log, arguments.mapping) for log in arguments.log]
    vehicle = load_initial_vehicle(arguments.vehicle or initial_vehicle_name(records, arguments.log), overrides)
    law = identify_position_law(records, vehicle)
    print_law(law)
    try:
        layer = control_layer(law)
    except InputError as error:
        remark(str(error))
        return
    write_atomically(path, lambda target: write_controller(layer, law, target, arguments.command))
    control = layer["control"]
    if "kind" in control:
        print("the law is written as a controller of kind pid_cascade, for scenarios with attitude control on board:")
    else:
        kind = control["position"]["kind"]
        print(f"the law is written as a position controller of kind {kind}, for scenarios with control.kind cascade:")
    print(f"  drake-quad study SCENARIO --controller {path}:controller")
    print(f"or use it in a scenario with `extends: [SCENARIO, {path}:controller]`")
    print_files([path])


def print_law(law: PositionLaw) -> None:
    """Print the estimates of a position law, and the parameters that the logs do not identify."""
    rows = [
        (" and ".join(axis.axes), name.replace("_", " "), plus_minus(spread.value, spread.half_width), unit)
        for axis in law.axes
        for name, spread in axis.gains.items()
        for unit in ["" if spread.unit == "1" else spread.unit]
    ]
    print("position law with 95 % intervals")
    print_columns(("axis", "gain", "value", "unit"), rows)
    for axis in law.axes:
        names = " and ".join(axis.axes)
        print(f"{names}: the law explains {100.0 * axis.explained_variance:.2f} % of the variance of the command")
        if axis.at_error_limit:
            print(f"{names}: the position error is limited in {100.0 * axis.at_error_limit:.1f} % of the samples")
        for name, why in axis.not_identified.items():
            print(f"not identified: {name.replace('_', ' ')} on {names}: {why}")
    for name, why in law.not_identified.items():
        print(f"not identified: {name}: {why}")
    print(f"form of the command: {_FORM_DESCRIPTIONS[law.form]}")
    if law.at_limits:
        print(f"{100.0 * law.at_limits:.1f} % of the samples are left out, because a command is at its limit")
    for sentence in law.remarks:
        remark(sentence)


def write_controller(layer: dict[str, Any], law: PositionLaw, path: Path, command: str) -> None:
    """Write a controller as YAML that scenarios can extend, with the command and the delays in a comment."""
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 110
    delays = [
        f"# {' and '.join(axis.axes)}: delay from the measurement to the command"
        f" {plus_minus(1e3 * axis.gains['delay'].value, 1e3 * axis.gains['delay'].half_width)} ms\n"
        for axis in law.axes
        if "delay" in axis.gains
    ]
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {command}\n{''.join(delays)}")
        yaml.dump({"controller": layer}, file)
