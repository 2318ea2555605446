"""Default output paths, which are reserved so that a command does not overwrite the results of another input.

The default path follows from the name of a scenario or log, and two inputs may have the same name. Therefore, a hidden
file in the output folder, or beside an output file, records the input for which the output was written.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from drake_quad.errors import InputError, shortest_path
from drake_quad.files import output_folder, write_text
from drake_quad.scenario.files.library import locate
from drake_quad.scenario.models import Mission

# Name of the hidden file that records the inputs in an output folder. For an output file, it is appended to the name of
# the file.
_RECORD_FILE_NAME = ".input"


class Origin(NamedTuple):
    """Input for which a command writes its default output.

    Attributes:
        source: absolute path of the file, followed by the name of the scenario if the file contains scenarios.
        content: digest of a scenario's nominal vehicle; empty if the input is not a scenario.
    """

    source: str
    content: str = ""

    @classmethod
    def of_scenario(cls, spec: str, scenario: Mission) -> "Origin":
        """Return the origin of an output whose input is a scenario.

        If the scenario file is itself in the default output folder of a command, `source` is the input of that command.

        Args:
            spec: FILE or FILE:NAME from which the scenario was loaded.
            scenario: scenario with all overrides.
        """
        path = locate(spec)[0].resolve()
        written_for = _read(path.parent / _RECORD_FILE_NAME)
        source = written_for[0].source if written_for else f"{path}:{scenario.name}"
        vehicle = scenario.nominal.model_dump_json().encode()
        return cls(source, hashlib.sha256(vehicle).hexdigest())

    @classmethod
    def of_file(cls, path: Path) -> "Origin":
        """Return the origin of an output whose input is a file without scenarios, such as a flight log."""
        return cls(str(path.resolve()))

    def differs(self, other: "Origin") -> bool:
        """Return True if two inputs have different sources and are not scenarios with the same nominal vehicle.

        A scenario therefore remains the same input if its vehicle is edited, or if it is moved to another file.
        """
        return self.source != other.source and (self.content != other.content or not self.content)


def reserve(path: Path, origins: Sequence[Origin], *, is_file: bool = False) -> Path:
    """Record the inputs for which a default output is written, and return the path of the output.

    Args:
        path: output folder or output file.
        origins: inputs of the command, always in the same order.
        is_file: True if the output is a file, False if it is a folder.

    Raises:
        InputError: if the output was written for other inputs, or cannot be written.
    """
    record = path.with_name(f".{path.name}{_RECORD_FILE_NAME}") if is_file else path / _RECORD_FILE_NAME
    output_folder(record.parent)
    for origin, recorded in zip(origins, _read(record), strict=False) if path.exists() else ():
        if origin.differs(recorded):
            source, recorded_source = (shortest_path(Path(each.source)) for each in (origin, recorded))
            raise InputError(f"{path} was written for {recorded_source}, not for {source}; choose another --output")
    write_text(record, "".join(f"{source}\t{content}\n" for source, content in origins))
    return path


def _read(record: Path) -> list[Origin]:
    """Return the recorded origins; an empty list if the record is missing or damaged."""
    try:
        lines = record.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return []
    return [Origin(*line.rsplit("\t", 1)) for line in lines if "\t" in line]
