"""Description of exported code, which is stored in the same folder as the code."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.errors import InputError

DESCRIPTION_FILE = "export.json"
"""Name of the file that describes exported code."""
_NUMBER_TYPES = {"double": np.float64, "single": np.float32}


@dataclass(frozen=True, kw_only=True)
class CodeInterface:
    """Interface and size of exported code.

    Attributes:
        period: time between two steps, s.
        output_divisor: number of steps between two steps that write outputs.
        inputs: number of components of each input.
        outputs: number of components of each output.
        num_states: number of components of the state.
        num_parameters: number of components of the parameters.
        num_operations: largest number of arithmetic operations and calls of `math.h` in a step.
    """

    period: float
    output_divisor: int
    inputs: dict[str, int]
    outputs: dict[str, int]
    num_states: int
    num_parameters: int
    num_operations: int


@dataclass(frozen=True, kw_only=True)
class ExportDescription(CodeInterface):
    """Description of exported code.

    Attributes:
        name: name of the files, and prefix of the names in C.
        precision: "double" or "single".
        scenario: name of the scenario.
        scenario_sha256: digest of the scenario's file.
        version: version of drake_quad.
    """

    name: str
    precision: str
    scenario: str
    scenario_sha256: str
    version: str

    @property
    def number_type(self) -> Any:
        """NumPy type of a number in the exported code."""
        return _NUMBER_TYPES[self.precision]

    @property
    def state_type(self) -> np.dtype:
        """NumPy type of the C struct with the state of the exported code."""
        fields = [("numbers", self.number_type, (self.num_states,)), ("step", np.uint32)]
        return np.dtype(fields if self.num_states else fields[1:], align=True)


def read_description(folder: Path) -> ExportDescription:
    """Return the description of the exported code in a folder.

    Raises:
        InputError: if the folder contains no exported code, or its description is damaged.
    """
    file = folder / DESCRIPTION_FILE
    try:
        fields = json.loads(file.read_text(encoding="utf-8"))
        description = ExportDescription(**fields)
        valid = description.precision in _NUMBER_TYPES and description.name.isidentifier() and description.period > 0.0
    except (OSError, ValueError) as error:
        raise InputError(f"{folder} contains no exported controller: {error}") from None
    except TypeError:
        valid = False
    if not valid:
        raise InputError(f"{file} is damaged, or was written by another version of drake_quad; export again")
    return description
