"""Reader of MATLAB's MAT-files, based on SciPy.

The columns of the log are the numeric variables and the fields of structs that have as many samples as the time column.
Names of fields have the form `log.position`. A matrix with one column (or one row) per component counts as a column of
vectors, which `column` in a mapping reads. The names of its components have the form `log.position[0]`.
"""

import io
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from drake_quad.errors import InputError
from drake_quad.logs.conversion import Table
from drake_quad.logs.formats.log_format import (
    FORMATS,
    LogContent,
    LogFormat,
    NamedMapping,
    best_mapping,
)
from drake_quad.logs.source import LogFile
from drake_quad.logs.units import UNITS

_MAGIC = b"MATLAB "
_HDF5_VERSION = b"MATLAB 7.3"
_MAX_DEPTH = 8  # deepest nesting of structs that are read
_MAX_COMPONENTS = 16  # larger matrices have no names for their components


def _read(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read the variables that have as many samples as the time column of the mapping.

    Raises:
        InputError: if the file is damaged or has version 7.3, or no mapping fits.
    """
    if log.data.startswith(_HDF5_VERSION):
        raise InputError(f"{log.mark}: is a MAT-file of version 7.3 (HDF5); save it in MATLAB with the option -v7")
    from scipy.io import loadmat  # imported here because the import takes a tenth of a second

    options = {"simplify_cells": True, "chars_as_strings": True}
    content = log.read_by_library("a MAT-file", lambda: loadmat(io.BytesIO(log.data), **options))
    variables = dict(_numeric("", content, 0))
    lengths = {length for values in variables.values() for length in values.shape}
    names = [*variables]
    for name, values in variables.items():
        if values.ndim == 2:
            names += [f"{name}[{i}]" for i in range(min(values.shape)) if min(values.shape) <= _MAX_COMPONENTS]
    (name, mapping), _ = best_mapping(log, user_mapping, lambda _: names)
    assert mapping.time is not None
    time = variables.get(mapping.time.column)
    if time is None or time.ndim != 1 or not lengths:
        raise InputError(f"{log.mark}: {mapping.time.column} must be a vector of times")
    columns: dict[str, np.ndarray] = {}
    remarks = []
    for each, values in variables.items():
        rows = values if values.shape[0] == len(time) else values.T
        if rows.shape[0] != len(time):
            remarks.append(f"{each} is not read: its length differs from the length of {mapping.time.column}")
            continue
        components = {f"{each}[{i}]": column for i, column in enumerate(rows.T)} if rows.ndim == 2 else {}
        is_split = bool(components.keys() & mapping.names)
        if is_split:
            columns |= components
        if each in mapping.names or not is_split:
            columns[each] = rows
    del columns[mapping.time.column]
    scale = UNITS["s"][mapping.time.unit].scale
    return LogContent([Table("", time.astype(float) * scale, columns)], (name, mapping), remarks)


def _numeric(prefix: str, content: Mapping[str, Any], depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the numeric vectors and matrices in a struct and its nested structs, by name."""
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping) and depth < _MAX_DEPTH:
            yield from _numeric(f"{prefix}{name}.", value, depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim in (1, 2) and value.size > 1:
            yield f"{prefix}{name}", value


FORMATS.append(LogFormat("MATLAB's MAT-file", lambda log: log.data.startswith(_MAGIC), _read))
