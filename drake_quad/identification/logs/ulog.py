"""PX4's ULog, by pyulog (docs.px4.io, "ULog file format")."""

import collections.abc
import contextlib
import io
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError, shortened
from drake_quad.identification.logs.conversion import Table
from drake_quad.identification.logs.mapping import Mapping
from drake_quad.identification.logs.source import LogFile

MAGIC = b"ULog\x01\x12\x35"
_SECOND = 1e-6
# Front right, back right, back left, front left: whether a rotor is in front, and to the right.
_CLOCKWISE = [(True, True), (False, True), (False, False), (True, False)]
# Of a topic, with those of its arrays: more than any of PX4 has.
_MOST_FIELDS = 20_000


class _Bounded(io.BytesIO):
    """Bytes that can be read so often only: of some damaged logs pyulog reads the end for ever."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        # A message takes two reads and has ten bytes or more.
        self._left = 10_000 + len(data) // 2

    def read(self, size: int | None = -1, /) -> bytes:
        self._left -= 1
        if self._left < 0:
            raise RuntimeError("it is damaged")
        return super().read(size)


class ULogTables(NamedTuple):
    """What was read of a ULog.

    Attributes:
        tables: its topics.
        remarks: on dropouts and damage.
        rotors: number of each of PX4's four rotors, as a record counts them; None if its parameters do not say it.
    """

    tables: list[Table]
    remarks: list[str]
    rotors: tuple[int, ...] | None


def ulog_tables(log: LogFile, mapping: Mapping) -> ULogTables:
    """Reads the topics that a mapping knows, of their first instance.

    Fields are named as in `vehicle_attitude.q[0]`. What was measured is timed by `timestamp_sample` where the log has
    it, and by `timestamp` otherwise.

    Raises:
        InputError: pyulog is not installed, or cannot read the log.
    """
    try:
        from pyulog import ULog
    except ImportError:
        raise InputError(f"{log.mark}: a ULog is read by pyulog: pip install 'drake_quad[ulog]'") from None
    topics = {name.partition(".")[0] for name in mapping.names}
    try:
        # What it prints is said in remarks.
        with contextlib.redirect_stdout(io.StringIO()):
            _check_fields(ULog(_Bounded(log.data), parse_header_only=True).message_formats)
            read = ULog(_Bounded(log.data), sorted(topics))
    except Exception as error:  # of a damaged log pyulog raises whatever its lines meet
        reason = shortened(str(error) or type(error).__name__)
        raise InputError(f"{log.mark}: is a ULog that cannot be read: {reason}") from None
    topics_read = [topic for topic in read.data_list if topic.multi_id == 0 and "timestamp" in topic.data]
    start = min((int(topic.data["timestamp"][0]) for topic in topics_read), default=0)
    tables = [_table(topic, start) for topic in topics_read]
    if not tables:
        raise InputError(f"{log.mark}: is a ULog without any of the topics {', '.join(sorted(topics))}")
    return ULogTables(tables, [*log.remarks, *_remarks(read)], _rotors(read.initial_parameters))


def _rotors(parameters: collections.abc.Mapping[str, Any]) -> tuple[int, ...] | None:
    """The numbers of four rotors by where they are: forward and to the right are positive in CA_ROTORi_PX and _PY."""
    places = [(parameters.get(f"CA_ROTOR{i}_PX"), parameters.get(f"CA_ROTOR{i}_PY")) for i in range(len(_CLOCKWISE))]
    if parameters.get("CA_ROTOR_COUNT", len(_CLOCKWISE)) != len(_CLOCKWISE):
        return None
    quadrants = [(x > 0.0, y > 0.0) for x, y in places if x and y]
    if sorted(quadrants) != sorted(_CLOCKWISE):
        return None
    return tuple(_CLOCKWISE.index(quadrant) + 1 for quadrant in quadrants)


def _check_fields(formats: dict[str, Any]) -> None:
    """Refuses topics that would be unfolded into more fields than any has."""
    counts: dict[str, int] = {}

    def count(name: str, depth: int) -> int:
        if name not in formats:
            return 1
        if depth > len(formats):
            raise ValueError(f"the topic {name} holds itself")
        if name not in counts:
            counts[name] = sum(max(1, size) * count(kind, depth + 1) for kind, size, _ in formats[name].fields)
        if counts[name] > _MOST_FIELDS:
            raise ValueError(f"the topic {name} has {counts[name]:,} fields")
        return counts[name]

    for name in formats:
        count(name, 0)


def _table(topic: Any, start: int) -> Table:
    """A topic, timed from a start in µs: from 1970 on a microsecond would be lost."""

    def seconds(stamps: np.ndarray) -> np.ndarray:
        return (stamps.astype(np.uint64) - np.uint64(start)).view(np.int64) * _SECOND

    sampled = topic.data.get("timestamp_sample")
    columns = {
        f"{topic.name}.{name}": values
        for name, values in topic.data.items()
        if not name.startswith(("timestamp", "_padding"))
    }
    known = sampled is not None and bool((sampled > 0).all())
    return Table(topic.name, seconds(topic.data["timestamp"]), columns, seconds(sampled) if known else None)


def _remarks(read: Any) -> list[str]:
    remarks = []
    lengths = np.array([dropout.duration for dropout in read.dropouts]) * 1e-3
    if len(lengths):
        remarks.append(
            f"{len(lengths)} dropout{'s' if len(lengths) > 1 else ''} of the logger, {lengths.sum():.3g} s in all, the"
            f" longest of {lengths.max():.3g} s"
        )
    if read.file_corruption:
        remarks.append("the log is damaged; read what pyulog finds whole")
    return remarks
