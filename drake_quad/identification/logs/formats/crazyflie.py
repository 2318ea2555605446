"""The log that a Crazyflie writes to its SD card.

One after the other it has:

    byte 0xBC, version (uint16), number of event types (uint16)
    for each type: id (uint16), name, number of variables (uint16), each variable as name(t)
    records: id (uint16), time (version 1: uint32, ms; version 2: uint64, µs), the variables, packed
    CRC-32 of all before it (uint32)

All is little-endian, names end in a zero, and t is the letter of the type in Python's `struct`. The format is that of
`tools/usdlog/cfusdlog.py` in github.com/bitcraze/crazyflie-firmware.
"""

import zlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, shown
from drake_quad.identification.logs.conversion import Table
from drake_quad.identification.logs.formats.log_format import FORMATS, LogContent, LogFormat, NamedMapping
from drake_quad.identification.logs.mapping import load_mapping
from drake_quad.identification.logs.source import LogFile

_FIRST_BYTE = 0xBC
_TYPES = {letter: f"<{letter}" for letter in "bBhHiIqQefd"}
# Of the time: type and seconds per unit, by version.
_CLOCKS = {1: ("<u4", 1e-3), 2: ("<u8", 1e-6)}
_CHECKSUM = 4
# Of a name with its zero: longer than any of the firmware.
_LONGEST_NAME = 256
# Of all event types: a head of so many is none.
_MOST_VARIABLES = 5_000
# The compressed attitude, see `_unpacked`.
_PACKED = "stateEstimateZ.quat"


class _Kind(NamedTuple):
    """An event type.

    Attributes:
        name: of it.
        variables: their names.
        layout: of a record.
    """

    name: str
    variables: tuple[str, ...]
    layout: np.dtype


class _Header:
    """Reads the head of a log from its first byte on."""

    def __init__(self, log: LogFile) -> None:
        self._log, self.place = log, 1

    def number(self) -> int:
        """The next uint16."""
        self.place += 2
        if self.place > len(self._log.data):
            raise self.cut()
        return int.from_bytes(self._log.data[self.place - 2 : self.place], "little")

    def text(self) -> str:
        """The next text that ends in a zero."""
        end = self._log.data.find(b"\0", self.place, self.place + _LONGEST_NAME)
        if end < 0:
            if self.place + _LONGEST_NAME > len(self._log.data):
                raise self.cut()
            raise InputError(f"{self._log.mark}: is no log of a Crazyflie, or damaged: a name in its head has no end")
        text, self.place = self._log.data[self.place : end], end + 1
        try:
            return text.decode("ascii")
        except UnicodeDecodeError:
            raise InputError(
                f"{self._log.mark}: is no log of a Crazyflie, or damaged: {shown(text)} in its head is no name"
            ) from None

    def cut(self) -> InputError:
        """The error of a log that ends here."""
        return InputError(f"{self._log.mark}: is cut: the head of a Crazyflie's log is not whole")


def _read(log: LogFile, given: NamedMapping | None) -> LogContent:
    """Read the variables of each event type.

    Variables whose names have no dot are those of the event itself and have its name before them.

    Raises:
        InputError: if the log has another version, its head is damaged, or none of its records is whole.
    """
    header = _Header(log)
    version = header.number()
    if version not in _CLOCKS:
        raise InputError(f"{log.mark}: is a Crazyflie's log of version {version}; versions 1 and 2 can be read")
    clock, unit = _CLOCKS[version]
    kinds: dict[int, _Kind] = {}
    for _ in range(header.number()):
        identity, name = header.number(), header.text()
        if identity in kinds:
            raise InputError(f"{log.mark}: is damaged: two event types of its head have the id {identity}")
        kinds[identity] = _kind(header, log, name, clock)
        if sum(1 + len(kind.variables) for kind in kinds.values()) > _MOST_VARIABLES:
            raise InputError(
                f"{log.mark}: is damaged, or no log of a Crazyflie: its head has over {_MOST_VARIABLES:,} variables"
            )
    if not kinds:
        raise InputError(f"{log.mark}: is a Crazyflie's log without event types")
    places, remarks = _places(log, header.place, kinds)
    tables = [_table(log, kind, places[identity], unit) for identity, kind in kinds.items() if places[identity]]
    if not tables:
        raise InputError(
            f"{log.mark}: holds no whole record of {' or '.join(kind.name for kind in kinds.values())}"
            + "".join(f"; {remark}" for remark in remarks)
        )
    return LogContent(tables, given or load_mapping("crazyflie"), remarks)


def _kind(header: _Header, log: LogFile, name: str, clock: str) -> _Kind:
    """Reads the variables of an event type."""
    variables, formats = [], ["<u2", clock]
    for _ in range(min(header.number(), _MOST_VARIABLES + 1)):
        variable, bracket, letter = header.text().removesuffix(")").rpartition("(")
        if not bracket or letter not in _TYPES:
            raise InputError(
                f"{log.mark}: the variable {shown(variable or letter)} of its head has a type {shown(letter)} that is"
                f" not known; known are {' '.join(_TYPES)}"
            )
        variables.append(variable if "." in variable else f"{name}.{variable}")
        formats.append(_TYPES[letter])
    fields = ["id", "time", *(str(number) for number in range(len(variables)))]
    return _Kind(name, tuple(variables), np.dtype({"names": fields, "formats": formats}))


def _places(log: LogFile, start: int, kinds: dict[int, _Kind]) -> tuple[dict[int, list[int]], list[str]]:
    """Return the offsets of the records of each event type, by its id, and remarks on lost data."""
    data, sizes = log.data, {identity: kind.layout.itemsize for identity, kind in kinds.items()}
    if int.from_bytes(data[-_CHECKSUM:], "little") == zlib.crc32(memoryview(data)[:-_CHECKSUM]):
        bounds = _bounds(memoryview(data)[:-_CHECKSUM], start, sizes)
        remarks = _unread(log, bounds[-1], sizes) if bounds[-1] < len(data) - _CHECKSUM else []
    else:
        bounds = _bounds(memoryview(data), start, sizes)
        count = _count_before_checksum(data, bounds)
        if count is None:
            remarks = ["the checksum is wrong: the log is cut or damaged", *_cut(log, bounds, sizes)]
        else:
            del bounds[count + 1 :]
            remarks = [log.unread(bounds[-1] + _CHECKSUM, "they follow the checksum at the end of the log")]
    places: dict[int, list[int]] = {identity: [] for identity in kinds}
    for place in bounds[:-1]:
        places[data[place] | data[place + 1] << 8].append(place)
    return places, [*log.remarks, *remarks]


def _bounds(data: memoryview, start: int, sizes: Mapping[int, int]) -> list[int]:
    """Return the offsets of the records from an offset on, and the end of the last one.

    Records are read up to the first one that is incomplete, or whose id is unknown.
    """
    bounds, place = [start], start
    while place <= len(data) - 2:
        size = sizes.get(data[place] | data[place + 1] << 8)
        if size is None or place + size > len(data):
            break
        place += size
        bounds.append(place)
    return bounds


def _count_before_checksum(data: bytes, bounds: Sequence[int]) -> int | None:
    """Return the number of records before the first valid checksum of all preceding data; None if there is none."""
    checksum, end, view = 0, 0, memoryview(data)
    for count, place in enumerate(bounds):
        checksum = zlib.crc32(view[end:place], checksum)
        end = place
        if data[place : place + _CHECKSUM] == checksum.to_bytes(_CHECKSUM, "little"):
            return count
    return None


def _cut(log: LogFile, bounds: list[int], sizes: Mapping[int, int]) -> list[str]:
    """Remove the records of a cut log that reach into its trailing zeros or 0xff, and return remarks on unread data."""
    if bounds[-1] < len(log.data) or (len(bounds) > 1 and log.written <= bounds[-2]):
        while len(bounds) > 1 and bounds[-1] > log.written:
            bounds.pop()
    # A log that is damaged only earlier still ends with its checksum, so all its bytes are read.
    return _unread(log, bounds[-1], sizes) if len(log.data) - bounds[-1] not in (0, _CHECKSUM) else []


def _unread(log: LogFile, end: int, sizes: Mapping[int, int]) -> list[str]:
    """Return a remark on the bytes after the last complete record."""
    identity = int.from_bytes(log.data[end : end + 2], "little")
    is_known = identity in sizes or len(log.data) - end <= _CHECKSUM
    return [log.unread(end, "no whole record" if is_known else f"{identity} is the id of no event type")]


def _table(log: LogFile, kind: _Kind, places: list[int], unit: float) -> Table:
    records = log.records(kind.layout, places)
    columns = {name: records[str(i)] for i, name in enumerate(kind.variables)}
    if _PACKED in columns:
        columns |= _unpacked(columns.pop(_PACKED).astype(np.uint32))
    return Table("" if kind.name == "fixedFrequency" else kind.name, records["time"] * unit, columns)


def _unpacked(packed: np.ndarray) -> dict[str, np.ndarray]:
    """Return the parts of quaternions of 32 bits, as `quatcompress.h` of the firmware packs them.

    The two highest bits are the number of the largest part (x, y, z, w), which is positive. The other parts follow,
    each with a sign and nine bits of its ratio to 1/√2.
    """
    largest = packed >> 30
    parts = np.zeros((len(packed), 4))
    rest = packed.copy()
    for i in (3, 2, 1, 0):
        here = largest != i
        magnitude = (rest & 0x1FF) / 0x1FF * np.sqrt(0.5)
        parts[here, i] = np.where(rest & 0x200, -magnitude, magnitude)[here]
        rest = np.where(here, rest >> 10, rest)
    square = np.maximum(0.0, 1.0 - (parts**2).sum(axis=1))
    parts[np.arange(len(packed)), largest] = np.sqrt(square)
    return {f"{_PACKED}.{axis}": column for axis, column in zip("xyzw", parts.T, strict=True)}


FORMATS.append(LogFormat("a Crazyflie's SD card log", lambda log: log.data[:1] == bytes([_FIRST_BYTE]), _read))
