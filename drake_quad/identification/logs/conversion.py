"""Conversion of the columns of a log to a record with SI units, the frames of this library, and one clock."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError, listed
from drake_quad.identification.logs.attitudes import rotations
from drake_quad.identification.logs.consistency import contradictions
from drake_quad.identification.logs.doubts import doubts, jumps
from drake_quad.identification.logs.mapping import ATTITUDES, Mapping, SignalSource
from drake_quad.identification.logs.record import COLUMNS, QUANTITIES, FlightRecord
from drake_quad.identification.logs.timing import rising, timing_remarks
from drake_quad.identification.logs.units import UNITS
from drake_quad.scenario.files.marked_tree import Mark

# Signals that hold until their next sample, in addition to commands and references. All others are measurements, which
# are interpolated linearly.
_HELD_SIGNALS = ("motor_command", "thrust_share", "battery_voltage")
_ANGLE_SIGNALS = (*ATTITUDES, "reference_yaw")
# Signals that change slowly. They keep their first value before their first sample, and their last value afterwards.
_SLOW_SIGNALS = ("battery_voltage", "wind", "hover_share")
# Half a turn about x converts NED to NWU, and FRD to FLU.
_DOWNWARD_FRAMES = ("NED", "FRD")
_HALF_TURN = np.array([1.0, -1.0, -1.0])
_QUATERNION_TURN = np.array([1.0, 1.0, -1.0, -1.0])
# Range of the norm of a valid quaternion. Many logs begin with zeros.
_MIN_QUATERNION, _MAX_QUATERNION = 0.5, 2.0
# Plausible range of a motor command, relative to the full command. It is wide since a log need not state the range.
_COMMAND_RANGE = (-0.5, 1.5)
# Range of a command that was logged with 16 bits, with a tolerance for rounding.
_COMMAND_RANGE_16_BITS = (-1e-3, 1.001)
_MIN_COVERAGE = 0.5  # share of the time for which a signal must be logged
_MAX_VALUE = 1e9  # in any unit; larger values come from damaged data
_MAX_NAMES = 6  # largest number of columns that are listed in one sentence


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of a log on one clock: a CSV file, a topic or an event type.

    Attributes:
        name: name of the topic or event type.
        time: (n,) times at which the rows were written, s.
        columns: (n,) or (n, width) values by name; NaN for a cell that is not a number.
        sampled: (n,) times of the measurements, s; None if they are not logged.
    """

    name: str
    time: np.ndarray
    columns: dict[str, np.ndarray]
    sampled: np.ndarray | None = None


class _Channel(NamedTuple):
    """Signal on its own clock.

    Attributes:
        signal: name of the signal.
        clock: (n,) clock of the table, s; the same object for all signals that share it.
        rows: indices of the samples of the clock at which the signal is known.
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
    def whole(self) -> bool:
        """True if the signal is known at each sample of its clock."""
        return len(self.rows) == len(self.clock)


class _Clocks:
    """Clocks of the tables, with rising times."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.remarks: list[str] = []

    def of(self, table: Table, signal: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the rising times of the samples of a signal, s, and the indices of their rows in the table."""
        time = table.time if table.sampled is None or is_held(signal) else table.sampled
        if id(time) not in self._known:
            kept, remarks = rising(time)
            said = [f"{table.name}: {each}" if table.name else each for each in remarks]
            self.remarks += [each for each in said if each not in self.remarks]
            self._known[id(time)] = time[kept], np.flatnonzero(kept)
        return self._known[id(time)]


def is_held(signal: str) -> bool:
    """Return whether a signal holds until its next sample, as commands do."""
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

    The record has the clock of the fastest table that contains a signal. Measurements in other tables are interpolated
    linearly, and commands are held. The record begins when each of its signals has a sample.

    Args:
        tables: tables of the log.
        mapping: mapping from columns to signals.
        name: name of the log.
        mark: name of the log in error messages.
        remarks: remarks on the log from reading it.
        names: names of further columns in the log, which no table contains.

    Raises:
        InputError: if the log has no signal, or fewer than two samples at which all signals are known.
    """
    notes: list[str] = []
    tables = [_without_damage(table, mapping, notes) for table in tables]
    order = sorted(tables, key=lambda table: -len(table.time))
    available = {*names}.union(*(table.columns for table in tables))
    clocks = _Clocks()
    channels: list[_Channel] = []
    for signal in mapping.signals:
        channel = next(_channels(signal, mapping, order, clocks), None)
        if channel is not None:
            channels.append(channel)
        else:
            notes += _why_not(signal, mapping, available)
    if not channels:
        raise InputError(f"{mark}: has no signal with two samples or more; its columns are {listed(sorted(available))}")
    clock = _fastest(channels)
    chosen, left_out = _covering(channels, clock)
    if not chosen:
        raise InputError(f"{mark}: has no signal that is there for half of its time")
    lacking = {*(mapping.required or ())} - {channel.signal for channel in chosen}
    if lacking:
        raise InputError(f"{mark}: lacks {listed(sorted(lacking))}, which the mapping requires")
    inside, cut = _common(chosen, clock)
    if inside.sum() < 2:
        raise InputError(f"{mark}: its signals have less than two samples in common")
    time = clock[inside]
    signals: dict[str, Any] = {channel.signal: _at(channel, clock, inside) for channel in chosen}
    notes += _turn_crossed(signals, chosen)
    if not signals:
        raise InputError(f"{mark}: has no signal that can be used: {'; '.join(notes)}")
    wind = None if "wind" in signals else mapping.wind_of(name)
    if wind is not None:
        signals["wind"] = np.tile(wind, (len(time), 1))
        notes.append(f"wind is ({', '.join(f'{each:g}' for each in wind)}) m/s, by the name of the log")
    slow = (each for each in chosen if each.signal == "reference_position" and each.clock is not clock)
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
            *cut,
            *_origin_remarks(chosen),
            *_resampling_remarks(chosen, clock),
            *_missing_remarks(chosen),
            *left_out,
            *notes,
            *(
                each
                for channel in chosen
                if channel.signal == "position"
                for each in jumps(channel.time, channel.values)
            ),
            *doubts(signals, time - time[0]),
            *contradictions(signals, time),
            *_unread(
                available - ({mapping.time.column} if mapping.time else set()),
                {each for channel in chosen for each in channel.source.names},
            ),
        ),
    )


def _without_damage(table: Table, mapping: Mapping, notes: list[str]) -> Table:
    """Return the table without the rows whose motor commands are out of range, and add a remark on them to `notes`."""
    known = [
        each for each in mapping.signals.get("motor_command", ()) if all(name in table.columns for name in each.names)
    ]
    if not known or not len(table.time):
        return table
    with np.errstate(all="ignore"):  # damaged rows may contain any number
        commands = _values("motor_command", known[0], table)
        least, most = _COMMAND_RANGE_16_BITS if known[0].unit == "uint16" else _COMMAND_RANGE
        wrong = ((commands < least) | (commands > most)).any(axis=1)
    if not wrong.any():
        return table
    largest, first = float(np.nanmax(np.abs(commands[wrong]))), table.time[np.argmax(wrong)] - table.time[0]
    notes.append(
        f"{wrong.sum():,} of {len(wrong):,} samples are left out: their motor commands are out of range, up to"
        f" {largest:.3g} times the full command, first at {first:.4g} s; the log is damaged there"
    )
    columns = {name: values[~wrong] for name, values in table.columns.items()}
    return Table(table.name, table.time[~wrong], columns, None if table.sampled is None else table.sampled[~wrong])


def _channels(signal: str, mapping: Mapping, tables: Sequence[Table], clocks: _Clocks) -> Iterator[_Channel]:
    """Yield the channels of a signal from each of its sources, in the order of preference."""
    for source in mapping.signals[signal]:
        for table in tables:
            if not all(each in table.columns for each in source.names) or len(table.time) < 2:
                continue
            clock, numbers = clocks.of(table, signal)
            with np.errstate(all="ignore"):  # damaged rows may contain any number
                values = _values(signal, source, table)[numbers]
            if signal == "motor_command":
                values = np.clip(values, 0.0, 1.0)
            rows = np.flatnonzero((np.abs(values) < _MAX_VALUE).all(axis=1))
            if len(rows) > 1:
                yield _Channel(signal, clock, rows, values[rows], source)


def _values(signal: str, source: SignalSource, table: Table) -> np.ndarray:
    """Return the values (n, columns) of a signal in SI units and the frames of a record; NaN where it is unknown."""
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
    """Return roll, pitch and yaw (n, 3) of quaternions (n, 4) in the frames of a record; NaN for invalid ones."""
    quaternion = values if source.quaternion == "wxyz" else np.roll(values, 1, axis=1)
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    valid = (length > _MIN_QUATERNION) & (length < _MAX_QUATERNION)
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
    """Return the clock with the smallest median step among those of long measurements, or of all if there are none."""
    measured = [channel for channel in channels if not is_held(channel.signal)] or channels
    longest = max(channel.time[-1] - channel.time[0] for channel in measured)
    lasting = [each for each in measured if each.time[-1] - each.time[0] >= _MIN_COVERAGE * longest]
    return min((channel.clock for channel in lasting), key=lambda clock: float(np.median(np.diff(clock))))


def _covering(channels: Sequence[_Channel], clock: np.ndarray) -> tuple[list[_Channel], list[str]]:
    """Return the signals that are logged for enough of the time, and sentences on those that are left out."""
    chosen, remarks = [], []
    span = clock[-1] - clock[0]
    for channel in channels:
        end = clock[-1] if is_held(channel.signal) else min(channel.time[-1], clock[-1])
        share = 1.0 if channel.signal in _SLOW_SIGNALS else (end - max(channel.time[0], clock[0])) / span
        known = len(channel.rows) / len(channel.clock)
        if min(share, known) >= _MIN_COVERAGE:
            chosen.append(channel)
        else:
            remarks.append(
                f"{channel.signal} is left out: it is there for {max(min(share, known), 0.0):.0%} of the log"
            )
    return chosen, remarks


def _common(channels: Sequence[_Channel], clock: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return a mask of the samples of the clock at which all signals are known, and sentences on the others."""
    channels = [channel for channel in channels if channel.signal not in _SLOW_SIGNALS] or channels
    latest = max(channels, key=lambda channel: channel.time[0])
    measured = [channel for channel in channels if not is_held(channel.signal)]
    earliest = min(measured, key=lambda channel: channel.time[-1], default=latest)
    remarks = []
    inside = clock >= latest.time[0]
    if not inside.all():
        remarks.append(f"the first {latest.time[0] - clock[0]:.4g} s are left out: {latest.signal} is not there yet")
    if measured:
        within = clock <= earliest.time[-1]
        if not within.all():
            remarks.append(f"the last {clock[-1] - earliest.time[-1]:.4g} s are left out: {earliest.signal} has ended")
        inside &= within
    return inside, remarks


def _at(channel: _Channel, clock: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the values of a signal at the chosen samples of the clock."""
    if channel.clock is clock and channel.whole:
        values = channel.values[inside]
    else:
        time = clock[inside]
        if is_held(channel.signal):
            values = channel.values[np.maximum(np.searchsorted(channel.time, time, side="right") - 1, 0)]
        else:
            angles = channel.signal in _ANGLE_SIGNALS
            smooth = np.unwrap(channel.values, axis=0) if angles else channel.values
            values = np.column_stack([np.interp(time, channel.time, column) for column in smooth.T])
            if angles:
                values = np.arctan2(np.sin(values), np.cos(values))
    return values[:, 0] if COLUMNS[channel.signal] == 1 else values


def _turn_crossed(signals: dict[str, Any], channels: Sequence[_Channel]) -> Iterator[str]:
    """Turn signals from body to world axes, or vice versa, by the attitude, and yield a sentence on each."""
    for channel in channels:
        if not channel.source.is_crossed(channel.signal):
            continue
        to_world = QUANTITIES[channel.signal].frame == "W"
        of, to = ("body", "world") if to_world else ("world", "body")
        if "attitude" in signals:
            turned = rotations(signals["attitude"]).apply(signals[channel.signal], inverse=not to_world)
            signals[channel.signal] = turned
            yield f"{channel.signal} is turned from the axes of the {of} to those of the {to} by the attitude"
        else:
            del signals[channel.signal]
            yield f"{channel.signal} is left out: it is along the axes of the {of}, and no attitude is logged"


def _range(names: Sequence[str]) -> str:
    return f"{names[0]} to {names[-1]}" if len(names) > 1 else "".join(names)


def _origin_remarks(channels: Sequence[_Channel]) -> Iterator[str]:
    origins = [
        f"{channel.signal} from {_range(channel.source.names)}"
        + (f" ({channel.source.unit})" if channel.source.unit else "")
        for channel in channels
    ]
    yield f"read: {'; '.join(origins)}"


def _resampling_remarks(channels: Sequence[_Channel], clock: np.ndarray) -> Iterator[str]:
    rate = f"{1.0 / float(np.median(np.diff(clock))):.4g} Hz"
    for held, how in ((False, "interpolated linearly"), (True, "held constant between their samples")):
        rates = [
            f"{channel.signal} ({1.0 / float(np.median(np.diff(channel.time))):.3g} Hz)"
            for channel in channels
            if channel.clock is not clock and is_held(channel.signal) is held
        ]
        if rates:
            yield f"{how}, since the record has {rate}: {', '.join(rates)}"


def _missing_remarks(channels: Sequence[_Channel]) -> Iterator[str]:
    for channel in channels:
        if not channel.whole:
            count = len(channel.clock) - len(channel.rows)
            yield f"{channel.signal} is no number in {count:,} of {len(channel.clock):,} samples"


def _why_not(signal: str, mapping: Mapping, available: set[str]) -> Iterator[str]:
    """Yield a sentence if a signal is left out because it is logged incompletely, or because all its values are NaN."""
    for source in mapping.signals[signal]:
        missing = [each for each in source.names if each not in available]
        if not missing:
            kind = "a quaternion of length 1" if source.quaternion else "a number"
            yield f"{signal} is left out: {_range(source.names)} is {kind} in less than two samples"
            return
        if 0 < len(missing) < len(source.names):
            yield f"{signal} is left out: {listed(missing)} {'is' if len(missing) == 1 else 'are'} not logged"
            return


def _unread(available: set[str], used: set[str]) -> Iterator[str]:
    """Yield a sentence on the columns that are not read, grouped by the part of their names before the first dot."""
    groups: dict[str, list[str]] = {}
    for each in sorted(available - used):
        groups.setdefault(_group(each), []).append(each)
    parts = []
    for group, members in groups.items():
        if len(members) <= (_MAX_NAMES if any(_group(each) == group for each in used) else 1):
            parts += members
        else:
            parts.append(f"{'the rest of ' if any(_group(each) == group for each in used) else ''}{group}")
    if parts:
        yield f"not read: {listed(parts, 4 * _MAX_NAMES)}"


def _group(name: str) -> str:
    return re.split(r"[.\[]", name, maxsplit=1)[0]
