"""Reader of ArduPilot's DataFlash log, based on pymavlink (ardupilot.org, "Log messages")."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from drake_quad.errors import InputError
from drake_quad.logs.conversion import Table
from drake_quad.logs.formats.log_format import (
    FORMATS,
    LogContent,
    LogFormat,
    NamedMapping,
    other_vehicle_remarks,
)
from drake_quad.logs.mapping import load_mapping
from drake_quad.logs.source import LogFile
from drake_quad.process_settings import without_error_output, without_prints

# First bytes of a log: the header of a message of type 128, which declares the format of other messages.
_MAGIC = b"\xa3\x95\x80"
_HEADER_SIZE = 3  # bytes
# Names of time fields, with their unit in s.
_CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}
# NumPy types for the type letters of ArduPilot that differ from NumPy's letters. The multipliers in `_SCALED_TYPES` are
# from ArduPilot's documentation.
_TYPES = {"a": "V64", "n": "S4", "N": "S16", "Z": "S64", "M": "u1", "g": "<f2", "B": "u1", "b": "i1"}
_SCALED_TYPES = {"c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7)}
# Names of fields that tell which sensor or estimator wrote a message.
_INSTANCE_FIELDS = ("I", "C")
_QUADROTOR = 1  # value of FRAME_CLASS
_X_LAYOUT = 1  # value of FRAME_TYPE
# Vehicles that are not quadrotors, by value of FRAME_CLASS.
_OTHER_FRAMES = {
    2: "a hexarotor",
    3: "an octorotor",
    4: "an octorotor",
    5: "a hexarotor with coaxial rotors",
    6: "a helicopter",
    7: "a tricopter",
    8: "a vehicle with one rotor",
    9: "a vehicle with coaxial rotors",
    10: "a vehicle on two rotors",
    11: "a helicopter",
    12: "a dodecarotor",
    13: "a helicopter",
    14: "a decarotor",
}


def _read(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read the messages that a mapping uses. Only the first instance of each sensor is read.

    Field names have the form `ATT.Roll`. Values are multiplied by the multiplier of their type.

    Raises:
        InputError: if pymavlink is not installed or cannot read the log, or the logged vehicle is not a quadrotor.
    """
    reader_module = log.library("pymavlink.DFReader", "ardupilot")

    def formats_and_offsets() -> tuple[dict[str, Any], dict[str, list[int]]]:
        """Return the formats and the offsets of all messages, by their names."""

        def opened(path: Any) -> Any:
            # pymavlink leaves the file open if its constructor fails.
            reader = object.__new__(reader_module.DFReader_binary)
            try:
                with without_prints(), without_error_output():
                    reader.__init__(str(path))
                return reader.formats, reader.offsets
            finally:
                if hasattr(reader, "filehandle"):
                    reader.filehandle.close()

        formats, offsets = log.read_from_disk(".bin", opened)
        return {each.name: each for each in formats.values()}, {
            each.name: offsets[number] for number, each in formats.items()
        }

    formats, offsets = log.read_by_library("an ArduPilot log", formats_and_offsets)
    name, mapping = user_mapping or load_mapping("ardupilot")
    parameters = _parameters(log, formats, offsets)
    frame = int(parameters.get("FRAME_CLASS", _QUADROTOR))
    remarks = other_vehicle_remarks(log, _OTHER_FRAMES.get(frame, ""), user_mapping)
    if int(parameters.get("FRAME_TYPE", parameters.get("FRAME", _X_LAYOUT))) != _X_LAYOUT:
        remarks.append("the rotors are numbered as in an x layout, but FRAME_TYPE states another layout")
    mapped = {each.partition(".")[0] for each in mapping.names}
    tables = [
        table
        for each in sorted(mapped.intersection(formats))
        if (table := _table(log, formats[each], offsets[each])) is not None
    ]
    if not tables:
        raise InputError(f"{log.mark}: is an ArduPilot log without any of the messages {', '.join(sorted(mapped))}")
    names = [each for each in formats if offsets[each] and each not in mapped]
    return LogContent(tables, (name, mapping), remarks, names)


def _records(log: LogFile, message_format: Any, offsets: Iterable[int]) -> dict[str, np.ndarray] | None:
    """Return the complete messages of a type by field; None if there are none, or if the type is declared wrongly."""
    letters = message_format.format.rstrip("\0")
    if len(letters) != len(message_format.columns) or len({*message_format.columns}) != len(letters):
        return None
    layout = np.dtype(
        [
            (column, _SCALED_TYPES[letter][0] if letter in _SCALED_TYPES else _TYPES.get(letter, f"<{letter}"))
            for column, letter in zip(message_format.columns, letters, strict=True)
        ]
    )
    starts = np.asarray(offsets, dtype=int) + _HEADER_SIZE
    starts = starts[starts + layout.itemsize <= len(log.data)]
    if layout.itemsize != message_format.len - _HEADER_SIZE or not len(starts):
        return None
    records = log.records(layout, starts)
    return {
        column: records[column] * _SCALED_TYPES[letter][1] if letter in _SCALED_TYPES else records[column]
        for column, letter in zip(message_format.columns, letters, strict=True)
    }


def _parameters(log: LogFile, formats: dict[str, Any], offsets: dict[str, list[int]]) -> dict[str, float]:
    """Return the autopilot's parameters in an ArduPilot log, keyed by name."""
    records = _records(log, formats["PARM"], offsets["PARM"]) if "PARM" in formats else None
    if records is None or not {"Name", "Value"} <= records.keys():
        return {}
    return {
        name.decode("ascii", "replace"): float(value)
        for name, value in zip(records["Name"].tolist(), records["Value"].tolist(), strict=True)
        if np.isfinite(value)
    }


def _table(log: LogFile, message_format: Any, offsets: Iterable[int]) -> Table | None:
    """Return the messages of a type, from the first sensor or estimator only; None if they have no time."""
    records = _records(log, message_format, offsets)
    clock = next((each for each in _CLOCKS if records is not None and each in records), None)
    if records is None or clock is None:
        return None
    instance = next(
        (records[each] for each in _INSTANCE_FIELDS if each in records and records[each].dtype.kind in "iu"), None
    )
    is_first = slice(None) if instance is None else instance == instance.min()
    columns = {
        f"{message_format.name}.{column}": values[is_first]
        for column, values in records.items()
        if values.dtype.kind in "iuf" and column != clock
    }
    return Table(message_format.name, records[clock][is_first] * _CLOCKS[clock], columns)


FORMATS.append(LogFormat("ArduPilot's DataFlash log", lambda log: log.data.startswith(_MAGIC), _read))
