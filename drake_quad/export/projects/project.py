"""Software projects, such as a flight-controller app, into which exported C code is written."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

from drake_quad.errors import InputError
from drake_quad.export.structs import Struct
from drake_quad.exported.description import ExportDescription
from drake_quad.framework.c_code import PRECISIONS
from drake_quad.vehicle.parameters import QuadrotorParameters

# Largest rounding error in the ratio of two periods, which must be a whole number.
_RATIO_TOLERANCE = 1e-9
# Inputs that describe the reference. A project sets those that its platform provides; the others are zero.
_REFERENCE_INPUTS = frozenset({"reference", "reference_jerk", "reference_snap"})
_MEASUREMENT_INPUTS = frozenset({"measurement", "state"})


class ExportedCode(NamedTuple):
    """Exported code, and what a project needs to know about it.

    Attributes:
        description: description of the exported code.
        header: text of the header.
        source: text of the source file.
        structs: definitions of the structs in the header.
        nominal: parameters of the nominal vehicle.
        has_reference: True if the code contains a function that evaluates the reference.
    """

    description: ExportDescription
    header: str
    source: str
    structs: Sequence[Struct]
    nominal: QuadrotorParameters
    has_reference: bool

    @property
    def measurement(self) -> str:
        """Name of the input for the measured state of the vehicle."""
        return "measurement" if "measurement" in self.description.inputs else "state"

    @property
    def number_type(self) -> str:
        """C type of a number in the exported code."""
        return PRECISIONS[self.description.precision].real

    @property
    def weight(self) -> float:
        """Weight of the nominal vehicle, N."""
        return float(self.nominal.mass * self.nominal.gravity)


class Project(NamedTuple):
    """Software project that contains exported code. Its template is the folder of the same name in `templates/`.

    Attributes:
        placeholders: function that returns the values of the template's placeholders. The template contains `@KEY@` in
            place of the value of KEY. The function raises an `InputError` if the code does not fit the project.
        code_folder: folder for the exported code, relative to the folder of the project.
    """

    placeholders: Callable[[ExportedCode], Mapping[str, str]]
    code_folder: str = "."


def check_command(project: str, description: ExportDescription, commands: Collection[str]) -> None:
    """Check that exported code computes exactly one of the commands that a project can send.

    Raises:
        InputError: if the code computes another command, or several.
    """
    if len(description.outputs) != 1 or not {*description.outputs} <= {*commands}:
        raise InputError(
            f"project {project} needs a controller that commands {' or '.join(commands)}, not"
            f" {' and '.join(description.outputs)}"
        )


def check_inputs(project: str, description: ExportDescription) -> None:
    """Check that exported code has no inputs other than the measured state and the reference.

    Raises:
        InputError: if the code has another input.
    """
    for name in description.inputs:
        if name not in _REFERENCE_INPUTS | _MEASUREMENT_INPUTS:
            raise InputError(f"project {project} cannot provide the input {name}")


def check_single_precision(project: str, description: ExportDescription) -> None:
    """Check that exported code has single precision, which the hardware of most microcontrollers supports.

    Raises:
        InputError: if the code has double precision.
    """
    if description.precision != "single":
        raise InputError(
            f"project {project} needs --precision single, since many microcontrollers support only single precision in"
            " hardware"
        )


def whole_steps(project: str, description: ExportDescription, period: float, label: str) -> int:
    """Return the control period of exported code as a number of shorter periods, such as milliseconds.

    Args:
        project: name of the project.
        description: description of the exported code.
        period: shorter period, s.
        label: name of the shorter period in the plural, such as "milliseconds".

    Raises:
        InputError: if the control period is not a multiple of the shorter period.
    """
    ratio = description.period / period
    if ratio < 0.5 or abs(ratio - round(ratio)) > _RATIO_TOLERANCE:
        raise InputError(
            f"project {project} needs a period that is a whole number of {label}, not {description.period:g} s"
        )
    return round(ratio)
