"""Conversion of log columns to a record with SI units, the frames of this library, and one clock."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.consistency import inconsistencies
from drake_quad.logs.mapping import ATTITUDES, Mapping, SignalSource
from drake_quad.logs.plausibility import implausible_signals, position_jumps
from drake_quad.logs.record import COLUMNS, QUANTITIES, FlightRecord, SignalOrigin
from drake_quad.logs.timing import increasing_samples, timing_remarks
from drake_quad.logs.units import UNITS
from drake_quad.scenario.files.marked_tree import Mark

# Signals that hold until their next sample, in addition to commands and references. All other signals are measurements,
# which are interpolated linearly.
_HELD_SIGNALS = ("motor_command", "thrust_fraction", "battery_voltage")
_ANGLE_SIGNALS = (*ATTITUDES, "reference_yaw")
# Signals that change slowly. Their first value is used before their first sample, and their last value after the last.
_SLOW_SIGNALS = ("battery_voltage", "wind", "hover_thrust_fraction")
# Frames whose z axis points down. A rotation by 180° about x converts NED to NWU, and FRD to FLU.
_DOWNWARD_FRAMES = ("NED", "FRD")
_HALF_TURN = np.array([1.0, -1.0, -1.0])  # signs of x, y and z after this rotation
_QUATERNION_TURN = np.array([1.0, 1.0, -1.0, -1.0])  # signs of w, x, y and z of a quaternion after this rotation
# Range of the norm of a valid quaternion. Many logs begin with zeros.
_MIN_QUATERNION_NORM = 0.5  # smallest norm
_MAX_QUATERNION_NORM = 2.0  # largest norm
# Plausible range of a motor command, relative to the full command. It is wide, since the full command in the log may be
# unknown.
_PLAUSIBLE_COMMANDS = (-0.5, 1.5)
# Range of a command that was logged with 16 bits, with a tolerance for rounding.
_PLAUSIBLE_16_BIT_COMMANDS = (-1e-3, 1.001)
_MIN_COVERAGE = 0.5  # smallest fraction of the duration for which a signal must be logged
_MAX_VALUE = 1e9  # in any unit; larger values are damaged data
_MAX_LISTED_NAMES = 6  # largest number of columns that are listed in one sentence


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of a log that share one clock, such as a CSV file, a topic or an event type.

    Attributes:
        name: name of the topic or event type.
        time: (n,) times at which the rows were written, s.
        columns: (n,) or (n, width) values by name; NaN for a cell that is not a number.
        sample_time: (n,) times of the measurements, s; None if they are not logged.
    """

    name: str
    time: np.ndarray
    columns: dict[str, np.ndarray]
    sample_time: np.ndarray | None = None


class _Channel(NamedTuple):
    """Samples of a signal, on the clock of the table from which they were read.

    Attributes:
        signal: name of the signal.
        clock: (n,) clock of the table, s; the same object for all signals that share it.
        rows: indices of the clock samples at which the signal is known.
        values: (rows, columns) values at these samples.
        source: source of the signal in the mapping.
    """

    signal: str
    clock: np.ndarray
    rows: np.ndarray
    values: np.ndarray
    source: SignalSource

    @property
    def time(self) -> np.ndarray:
        return self.clock[self.rows]

    @property
    def is_complete(self) -> bool:
        """True if the signal has a value at every sample of its own clock."""
        return len(self.rows) == len(self.clock)


class _Clocks:
    """Clocks of the tables of a log. Samples whose time does not increase are removed."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.remarks: list[str] = []

    def of(self, table: Table, signal: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the increasing sample times of a signal, s, and the table rows of the samples."""
        time = table.time if table.sample_time is None or is_held(signal) else table.sample_time
        if id(time) not in self._known:
            is_kept, remarks = increasing_samples(time)
            table_remarks = [f"{table.name}: {each}" if table.name else each for each in remarks]
            self.remarks += [each for each in table_remarks if each not in self.remarks]
            self._known[id(time)] = time[is_kept], np.flatnonzero(is_kept)
        return self._known[id(time)]


def is_held(signal: str) -> bool:
    """Return whether a signal holds its value until its next sample, like a command."""
    return signal in _HELD_SIGNALS or signal.endswith("_command") or signal.startswith("reference_")


def record_of(
    tables: Sequence[Table],
    mapping: Mapping,
    *,
    name: str,
    mark: Mark,
    remarks: Iterable[str] = (),
    names: Iterable[str] = (),
) -> FlightRecord:
    """Convert the tables of a log to a record.

    The clock of the record is that of the fastest table that contains a signal. Measurements in other tables are
    interpolated linearly, and commands are held. The record begins when each of its signals has a sample.

    Args:
        tables: tables of the log.
        mapping: mapping from columns to signals.
        name: name of the log.
        mark: name of the log in error messages.
        remarks: the reader's remarks on the log.
        names: names of columns in the log that are not in the tables.

    Raises:
        InputError: if the log has no signal, or fewer than two samples at which all signals are known.
    """
    notes: list[str] = []
    tables = [_without_damaged_rows(table, mapping, notes) for table in tables]
    longest_first = sorted(tables, key=lambda table: -len(table.time))
    available = {*names}.union(*(table.columns for table in tables))
    clocks = _Clocks()
    channels: list[_Channel] = []
    for signal in mapping.signals:
        channel = next(_channels(signal, mapping, longest_first, clocks), None)
        if channel is not None:
            channels.append(channel)
        else:
            notes += _incomplete_remarks(signal, mapping, available)
    if not channels:
        raise InputError(
            f"{mark}: has no signal with two samples or more; its columns are {join_names(sorted(available))}"
        )
    clock = _fastest(channels)
    used, left_out_remarks = _sufficiently_logged(channels, clock)
    if not used:
        raise InputError(f"{mark}: has no signal that is logged for half of the time")
    missing = {*(mapping.required or ())} - {channel.signal for channel in used}
    if missing:
        raise InputError(f"{mark}: lacks {join_names(sorted(missing))}, which the mapping requires")
    is_common, cut_remarks = _common_samples(used, clock)
    if is_common.sum() < 2:
        raise InputError(f"{mark}: has fewer than two samples at which all signals are known")
    time = clock[is_common]
    signals: dict[str, Any] = {channel.signal: _resampled(channel, clock, is_common) for channel in used}
    notes += _turn_to_signal_frames(signals, used)
    if not signals:
        raise InputError(f"{mark}: has no signal that can be used: {'; '.join(notes)}")
    wind = None if "wind" in signals else mapping.wind_of(name)
    if wind is not None:
        signals["wind"] = np.tile(wind, (len(time), 1))
        notes.append(f"wind is ({', '.join(f'{each:g}' for each in wind)}) m/s, as the name of the log implies")
    slow = (each for each in used if each.signal == "reference_position" and each.clock is not clock)
    return FlightRecord(
        name=name,
        time=time - time[0],
        reference_period=next((float(np.median(np.diff(each.time))) for each in slow), 0.0),
        vehicle=mapping.vehicle,
        **signals,
        remarks=(
            *remarks,
            *clocks.remarks,
            *timing_remarks(time),
            *cut_remarks,
            *left_out_remarks,
            *notes,
            *(
                each
                for channel in used
                if channel.signal == "position"
                for each in position_jumps(channel.time, channel.values)
            ),
            *implausible_signals(signals, time - time[0]),
            *(each.text for each in inconsistencies(signals, time)),
            *_unread_remarks(
                available - ({mapping.time.column} if mapping.time else set()),
                {each for channel in used for each in channel.source.names},
            ),
        ),
        origins=tuple(_origin(channel, clock) for channel in used),
    )


def _without_damaged_rows(table: Table, mapping: Mapping, notes: list[str]) -> Table:
    """Return the table without the rows whose motor commands are out of range, and add a remark on them to `notes`."""
    sources = [
        each for each in mapping.signals.get("motor_command", ()) if all(name in table.columns for name in each.names)
    ]
    if not sources or not len(table.time):
        return table
    with np.errstate(all="ignore"):  # damaged rows may contain any number
        commands = _values("motor_command", sources[0], table)
        lower, upper = _PLAUSIBLE_16_BIT_COMMANDS if sources[0].unit == "uint16" else _PLAUSIBLE_COMMANDS
        is_wrong = ((commands < lower) | (commands > upper)).any(axis=1)
    if not is_wrong.any():
        return table
    largest, first = float(np.nanmax(np.abs(commands[is_wrong]))), table.time[np.argmax(is_wrong)] - table.time[0]
    notes.append(
        f"{is_wrong.sum():,} of {len(is_wrong):,} samples are left out, first at {first:.4g} s: the log is damaged,"
        f" with motor commands of up to {largest:.3g} times the full command"
    )
    columns = {name: values[~is_wrong] for name, values in table.columns.items()}
    return Table(
        table.name, table.time[~is_wrong], columns, None if table.sample_time is None else table.sample_time[~is_wrong]
    )


def _channels(signal: str, mapping: Mapping, tables: Sequence[Table], clocks: _Clocks) -> Iterator[_Channel]:
    """Yield the channels of a signal, one for each of its sources, in order of preference."""
    for source in mapping.signals[signal]:
        for table in tables:
            if not all(each in table.columns for each in source.names) or len(table.time) < 2:
                continue
            clock, row_indices = clocks.of(table, signal)
            with np.errstate(all="ignore"):  # damaged rows may contain any number
                values = _values(signal, source, table)[row_indices]
            if signal == "motor_command":
                values = np.clip(values, 0.0, 1.0)
            rows = np.flatnonzero((np.abs(values) < _MAX_VALUE).all(axis=1))
            if len(rows) > 1:
                yield _Channel(signal, clock, rows, values[rows], source)


def _values(signal: str, source: SignalSource, table: Table) -> np.ndarray:
    """Return the values (n, columns) of a signal in SI units and the frames of this library; NaN for unknown values."""
    length = len(table.time)
    if source.column is not None:
        values = table.columns[source.column].reshape(length, -1).astype(float)
    else:
        values = np.column_stack(
            [
                table.columns[each].astype(float) if isinstance(each, str) else np.full(length, float(each))
                for each in source.columns or ()
            ]
        )
    if source.missing is not None:
        values = np.where(np.isfinite(values), values, source.missing)
    values = values * np.asarray(source.factor)
    if source.quaternion is not None:
        return _roll_pitch_yaw(values, source)
    unit = UNITS[QUANTITIES[signal].unit][source.unit or QUANTITIES[signal].unit]
    values = (values - unit.zero) * unit.scale
    if source.rotors is not None:
        values = values[:, np.argsort(source.rotors)]
    if source.frame in _DOWNWARD_FRAMES:
        values = -values if signal == "reference_yaw" else values * _HALF_TURN
    return values


def _roll_pitch_yaw(values: np.ndarray, source: SignalSource) -> np.ndarray:
    """Return roll, pitch and yaw (n, 3) in the frames of this library from quaternions (n, 4); NaN for invalid ones."""
    quaternion = values if source.quaternion == "wxyz" else np.roll(values, 1, axis=1)
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    valid = (length > _MIN_QUATERNION_NORM) & (length < _MAX_QUATERNION_NORM)
    unit = np.divide(quaternion, length, out=np.full_like(quaternion, np.nan), where=valid)
    if source.frame in _DOWNWARD_FRAMES:
        unit = unit * _QUATERNION_TURN
    w, x, y, z = unit.T
    return np.column_stack(
        [
            np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
            np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ]
    )


def _fastest(channels: Sequence[_Channel]) -> np.ndarray:
    """Return the clock with the smallest median step among the measurements, or among all signals if none is measured.

    Signals that last less than half as long as the longest one are ignored.
    """
    measurements = [channel for channel in channels if not is_held(channel.signal)] or channels
    longest = max(channel.time[-1] - channel.time[0] for channel in measurements)
    long = [each for each in measurements if each.time[-1] - each.time[0] >= _MIN_COVERAGE * longest]
    return min((channel.clock for channel in long), key=lambda clock: float(np.median(np.diff(clock))))


def _sufficiently_logged(channels: Sequence[_Channel], clock: np.ndarray) -> tuple[list[_Channel], list[str]]:
    """Return the signals that are logged for at least half of the time, and remarks on the other signals."""
    sufficient, remarks = [], []
    span = clock[-1] - clock[0]
    for channel in channels:
        end = clock[-1] if is_held(channel.signal) else min(channel.time[-1], clock[-1])
        covered_fraction = 1.0 if channel.signal in _SLOW_SIGNALS else (end - max(channel.time[0], clock[0])) / span
        known_fraction = len(channel.rows) / len(channel.clock)
        if min(covered_fraction, known_fraction) >= _MIN_COVERAGE:
            sufficient.append(channel)
        else:
            remarks.append(
                f"{channel.signal} is left out: it is logged for {max(min(covered_fraction, known_fraction), 0.0):.0%}"
                " of the time"
            )
    return sufficient, remarks


def _common_samples(channels: Sequence[_Channel], clock: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return a mask of the clock samples at which all signals are known, and remarks on the other samples."""
    channels = [channel for channel in channels if channel.signal not in _SLOW_SIGNALS] or channels
    latest = max(channels, key=lambda channel: channel.time[0])
    measured = [channel for channel in channels if not is_held(channel.signal)]
    earliest = min(measured, key=lambda channel: channel.time[-1], default=latest)
    remarks = []
    is_common = clock >= latest.time[0]
    if not is_common.all():
        remarks.append(f"the first {latest.time[0] - clock[0]:.4g} s are left out: {latest.signal} is not logged yet")
    if measured:
        is_before_end = clock <= earliest.time[-1]
        if not is_before_end.all():
            remarks.append(
                f"the last {clock[-1] - earliest.time[-1]:.4g} s are left out: {earliest.signal} is no longer logged"
            )
        is_common &= is_before_end
    return is_common, remarks


def _resampled(channel: _Channel, clock: np.ndarray, is_common: np.ndarray) -> np.ndarray:
    """Return the values of a signal at the clock samples at which all signals are known, given by a mask."""
    if channel.clock is clock and channel.is_complete:
        values = channel.values[is_common]
    else:
        time = clock[is_common]
        if is_held(channel.signal):
            values = channel.values[np.maximum(np.searchsorted(channel.time, time, side="right") - 1, 0)]
        else:
            is_angle = channel.signal in _ANGLE_SIGNALS
            unwrapped = np.unwrap(channel.values, axis=0) if is_angle else channel.values
            values = np.column_stack([np.interp(time, channel.time, column) for column in unwrapped.T])
            if is_angle:
                values = np.arctan2(np.sin(values), np.cos(values))
    return values[:, 0] if COLUMNS[channel.signal] == 1 else values


def _turn_to_signal_frames(signals: dict[str, Any], channels: Sequence[_Channel]) -> Iterator[str]:
    """Turn signals from body to world axes, or vice versa, by the attitude, and yield a remark on each."""
    for channel in channels:
        if not channel.source.is_in_other_frame(channel.signal):
            continue
        to_world = QUANTITIES[channel.signal].frame == "W"
        source_axes, target_axes = ("body", "world") if to_world else ("world", "body")
        if "attitude" in signals:
            turned = rotation_matrices(signals["attitude"]).apply(signals[channel.signal], inverse=not to_world)
            signals[channel.signal] = turned
            yield f"{channel.signal} is turned from {source_axes} axes to {target_axes} axes by the attitude"
        else:
            del signals[channel.signal]
            yield f"{channel.signal} is left out: it is along {source_axes} axes, and no attitude is logged"


def _name_range(names: Sequence[str]) -> str:
    return f"{names[0]} to {names[-1]}" if len(names) > 1 else "".join(names)


def _origin(channel: _Channel, clock: np.ndarray) -> SignalOrigin:
    unit = f" ({channel.source.unit})" if channel.source.unit else ""
    is_resampled = channel.clock is not clock or not channel.is_complete
    return SignalOrigin(
        channel.signal,
        f"{_name_range(channel.source.names)}{unit}",
        1.0 / float(np.median(np.diff(channel.clock))),
        ("held" if is_held(channel.signal) else "interpolated") if is_resampled else "",
        1.0 - len(channel.rows) / len(channel.clock),
    )


def _incomplete_remarks(signal: str, mapping: Mapping, available: set[str]) -> Iterator[str]:
    """Yield a remark if a signal is left out, because a column is missing or all values are NaN."""
    for source in mapping.signals[signal]:
        missing = [each for each in source.names if each not in available]
        if not missing:
            kind = "a quaternion of length 1" if source.quaternion else "a number"
            yield f"{signal} is left out: {_name_range(source.names)} is {kind} in fewer than two samples"
            return
        if 0 < len(missing) < len(source.names):
            yield f"{signal} is left out: {join_names(missing)} {'is' if len(missing) == 1 else 'are'} not logged"
            return


def _unread_remarks(available: set[str], read: set[str]) -> Iterator[str]:
    """Yield a remark on the columns that are not read, grouped by the part of their names before the first dot."""
    groups: dict[str, list[str]] = {}
    for each in sorted(available - read):
        groups.setdefault(_group(each), []).append(each)
    parts = []
    for group, members in groups.items():
        if len(members) <= (_MAX_LISTED_NAMES if any(_group(each) == group for each in read) else 1):
            parts += members
        else:
            parts.append(f"{'the rest of ' if any(_group(each) == group for each in read) else ''}{group}")
    if parts:
        yield f"not read: {join_names(parts, 2 * _MAX_LISTED_NAMES)}"


def _group(name: str) -> str:
    return re.split(r"[.\[]", name, maxsplit=1)[0]
