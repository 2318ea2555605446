"""Parameter files of flight controllers, as tools of PX4 and of the Crazyflie write them."""

import functools
import math
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, NamedTuple

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from drake_quad.errors import InputError
from drake_quad.identification.logs.formats.ulog import MAGIC, ulog_parameters
from drake_quad.identification.logs.source import read_file

Firmware = Literal["crazyflie", "px4"]

# A line contains a name and a number, either in the columns of QGroundControl or next to each other.
_NAME_AND_NUMBER = re.compile(r"(?:^|[\s,])([A-Za-z]\w*(?:\.\w+)?)[\s:=,]+([-+]?(?:\.?\d|nan|inf)[^\s,]*)")
_PARAMETER_GROUPS = {"crazyflie": "posCtlPid, velCtlPid, pid_attitude and pid_rate", "px4": "MPC_* and MC_*"}


class FirmwareParameters(NamedTuple):
    """Parameters of the controllers of a vehicle.

    Attributes:
        firmware: firmware of the vehicle.
        values: values of all parameters of the controllers, by name.
        missing: names of the parameters that the file does not contain; their values are the firmware's defaults.
    """

    firmware: Firmware
    values: Mapping[str, float]
    missing: tuple[str, ...]


def defaults_of(firmware: Firmware) -> FirmwareParameters:
    """Return the defaults of a firmware."""
    return FirmwareParameters(firmware, {name: each.default for name, each in _declared(firmware).items()}, ())


def read_parameters(path: Path) -> FirmwareParameters:
    """Read the parameters of a vehicle.

    The file is a ULog or a parameter file of QGroundControl (PX4), a YAML file of the Crazyflie's client or of cflib,
    or a text of lines with a name and a number.

    Raises:
        InputError: if the file cannot be read, or contains no parameter of either firmware.
    """
    log = read_file(path)
    if log.data.startswith(MAGIC):
        values = {name: float(value) for name, value in ulog_parameters(log).items()}
    else:
        values = _in_text(path, log.data)
    for firmware in ("px4", "crazyflie"):
        declared = _declared(firmware)
        specified_values = {name: values[name] for name in declared if name in values}
        for name, value in specified_values.items():
            if flaw := declared[name].flaw(value):
                raise InputError(f"{path}: {name} is {value:g}; it must {flaw}")
        if specified_values:
            missing = tuple([name for name in declared if name not in specified_values])
            return FirmwareParameters(firmware, {**defaults_of(firmware).values, **specified_values}, missing)
    groups = " nor ".join(_PARAMETER_GROUPS.values())
    raise InputError(f"{path}: not a parameter file of PX4 or of a Crazyflie: it contains neither {groups}")


class _Declaration(NamedTuple):
    """Declaration of a parameter of a firmware.

    Attributes:
        default: default value.
        min: smallest value.
        max: largest value.
        unit: phrase on the unit for the message about a value that is out of range; empty if no unit is likely.
    """

    default: float
    min: float = 0.0
    max: float = math.inf
    unit: str = ""

    def flaw(self, value: float) -> str:
        """Return the demand that a value does not meet, which follows "must"; empty if it meets all."""
        if self.min <= value <= self.max and math.isfinite(value):
            return ""
        demand = "be finite and not negative" if not self.unit else f"be between {self.min:g} and {self.max:g}"
        return f"{demand}, since it is {self.unit}" if self.unit else demand


@functools.cache
def _declared(firmware: str) -> dict[str, _Declaration]:
    text = files(__package__).joinpath(f"{firmware}.yaml").read_text(encoding="utf-8")
    return {
        name: _Declaration(**value) if isinstance(value, dict) else _Declaration(float(value))
        for name, value in YAML(typ="safe").load(text).items()
    }


def _in_text(path: Path, data: bytes) -> dict[str, float]:
    """Return the numbers in a YAML file of cflib, or in lines of text, by name."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: neither a text file nor a ULog") from None
    if "persistent_param_state" in text:
        return _in_client_file(path, text)
    pairs = (match.groups() for line in text.splitlines() if (match := _NAME_AND_NUMBER.search(line.partition("#")[0])))
    return {name: number for name, written in pairs if (number := _number(written)) is not None}


def _in_client_file(path: Path, text: str) -> dict[str, float]:
    try:
        tree: Any = YAML(typ="safe").load(text)
    except YAMLError as error:
        raise InputError(f"{path}: not a YAML file: {str(error).splitlines()[0]}") from None
    states = tree.get("params") if isinstance(tree, dict) else None
    if not isinstance(states, dict):
        raise InputError(f"{path}: `params` is missing; a parameter file of the Crazyflie's client contains it")
    values = {}
    for name, state in states.items():
        if isinstance(state, dict):
            state = state.get("stored_value" if state.get("is_stored") else "default_value")
        number = _number(str(state))
        if number is None:
            raise InputError(f"{path}: params.{name} is {state!r}; it must be a number")
        values[str(name)] = number
    return values


def _number(written: str) -> float | None:
    try:
        return float(written)
    except ValueError:
        return None
