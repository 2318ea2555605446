"""Reader of PX4's ULog, based on pyulog (docs.px4.io, "ULog file format")."""

import collections.abc
import io
from typing import Any, NamedTuple

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
from drake_quad.logs.px4_status import (
    STATUS_TOPICS,
    other_vehicle,
    status_remarks,
    with_motor_pulses,
    without_invalid_samples,
)
from drake_quad.logs.source import LogFile
from drake_quad.process_settings import without_prints

MAGIC = b"ULog\x01\x12\x35"
_MICROSECOND = 1e-6  # s
# Pairs (is in front, is on the right) of the rotors, clockwise from the front right rotor.
_CLOCKWISE_QUADRANTS = [(True, True), (False, True), (False, False), (True, False)]
# Largest number of fields in a topic, where each item of an array counts. All topics of PX4 have fewer.
_MAX_FIELDS = 20_000
_HEADER_SIZE = 16  # bytes
# Letters of all message types in the format.
_MESSAGE_TYPES = frozenset(b"ABCDFILMOPQRS")


class _BoundedReader(io.BytesIO):
    """Bytes with a limited number of reads, since pyulog never stops reading the end of some damaged logs."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        # A message takes two reads and has at least ten bytes, so an intact log needs fewer reads.
        self._left = 10_000 + len(data) // 2

    def read(self, size: int | None = -1, /) -> bytes:
        self._left -= 1
        if self._left < 0:
            raise RuntimeError("it is damaged")
        return super().read(size)


def _read(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read the first instance of the topics that a mapping uses.

    Names of fields have the form `vehicle_attitude.q[0]`. The time of a measurement is its `timestamp_sample` if it is
    logged, and its `timestamp` otherwise. Positions and velocities that the log declares invalid become NaN. Motor
    pulses are scaled to the range 1000 to 2000 µs from the range that the parameters of the log declare. The default
    mapping takes the order of the rotors from these parameters.

    Args:
        log: content of the file.
        user_mapping: name of a mapping, and the mapping from fields to signals. If None, the log of a vehicle that is
            not a quadrotor is rejected; otherwise a remark states the type of the vehicle.

    Raises:
        InputError: if pyulog is not installed or cannot read the log, or the logged vehicle is not a quadrotor.
    """
    name, mapping = user_mapping or load_mapping("px4")
    topics = {name.partition(".")[0] for name in mapping.names}
    intact = _intact_start_of(log)
    remarks = [*intact.remarks]
    try:
        parsed = _parsed(log, log.data[: log.written_size if intact.may_continue else intact.end], topics)
    except InputError:
        parsed = _parsed(log, log.data[: intact.end], topics) if intact.may_continue else None
        if parsed is None or not parsed.data_list:
            raise
        remarks.append(log.unread_remark(intact.end, "pyulog cannot continue there"))
    else:
        if parsed.file_corruption and not intact.may_continue:
            remarks.append("the log is damaged; only the complete messages that pyulog finds are read")
    first_instances = {
        topic.name: topic.data for topic in parsed.data_list if topic.multi_id == 0 and "timestamp" in topic.data
    }
    parameters = parsed.initial_parameters
    other_type = other_vehicle(parameters, first_instances.get("vehicle_status"))
    vehicle_remarks = other_vehicle_remarks(log, other_type, user_mapping)
    mapped = {name: data for name, data in first_instances.items() if name in topics}
    if not mapped:
        raise InputError(f"{log.mark}: is a ULog without any of the topics {', '.join(sorted(topics))}")
    start = min(int(data["timestamp"][0]) for data in mapped.values())
    remarks += [*vehicle_remarks, *_dropouts(parsed), *status_remarks(first_instances, start)]
    tables = []
    for topic, data in mapped.items():
        if topic == "actuator_outputs":
            try:
                mapped_data, pulse_remarks = with_motor_pulses(data, parameters)
            except InputError as error:
                raise InputError(f"{log.mark}: {error}") from None
            # The commands in actuator_motors take precedence over pulses.
            remarks += pulse_remarks if "actuator_motors" not in mapped else ()
        else:
            mapped_data = without_invalid_samples(topic, data)
        tables.append(_table(topic, mapped_data, start))
    if name == "px4":
        rotors = _rotors(parameters)
        mapping = mapping if rotors is None else mapping.with_rotors(rotors)
        order = ", ".join(map(str, mapping.rotors or ()))
        source = (
            "assumed as in PX4's quad-x layout, since the log has no parameters CA_ROTOR0_PX and so on"
            if rotors is None
            else "according to the parameters CA_ROTOR0_PX and so on"
        )
        remarks.append(f"PX4's rotors 1 to 4 are rotors {order} of this library, {source}")
    return LogContent(tables, (name, mapping), remarks)


def ulog_parameters(log: LogFile) -> dict[str, Any]:
    """Return the parameters at the start of a log, by name.

    Raises:
        InputError: if pyulog is not installed or cannot read the log.
    """
    parameters: dict[str, Any] = _parsed(log, log.data[: _intact_start_of(log).end], set()).initial_parameters
    return parameters


class _IntactStart(NamedTuple):
    """Contiguous complete messages at the start of a log.

    Attributes:
        end: offset of the first byte after the last message.
        may_continue: True if the data after `end` may contain further messages.
        remarks: remarks on the data after `end`.
    """

    end: int
    may_continue: bool
    remarks: list[str]


def _intact_start_of(log: LogFile) -> _IntactStart:
    """Find the end of the contiguous complete messages of a log.

    A truncated log may end with bytes 0 or 0xff. A message that extends into these bytes is excluded, since its last
    bytes may not have been written.
    """
    data, written_size = log.data, log.written_size
    offset = end = _HEADER_SIZE
    while offset + 3 <= len(data):
        size, message_type = data[offset] | data[offset + 1] << 8, data[offset + 2]
        is_known = message_type in _MESSAGE_TYPES
        if not is_known or offset + 3 + size > len(data):
            break
        offset += 3 + size
        if offset <= written_size:
            end = offset
    if offset >= len(data):
        return _IntactStart(len(data), may_continue=False, remarks=[])
    if offset + 3 > written_size or is_known:
        return _IntactStart(
            end, may_continue=False, remarks=[log.unread_remark(end, "no complete message, so the log is truncated")]
        )
    return _IntactStart(
        offset,
        may_continue=True,
        remarks=[f"the log is damaged from byte {offset:,} on; only complete messages that pyulog finds are read"],
    )


def _parsed(log: LogFile, data: bytes, topics: set[str]) -> Any:
    """Read some topics with pyulog.

    Raises:
        InputError: if pyulog is not installed, or cannot read the data.
    """
    pyulog = log.library("pyulog", "ulog")

    def read() -> Any:
        # The output of pyulog is suppressed, since the remarks contain the same information.
        with without_prints():
            _check_fields(pyulog.ULog(_BoundedReader(data), parse_header_only=True).message_formats)
            return pyulog.ULog(_BoundedReader(data), sorted(topics.union(STATUS_TOPICS)))

    return log.read_by_library("a ULog", read)


def _rotors(parameters: collections.abc.Mapping[str, Any]) -> tuple[int, ...] | None:
    """Return the number in this library of each of PX4's rotors, from the rotor positions in the parameters.

    CA_ROTORi_PX is positive for a rotor in front, and CA_ROTORi_PY for a rotor to the right.

    Returns:
        (4,) numbers; None if the positions are unknown, or are not those of four rotors in an x layout.
    """
    rotor_positions = [
        (parameters.get(f"CA_ROTOR{i}_PX"), parameters.get(f"CA_ROTOR{i}_PY")) for i in range(len(_CLOCKWISE_QUADRANTS))
    ]
    if parameters.get("CA_ROTOR_COUNT", len(_CLOCKWISE_QUADRANTS)) != len(_CLOCKWISE_QUADRANTS):
        return None
    quadrants = [(x > 0.0, y > 0.0) for x, y in rotor_positions if x and y]
    if sorted(quadrants) != sorted(_CLOCKWISE_QUADRANTS):
        return None
    return tuple(_CLOCKWISE_QUADRANTS.index(quadrant) + 1 for quadrant in quadrants)


def _check_fields(formats: dict[str, Any]) -> None:
    """Reject topics that contain themselves or that have more fields than any topic of PX4."""
    counts: dict[str, int] = {}

    def count(name: str, depth: int) -> int:
        if name not in formats:
            return 1
        if depth > len(formats):
            raise ValueError(f"the topic {name} contains itself")
        if name not in counts:
            counts[name] = sum(max(1, size) * count(kind, depth + 1) for kind, size, _ in formats[name].fields)
        if counts[name] > _MAX_FIELDS:
            raise ValueError(f"the topic {name} has {counts[name]:,} fields")
        return counts[name]

    for name in formats:
        count(name, 0)


def _table(topic: str, data: collections.abc.Mapping[str, np.ndarray], start: int) -> Table:
    """Return a topic with times relative to a start in µs.

    Times in seconds since 1970 would not resolve a microsecond in double precision.
    """

    def seconds(stamps: np.ndarray) -> np.ndarray:
        return (stamps.astype(np.uint64) - np.uint64(start)).view(np.int64) * _MICROSECOND

    sample_stamps = data.get("timestamp_sample")
    columns = {
        f"{topic}.{name}": values for name, values in data.items() if not name.startswith(("timestamp", "_padding"))
    }
    sample_time = None if sample_stamps is None or not (sample_stamps > 0).all() else seconds(sample_stamps)
    return Table(topic, seconds(data["timestamp"]), columns, sample_time)


def _dropouts(parsed: Any) -> list[str]:
    """Return a remark on the dropouts of the logger, if there are any."""
    lengths = np.array([dropout.duration for dropout in parsed.dropouts]) * 1e-3
    if not len(lengths):
        return []
    return [
        f"{len(lengths)} dropout{'s' if len(lengths) > 1 else ''} of the logger, {lengths.sum():.3g} s in total; the"
        f" longest lasts {lengths.max():.3g} s"
    ]


FORMATS.append(LogFormat("PX4's ULog", lambda log: log.data.startswith(MAGIC), _read))
