"""Parameter files of flight controllers, in the formats that PX4 and Crazyflie tools write."""

import functools
import math
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Literal, NamedTuple

from drake_quad.errors import InputError
from drake_quad.logs.formats.ulog import MAGIC, ulog_parameters
from drake_quad.logs.source import read_file
from drake_quad.scenario.files.documents import parse_document

Firmware = Literal["crazyflie", "px4"]

# A line contains a name and a number, which are separated by white space, a comma, a colon or an equals sign. In a file
# of QGroundControl, other columns precede the name.
_NAME_AND_NUMBER = re.compile(r"(?:^|[\s,])([A-Za-z]\w*(?:\.\w+)?)[\s:=,]+([-+]?(?:\.?\d|nan|inf)[^\s,]*)")
_PARAMETER_GROUPS = {"crazyflie": "posCtlPid, velCtlPid, pid_attitude and pid_rate", "px4": "MPC_* and MC_*"}


class FirmwareParameters(NamedTuple):
    """Controller parameters of a vehicle, read from its firmware.

    Attributes:
        firmware: firmware of the vehicle.
        values: values of all controller parameters, by name.
        missing: names of the parameters that the file does not contain; their values are the firmware's defaults.
    """

    firmware: Firmware
    values: Mapping[str, float]
    missing: tuple[str, ...]


def default_parameters(firmware: Firmware) -> FirmwareParameters:
    """Return the default parameters of a firmware."""
    return FirmwareParameters(firmware, {name: each.default for name, each in _declared(firmware).items()}, ())


def read_parameters(path: Path) -> FirmwareParameters:
    """Read a vehicle's controller parameters from a file.

    PX4 parameters are in a ULog or a parameter file of QGroundControl. Crazyflie parameters are in a YAML file of its
    client or of cflib. Both may also be in a text file whose lines contain a name and a number.

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
            return FirmwareParameters(firmware, {**default_parameters(firmware).values, **specified_values}, missing)
    groups = " nor ".join(_PARAMETER_GROUPS.values())
    raise InputError(f"{path}: not a parameter file of PX4 or of a Crazyflie: it contains neither {groups}")


class _Declaration(NamedTuple):
    """Declaration of a firmware parameter.

    Attributes:
        default: default value.
        min: smallest value.
        max: largest value.
        unit: description of the unit, for the message about a value that is out of range; may be empty.
    """

    default: float
    min: float = 0.0
    max: float = math.inf
    unit: str = ""

    def flaw(self, value: float) -> str:
        """Return the condition that a value violates, as a phrase that follows "must"; empty if the value is valid."""
        if self.min <= value <= self.max and math.isfinite(value):
            return ""
        demand = "be finite and not negative" if not self.unit else f"be between {self.min:g} and {self.max:g}"
        return f"{demand}, since it is {self.unit}" if self.unit else demand


@functools.cache
def _declared(firmware: str) -> dict[str, _Declaration]:
    text = files(__package__).joinpath(f"{firmware}.yaml").read_text(encoding="utf-8")
    return {
        name: _Declaration(**value) if isinstance(value, dict) else _Declaration(float(value))
        for name, value in parse_document(text, firmware).tree.to_python().items()
    }


def _in_text(path: Path, data: bytes) -> dict[str, float]:
    """Return the parameters in a YAML file of cflib or in lines of text, by name."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: neither a text file nor a ULog") from None
    if "persistent_param_state" in text:
        return _in_client_file(path, text)
    pairs = (match.groups() for line in text.splitlines() if (match := _NAME_AND_NUMBER.search(line.partition("#")[0])))
    return {name: number for name, written in pairs if (number := _number(written)) is not None}


def _in_client_file(path: Path, text: str) -> dict[str, float]:
    tree = parse_document(text, str(path)).tree.to_python()
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
