"""Registry of the formats in which `drake-quad fly` writes a flight."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from drake_quad.flight.flight import Flight


class FlightFormat(NamedTuple):
    """Format of a file that contains a flight.

    Attributes:
        option: name of the option of `drake-quad fly`, without dashes.
        help: help text of the option.
        file_name: name of the file.
        write: function that writes a flight to a path, and returns the path.
        library: optional module that the format needs, and the extra that installs this module; None if the format
            needs no optional module.
    """

    option: str
    help: str
    file_name: str
    write: Callable[[Flight, Path], Path]
    library: tuple[str, str] | None = None


FORMATS: list[FlightFormat] = []
"""Registered formats. A format is a module in this folder that appends itself to the list."""
