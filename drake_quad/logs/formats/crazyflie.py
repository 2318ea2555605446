"""Reader of the log that a Crazyflie writes to its SD card.

The file contains in this order:

    byte 0xBC, version (uint16), number of event types (uint16)
    for each type: id (uint16), name, number of variables (uint16), each variable as name(t)
    records: id (uint16), time (version 1: uint32, ms; version 2: uint64, µs), the variables, packed
    CRC-32 of all preceding bytes (uint32)

All numbers are little-endian, names end with a zero byte, and t is the letter of the type in Python's `struct`. The
format is that of `tools/usdlog/cfusdlog.py` in github.com/bitcraze/crazyflie-firmware.
"""

import zlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.logs.conversion import Table
from drake_quad.logs.formats.log_format import FORMATS, LogContent, LogFormat, NamedMapping
from drake_quad.logs.mapping import load_mapping
from drake_quad.logs.source import LogFile

_FIRST_BYTE = 0xBC  # first byte of every log
_TYPES = {letter: f"<{letter}" for letter in "bBhHiIqQefd"}
# Type of the time, and unit of the time in s, by the version of the format.
_CLOCKS = {1: ("<u4", 1e-3), 2: ("<u8", 1e-6)}
_CHECKSUM_SIZE = 4  # bytes
# Largest length of a name with its final zero. The names in the firmware are shorter.
_MAX_NAME_LENGTH = 256
# Largest number of variables in a header, summed over all event types. A header with more variables is damaged.
_MAX_VARIABLES = 5_000
# Name of the compressed attitude, which `_quaternions` decodes.
_PACKED_ATTITUDE = "stateEstimateZ.quat"


class _EventType(NamedTuple):
    """Event type.

    Attributes:
        name: name of the event type.
        variables: names of its variables.
        layout: layout of a record.
    """

    name: str
    variables: tuple[str, ...]
    layout: np.dtype


class _Header:
    """Reader of the header of a Crazyflie's log."""

    def __init__(self, log: LogFile) -> None:
        self._log, self.offset = log, 1

    def number(self) -> int:
        """Read a 16-bit unsigned integer from the header."""
        self.offset += 2
        if self.offset > len(self._log.data):
            raise self.truncated()
        return int.from_bytes(self._log.data[self.offset - 2 : self.offset], "little")

    def text(self) -> str:
        """Read a null-terminated string from the header."""
        end = self._log.data.find(b"\0", self.offset, self.offset + _MAX_NAME_LENGTH)
        if end < 0:
            if self.offset + _MAX_NAME_LENGTH > len(self._log.data):
                raise self.truncated()
            raise InputError(f"{self._log.mark}: is not a Crazyflie log, or damaged: a name in its header has no end")
        text, self.offset = self._log.data[self.offset : end], end + 1
        try:
            return text.decode("ascii")
        except UnicodeDecodeError:
            raise InputError(
                f"{self._log.mark}: is not a Crazyflie log, or damaged: {short_repr(text)} in its header is not a name"
            ) from None

    def truncated(self) -> InputError:
        """Return the error for a log that ends within its header."""
        return InputError(f"{self._log.mark}: is truncated: the header of a Crazyflie log is incomplete")


def _read(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read the variables of each event type.

    A variable whose name contains no dot belongs to the event itself, and gets the name of the event as a prefix.

    Raises:
        InputError: if the log has another version, its header is damaged, or it contains no complete record.
    """
    header = _Header(log)
    version = header.number()
    if version not in _CLOCKS:
        raise InputError(f"{log.mark}: is a Crazyflie log of version {version}; versions 1 and 2 can be read")
    clock, unit = _CLOCKS[version]
    event_types: dict[int, _EventType] = {}
    for _ in range(header.number()):
        number, name = header.number(), header.text()
        if number in event_types:
            raise InputError(f"{log.mark}: is damaged: two event types in its header have the id {number}")
        event_types[number] = _event_type(header, log, name, clock)
        if sum(1 + len(event_type.variables) for event_type in event_types.values()) > _MAX_VARIABLES:
            raise InputError(
                f"{log.mark}: is not a Crazyflie log, or damaged: its header has over {_MAX_VARIABLES:,} variables"
            )
    if not event_types:
        raise InputError(f"{log.mark}: is a Crazyflie log without event types")
    offsets, remarks = _record_offsets(log, header.offset, event_types)
    tables = [
        _table(log, event_type, offsets[number], unit) for number, event_type in event_types.items() if offsets[number]
    ]
    if not tables:
        raise InputError(
            f"{log.mark}: contains no complete record of {' or '.join(each.name for each in event_types.values())}"
            + "".join(f"; {remark}" for remark in remarks)
        )
    return LogContent(tables, user_mapping or load_mapping("crazyflie"), remarks)


def _event_type(header: _Header, log: LogFile, name: str, clock: str) -> _EventType:
    """Read the variables of an event type."""
    variables, formats = [], ["<u2", clock]
    for _ in range(min(header.number(), _MAX_VARIABLES + 1)):
        variable, bracket, letter = header.text().removesuffix(")").rpartition("(")
        if not bracket or letter not in _TYPES:
            raise InputError(
                f"{log.mark}: the variable {short_repr(variable or letter)} in its header has the unknown type"
                f" {short_repr(letter)}; known types are {' '.join(_TYPES)}"
            )
        variables.append(variable if "." in variable else f"{name}.{variable}")
        formats.append(_TYPES[letter])
    fields = ["id", "time", *(str(number) for number in range(len(variables)))]
    return _EventType(name, tuple(variables), np.dtype({"names": fields, "formats": formats}))


def _record_offsets(
    log: LogFile, start: int, event_types: dict[int, _EventType]
) -> tuple[dict[int, list[int]], list[str]]:
    """Return the offsets of the records of each event type, by its id, and remarks on lost data."""
    data, sizes = log.data, {number: event_type.layout.itemsize for number, event_type in event_types.items()}
    if int.from_bytes(data[-_CHECKSUM_SIZE:], "little") == zlib.crc32(memoryview(data)[:-_CHECKSUM_SIZE]):
        bounds = _bounds(memoryview(data)[:-_CHECKSUM_SIZE], start, sizes)
        remarks = _unread_remarks(log, bounds[-1], sizes) if bounds[-1] < len(data) - _CHECKSUM_SIZE else []
    else:
        bounds = _bounds(memoryview(data), start, sizes)
        count = _count_before_checksum(data, bounds)
        if count is None:
            remarks = ["the checksum is wrong: the log is truncated or damaged", *_truncated(log, bounds, sizes)]
        else:
            del bounds[count + 1 :]
            remarks = [log.unread_remark(bounds[-1] + _CHECKSUM_SIZE, "they follow the checksum that ends the log")]
    offsets: dict[int, list[int]] = {number: [] for number in event_types}
    for offset in bounds[:-1]:
        offsets[data[offset] | data[offset + 1] << 8].append(offset)
    return offsets, remarks


def _bounds(data: memoryview, start: int, sizes: Mapping[int, int]) -> list[int]:
    """Return the offsets of the records from a start offset on, and the end of the last record.

    The search ends at the first record that is incomplete, or whose id is unknown.
    """
    bounds, offset = [start], start
    while offset <= len(data) - 2:
        size = sizes.get(data[offset] | data[offset + 1] << 8)
        if size is None or offset + size > len(data):
            break
        offset += size
        bounds.append(offset)
    return bounds


def _count_before_checksum(data: bytes, bounds: Sequence[int]) -> int | None:
    """Return the number of records before the checksum of the log; None if there is no valid checksum."""
    checksum, end, view = 0, 0, memoryview(data)
    for count, offset in enumerate(bounds):
        checksum = zlib.crc32(view[end:offset], checksum)
        end = offset
        if data[offset : offset + _CHECKSUM_SIZE] == checksum.to_bytes(_CHECKSUM_SIZE, "little"):
            return count
    return None


def _truncated(log: LogFile, bounds: list[int], sizes: Mapping[int, int]) -> list[str]:
    """Remove the last records of a truncated log if they may lack data, and return remarks on the unread data.

    A record may lack data if it extends into the trailing bytes 0 or 0xff of the file.
    """
    if bounds[-1] < len(log.data) or (len(bounds) > 1 and log.written_size <= bounds[-2]):
        while len(bounds) > 1 and bounds[-1] > log.written_size:
            bounds.pop()
    # If nothing or only the checksum follows the last record, all records have been read, even if the log is damaged.
    return _unread_remarks(log, bounds[-1], sizes) if len(log.data) - bounds[-1] not in (0, _CHECKSUM_SIZE) else []


def _unread_remarks(log: LogFile, end: int, sizes: Mapping[int, int]) -> list[str]:
    """Return a remark on the bytes after the last complete record."""
    number = int.from_bytes(log.data[end : end + 2], "little")
    is_known = number in sizes or len(log.data) - end <= _CHECKSUM_SIZE
    return [log.unread_remark(end, "no complete record" if is_known else f"no event type has the id {number}")]


def _table(log: LogFile, event_type: _EventType, offsets: list[int], unit: float) -> Table:
    records = log.records(event_type.layout, offsets)
    columns = {name: records[str(i)] for i, name in enumerate(event_type.variables)}
    if _PACKED_ATTITUDE in columns:
        columns |= _quaternions(columns.pop(_PACKED_ATTITUDE).astype(np.uint32))
    return Table("" if event_type.name == "fixedFrequency" else event_type.name, records["time"] * unit, columns)


def _quaternions(packed: np.ndarray) -> dict[str, np.ndarray]:
    """Return the components of quaternions that `quatcompress.h` of the firmware has compressed to 32 bits.

    The two highest bits are the index (0 to 3: x, y, z, w) of the largest component, which is positive. The other
    components follow, each as a sign and nine bits for its ratio to 1/√2.
    """
    largest = packed >> 30
    components = np.zeros((len(packed), 4))
    rest = packed.copy()
    for i in (3, 2, 1, 0):
        is_smaller = largest != i
        magnitude = (rest & 0x1FF) / 0x1FF * np.sqrt(0.5)
        components[is_smaller, i] = np.where(rest & 0x200, -magnitude, magnitude)[is_smaller]
        rest = np.where(is_smaller, rest >> 10, rest)
    square = np.maximum(0.0, 1.0 - (components**2).sum(axis=1))
    components[np.arange(len(packed)), largest] = np.sqrt(square)
    return {f"{_PACKED_ATTITUDE}.{axis}": column for axis, column in zip("xyzw", components.T, strict=True)}


FORMATS.append(LogFormat("a Crazyflie's SD card log", lambda log: log.data[:1] == bytes([_FIRST_BYTE]), _read))
