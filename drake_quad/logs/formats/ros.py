"""Readers of ROS bags of version 1 and 2, based on rosbags, and of MCAP files, based on mcap.

The name of a field starts with its topic or with the type of its messages, as in `/odom.pose.pose.position.x` or
`nav_msgs/Odometry.pose.pose.position.x`. If several topics have this type, the topic with the most messages is read.
The time of a measurement is the stamp in the header of its message.
"""

import contextlib
import functools
import io
import json
import re
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.logs.conversion import Table
from drake_quad.logs.formats.log_format import FORMATS, LogContent, LogFormat, NamedMapping
from drake_quad.logs.mapping import load_mapping
from drake_quad.logs.source import LogFile, exception_clause

_NANOSECOND = 1e-9  # s
# If a stamp differs from the time of recording by more than this, in s, it comes from another clock.
_MAX_STAMP_DIFFERENCE = 1.0
# Name of a field, or index of an item, in a path such as `covariance[0].x`.
_PATH_PART = re.compile(r"[^.\[\]]+")
# Exceptions that are raised for damaged messages and missing fields.
_FIELD_ERRORS = (AttributeError, KeyError, IndexError, TypeError, ValueError)
# Bytes of SQLite's header that mark a database in WAL mode. Such a database cannot be opened from memory.
_WAL_VERSION_BYTES = slice(18, 20)


class _Message(NamedTuple):
    """Message before decoding.

    Attributes:
        topic: name of the topic.
        type_name: type of the message, as in `nav_msgs/Odometry`.
        time: time of recording, ns.
        decode: function that returns the message.
    """

    topic: str
    type_name: str
    time: int
    decode: Callable[[], Any]


class _Rows:
    """Values of the topic fields that a mapping uses, with one row per message."""

    def __init__(self, type_name: str, fields: list[str]) -> None:
        self.type_name = type_name
        self._paths = {
            each: [int(part) if part.isdigit() else part for part in _PATH_PART.findall(each)] for each in fields
        }
        self._values: dict[str, list[float]] = {each: [] for each in fields}
        self._times: list[int] = []
        self._stamps: list[int] = []

    def append(self, message: Any, time: int) -> None:
        """Append the fields of a message."""
        self._times.append(time)
        self._stamps.append(_stamp(message))
        for name, path in self._paths.items():
            try:
                value = float(functools.reduce(_member, path, message))
            except _FIELD_ERRORS:
                value = np.nan
            self._values[name].append(value)

    def __len__(self) -> int:
        return len(self._times)

    def table(self, topic: str, start: int, *, with_type_names: bool) -> tuple[Table, list[str]]:
        """Return the table of a topic, and remarks on its times."""
        times, stamps = (
            np.array([each - start for each in clock], dtype=float) * _NANOSECOND
            for clock in (self._times, self._stamps)
        )
        known = {name: np.array(values) for name, values in self._values.items() if np.isfinite(values).any()}
        columns = {f"{topic}.{name}": values for name, values in known.items()}
        if with_type_names:
            columns |= {f"{self.type_name}.{name}": values for name, values in known.items()}
        remarks, sampled = [], None
        if min(self._stamps) > 0:
            difference = float(np.median(times - stamps))
            if abs(difference) < _MAX_STAMP_DIFFERENCE:
                sampled = stamps
            else:
                remarks.append(
                    f"{topic}: the header stamps are {difference:.4g} s before the recording times, which are used"
                    " instead"
                )
        return Table(topic, times, columns, sampled), remarks


def _member(value: Any, part: str | int) -> Any:
    return value[part] if isinstance(part, int) or isinstance(value, dict) else getattr(value, part)


def _stamp(message: Any) -> int:
    """Return the stamp in a message's header, ns; 0 if the message has none."""
    try:
        stamp = _member(_member(message, "header"), "stamp")
        return int(_member(stamp, "sec")) * 10**9 + int(_member(stamp, "nanosec"))
    except _FIELD_ERRORS:
        return 0


def _content(
    log: LogFile, user_mapping: NamedMapping | None, format_name: str, messages: Iterator[_Message]
) -> LogContent:
    """Read the fields that a mapping uses.

    Raises:
        InputError: if the mapping uses none of the topics, or the first message cannot be read.
    """
    name, mapping = user_mapping or load_mapping("ros")
    needed: dict[str, list[str]] = {}
    for each in sorted(mapping.names):
        topic, _, field = each.partition(".")
        needed.setdefault(topic, []).append(field)
    topics: dict[str, _Rows] = {}
    unread: set[str] = set()
    undecoded: set[str] = set()
    remarks = []
    try:
        for message in messages:
            fields = needed.get(message.topic, []) + needed.get(message.type_name, [])
            if not fields or message.topic in undecoded:
                unread.add(message.topic)
                continue
            try:
                decoded = message.decode()
            except Exception:  # rosbags raises any exception on a damaged message
                if message.topic not in topics:
                    undecoded.add(message.topic)
                continue
            topics.setdefault(message.topic, _Rows(message.type_name, fields)).append(decoded, message.time)
    except InputError:
        raise
    except Exception as error:  # libraries raise any exception on a damaged bag
        if not topics:
            raise InputError(f"{log.mark}: is {format_name} that cannot be read: {exception_clause(error)}") from None
        remarks.append(f"the log is truncated or damaged; it is read up to this error: {exception_clause(error)}")
    if undecoded:
        remarks.append(f"the messages of {join_names(sorted(undecoded))} cannot be decoded")
    if not topics:
        raise InputError(
            f"{log.mark}: is {format_name} without any topic of the mapping {name}; its topics are"
            f" {join_names(sorted(unread | undecoded)) or 'none'}"
        )
    return _tables(topics, (name, mapping), remarks, sorted(unread))


def _tables(topics: dict[str, _Rows], mapping: NamedMapping, remarks: list[str], unread: list[str]) -> LogContent:
    """Return the tables of the topics, on a clock that begins with the first message."""
    start = min(rows._times[0] for rows in topics.values())
    longest_topics: dict[str, str] = {}
    for topic, rows in topics.items():
        if rows.type_name not in longest_topics or len(rows) > len(topics[longest_topics[rows.type_name]]):
            longest_topics[rows.type_name] = topic
    tables = []
    for topic, rows in topics.items():
        table, table_remarks = rows.table(topic, start, with_type_names=longest_topics[rows.type_name] == topic)
        tables.append(table)
        remarks += table_remarks
    for type_name, topic in longest_topics.items():
        count = sum(rows.type_name == type_name for rows in topics.values())
        if count > 1:
            remarks.append(f"{count} topics have the type {type_name}; {topic} is read, which has the most messages")
    return LogContent(tables, mapping, remarks, unread)


class _Decoder:
    """Decoder of messages. It uses the definitions in a bag, or the definitions of ROS 2 if the bag contains none."""

    def __init__(self, typesys: Any, definitions: Mapping[str, str], *, encoding: str = "cdr") -> None:
        self._typesys, self._encoding = typesys, encoding
        self._definitions = {_full(kind): text for kind, text in definitions.items()}
        self._stores: dict[str, Any] = {}

    def __call__(self, data: bytes, type_name: str) -> Any:
        """Deserialise a message of a given type."""
        type_name = _full(type_name)
        if type_name not in self._stores:
            stores, known = self._typesys.Stores, type_name in self._definitions
            store = self._typesys.get_typestore(stores.EMPTY if known else stores.LATEST)
            if known:
                store.register(self._typesys.get_types_from_msg(self._definitions[type_name], type_name))
            self._stores[type_name] = store
        return getattr(self._stores[type_name], f"deserialize_{self._encoding}")(data, type_name)


def _short(kind: str) -> str:
    return kind.replace("/msg/", "/")


def _full(kind: str) -> str:
    return kind if "/msg/" in kind else kind.replace("/", "/msg/")


def _read_bag_1(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read a ROS 1 bag."""
    rosbag1 = log.library("rosbags.rosbag1", "ros")
    typesys = log.library("rosbags.typesys", "ros")

    def messages(path: Any) -> Iterator[_Message]:
        with rosbag1.Reader(path) as reader:
            definitions = {each.msgtype: each.msgdef.data for each in reader.connections}
            decoder = _Decoder(typesys, definitions, encoding="ros1")
            for connection, time, data in reader.messages():
                decode = functools.partial(decoder, data, connection.msgtype)
                yield _Message(connection.topic, _short(connection.msgtype), time, decode)

    content: LogContent = log.read_from_disk(
        ".bag", lambda path: _content(log, user_mapping, "a ROS 1 bag", messages(path))
    )
    return content


def _read_bag_2(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read the SQLite file of a ROS 2 bag."""
    typesys = log.library("rosbags.typesys", "ros")

    def messages() -> Iterator[_Message]:
        data = bytearray(log.data)
        data[_WAL_VERSION_BYTES] = b"\1\1"
        with contextlib.closing(sqlite3.connect(":memory:")) as bag:
            bag.deserialize(bytes(data))
            definitions: dict[str, str] = {}
            if bag.execute("SELECT name FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
                rows = bag.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
                definitions = {kind: text for kind, encoding, text in rows if encoding == "ros2msg" and text}
            decoder = _Decoder(typesys, definitions)
            query = "SELECT t.name, t.type, m.timestamp, m.data FROM messages m JOIN topics t ON t.id = m.topic_id"
            for topic, kind, time, raw in bag.execute(f"{query} ORDER BY m.timestamp"):
                yield _Message(topic, _short(kind), time, functools.partial(decoder, raw, kind))

    return _content(log, user_mapping, "a ROS 2 bag", messages())


def _read_mcap(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read an MCAP file with messages of ROS 2, ROS 1 or JSON."""
    mcap = log.library("mcap.reader", "mcap")
    typesys = log.library("rosbags.typesys", "ros")

    def messages() -> Iterator[_Message]:
        decoders: dict[int, _Decoder] = {}
        reader = mcap.NonSeekingReader(io.BytesIO(log.data))
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            kind = schema.name if schema else ""
            if channel.message_encoding == "json":
                decode = functools.partial(json.loads, message.data)
            else:
                if channel.id not in decoders:
                    has_text = schema and schema.encoding in ("ros1msg", "ros2msg")
                    known = {kind: schema.data.decode()} if has_text else {}
                    encoding = "ros1" if channel.message_encoding == "ros1" else "cdr"
                    decoders[channel.id] = _Decoder(typesys, known, encoding=encoding)
                decode = functools.partial(decoders[channel.id], message.data, kind)
            yield _Message(channel.topic, _short(kind), message.log_time, decode)

    return _content(log, user_mapping, "an MCAP file", messages())


FORMATS += [
    LogFormat("a ROS 1 bag", lambda log: log.data.startswith(b"#ROSBAG V2.0\n"), _read_bag_1),
    LogFormat("the SQLite file of a ROS 2 bag", lambda log: log.data.startswith(b"SQLite format 3\0"), _read_bag_2),
    LogFormat("MCAP", lambda log: log.data.startswith(b"\x89MCAP0\r\n"), _read_mcap),
]
