"""Mapping language: the columns, units and frames of a log from which the signals of a record are read.

A mapping is a YAML file with these fields:

    description: logs of our laboratory
    delimiter: ","
    time: {column: t, unit: s}
    required: [position]                      # signals that a log must contain; by default all signals below
    signals:
      position: {columns: [x, y, z], unit: mm, frame: NED}
      velocity: {column: v}                   # cells such as "[0.1, 0.2, 0.3]"
      body_rates: {columns: [wx, wy, wz], frame: ENU}   # along world axes; turned to body axes by the attitude
      attitude: {column: q, quaternion: xyzw}
      motor_command:                          # the first source in the log is read
        - {columns: [m1, m2, m3, m4], unit: uint16}
        - {columns: [u1, u2, u3, u4], unit: "%", rotors: [1, 3, 4, 2]}
      wind: {columns: [w_x, w_y, 0.0]}        # a number is a constant column
    vehicle: vehicles/neural_fly:neural_fly   # shipped vehicle with which an identification can begin
    wind_by_name: {calm: [0, 0, 0], gale: [-18, 0, 0]}    # wind by the suffix of the log's name, if none is logged
"""

import functools
import importlib.resources
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.errors import InputError, join_names, short_repr
from drake_quad.logs.record import COLUMNS, QUANTITIES
from drake_quad.logs.units import UNITS
from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.loading import validate

# Signals that a log may contain as a quaternion.
ATTITUDES = ("attitude", "attitude_command")
WORLD_FRAMES = ("NWU", "ENU", "NED")
BODY_FRAMES = ("FLU", "FRD")
_NUM_ROTORS = 4
_NUM_QUATERNION_COMPONENTS = 4
_Path = tuple[str | int, ...]


class SignalSource(Model):
    """Columns of a log from which a signal is read."""

    columns: Annotated[tuple[str | Real, ...], Field(strict=False)] | None = Field(
        default=None,
        description="names of the columns, in the order of the signal's components; a number is a constant column",
    )
    column: str | None = Field(default=None, description='name of a single column with vectors as cells, "[a, b, c]"')
    unit: str | None = Field(default=None, description="unit of the columns; the SI unit if not given")
    factor: Real | Annotated[tuple[Real, ...], Field(strict=False)] = Field(
        default=1.0, description="additional factor of the values: one for all columns, or one for each column"
    )
    frame: Literal["NWU", "ENU", "FLU", "NED", "FRD"] | None = Field(
        default=None,
        description="frame of the columns, either a world frame (NWU, ENU, NED) or a body frame (FLU, FRD); NED and FRD"
        " are turned by 180° about x, and the attitude turns vectors between world and body axes if needed",
    )
    quaternion: Literal["wxyz", "xyzw"] | None = Field(
        default=None, description="order of the columns of a quaternion from body to world"
    )
    rotors: Annotated[tuple[Annotated[int, Field(ge=1, le=_NUM_ROTORS)], ...], Field(strict=False)] | None = Field(
        default=None, description="rotor number of each column; 1 is front right, then clockwise as seen from above"
    )
    missing: Real | None = Field(
        default=None, description="value, in the unit of the log, that replaces cells that are not a number"
    )

    def is_in_other_frame(self, signal: str) -> bool:
        """Return whether the columns are along the body axes and the signal is along the world axes, or vice versa."""
        signal_frame = QUANTITIES[signal].frame
        return (
            self.frame is not None and signal_frame is not None and (self.frame in BODY_FRAMES) != (signal_frame == "B")
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns that the log must contain."""
        if self.column is not None:
            return (self.column,)
        return tuple(each for each in self.columns or () if isinstance(each, str))


class TimeSource(Model):
    """Column of the clock."""

    column: str = Field(description="name of the column")
    unit: Literal["s", "ms", "us", "ns"] = Field(default="s", description="unit of the column")


def _as_list(sources: Any) -> Any:
    return [sources] if isinstance(sources, dict) else sources


_Sources = Annotated[tuple[SignalSource, ...], Field(strict=False, min_length=1), BeforeValidator(_as_list)]


class Mapping(Model):
    """Mapping from the columns of a log to the signals of a record."""

    description: str = Field(default="", description="description of the logs that the mapping reads")
    delimiter: Literal[",", ";", "\t", " "] = Field(
        default=",", description="character between the cells of a CSV file"
    )
    time: TimeSource | None = Field(default=None, description="column of the time; binary logs do not need it")
    by_name: bool = Field(default=False, description="true if the mapping is used only if it is selected by name")
    required: Annotated[tuple[str, ...], Field(strict=False)] | None = Field(
        default=None, description="signals that a log must contain; all signals of the mapping if not given"
    )
    signals: dict[str, _Sources] = Field(
        description="source of each signal of a record, or a list of sources, from which the first logged one is read"
    )

    vehicle: str | None = Field(
        default=None, description="FILE or FILE:NAME in diagrams/ of the vehicle with which an identification can begin"
    )
    wind_by_name: dict[str, Annotated[tuple[Real, Real, Real], Field(strict=False)]] = Field(
        default={}, description="wind in W, m/s, for logs that contain no wind, by the suffix of the log's name"
    )

    @model_validator(mode="before")
    @classmethod
    def _check_signals(cls, data: Any) -> Any:
        """Check each source against its signal.

        The check precedes the validation of the fields, so that an error can name the place in the file.
        """
        signals = data.get("signals") if isinstance(data, dict) else None
        if isinstance(signals, dict):
            for name, sources in signals.items():
                if name not in COLUMNS:
                    raise PydanticCustomError(
                        "unknown_field",
                        "is not a signal; signals are {allowed}",
                        {"path": ("signals", name), "fields": [*COLUMNS], "allowed": ", ".join(COLUMNS)},
                    )
                is_list = isinstance(sources, list)
                for i, source in enumerate(sources if is_list else [sources]):
                    if isinstance(source, dict):
                        _check(name, source, ("signals", name, i) if is_list else ("signals", name))
            for i, name in enumerate(_strings(data.get("required"))):
                if name not in signals:
                    raise _error(
                        ("required", i), "must be one of its signals, {allowed}", allowed=join_names([*signals])
                    )
        return data

    @property
    def names(self) -> set[str]:
        """Names of all columns in the mapping."""
        clock = {self.time.column} if self.time else set()
        return clock.union(*(source.names for name in self.signals for source in self.signals[name]))

    def wind_of(self, name: str) -> tuple[float, float, float] | None:
        """Return the wind, m/s, listed for the longest matching suffix of a log's name; None if no suffix matches."""
        suffixes = [suffix for suffix in self.wind_by_name if name.endswith(suffix)]
        return self.wind_by_name[max(suffixes, key=len)] if suffixes else None

    @property
    def rotors(self) -> tuple[int, ...] | None:
        """Order of the rotors in the first source that states one; None if no source states one."""
        return next((source.rotors for each in self.signals.values() for source in each if source.rotors), None)

    def with_rotors(self, rotors: tuple[int, ...]) -> "Mapping":
        """Return the mapping with another order of the rotors in each source that states an order."""
        signals = {
            name: tuple(
                source if source.rotors is None else source.model_copy(update={"rotors": rotors}) for source in sources
            )
            for name, sources in self.signals.items()
        }
        return self.model_copy(update={"signals": signals})

    def available_sources(self, available: set[str]) -> dict[str, SignalSource]:
        """Return the first source of each signal whose columns are all available, by the name of the signal."""
        sources = {}
        for name in self.signals:
            for source in self.signals[name]:
                if available.issuperset(source.names):
                    sources[name] = source
                    break
        return sources

    def fits(self, available: set[str]) -> bool:
        """Return whether the available columns contain the clock, all required signals, and at least one signal."""
        sources = self.available_sources(available)
        required = self.signals if self.required is None else self.required
        has_clock = self.time is None or self.time.column in available
        return has_clock and bool(sources) and all(name in sources for name in required)


def load_mapping(spec: str | Path) -> tuple[str, Mapping]:
    """Load a mapping.

    Args:
        spec: path of a YAML file, or name of a shipped mapping, see `shipped_mappings`.

    Returns:
        The name of the mapping, and the mapping.

    Raises:
        InputError: if there is no such mapping, or it contains an error. The message names the file, the line, the
            field, its value and the allowed values.
    """
    if spec in shipped_mappings():
        return str(spec), _load_shipped(str(spec))
    path = Path(spec)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(
            f"mapping {short_repr(str(spec))} is neither a YAML file nor a shipped mapping:"
            f" {', '.join(shipped_mappings())}"
        )
    return path.name, _load(path)


@functools.cache
def shipped_mappings() -> tuple[str, ...]:
    """Return the names of the mappings that are part of the library."""
    folder = importlib.resources.files("drake_quad.logs") / "mappings"
    return tuple(sorted(each.name.removesuffix(".yaml") for each in folder.iterdir() if each.name.endswith(".yaml")))


@functools.cache
def _load_shipped(name: str) -> Mapping:
    folder = importlib.resources.files("drake_quad.logs") / "mappings"
    with importlib.resources.as_file(folder / f"{name}.yaml") as path:
        return _load(path)


def _load(path: Path) -> Mapping:
    return validate(Mapping, Library().mapping(path))


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, list):
        yield from (each for each in value if isinstance(each, str))


def _check(name: str, source: dict[str, Any], path: _Path) -> None:
    """Raise an error if a source is not valid for its signal. The types of the fields are checked later."""
    source = {field: value for field, value in source.items() if value is not None}
    if ("columns" in source) == ("column" in source):
        raise _error(path, "must have either `columns` or `column`")
    _check_unit(name, source, path)
    _check_frame(name, source, path)
    if "quaternion" in source and name not in ATTITUDES:
        raise _error((*path, "quaternion"), "must not be given: {name} is not an attitude", name=name)
    if "rotors" in source and COLUMNS[name] != _NUM_ROTORS:
        raise _error(
            (*path, "rotors"), "must not be given: {name} is not a signal with one value for each rotor", name=name
        )
    width = _NUM_QUATERNION_COMPONENTS if "quaternion" in source else COLUMNS[name]
    for field in ("columns", "factor", "rotors"):
        values = source.get(field)
        if isinstance(values, list) and len(values) != width:
            raise _error((*path, field), "must have {width} entries", width=width)
    rotors = source.get("rotors")
    if isinstance(rotors, list) and sorted(map(str, rotors)) != [str(i + 1) for i in range(_NUM_ROTORS)]:
        raise _error((*path, "rotors"), "must contain each of 1, 2, 3 and 4 once")


def _check_unit(name: str, source: dict[str, Any], path: _Path) -> None:
    unit = source.get("unit")
    if not isinstance(unit, str):
        return
    if "quaternion" in source:
        raise _error((*path, "unit"), "must not be given: a quaternion has no unit")
    allowed = UNITS[QUANTITIES[name].unit]
    if unit not in allowed:
        raise _error((*path, "unit"), "must be {allowed}", allowed=" or ".join(allowed))


def _check_frame(name: str, source: dict[str, Any], path: _Path) -> None:
    frame = source.get("frame")
    if not isinstance(frame, str):
        return
    if name in ATTITUDES or name.endswith("yaw"):
        allowed: tuple[str, ...] = WORLD_FRAMES
    elif QUANTITIES[name].frame is None or COLUMNS[name] == 1:
        allowed = ()
    else:
        allowed = (*WORLD_FRAMES, *BODY_FRAMES)
    if not allowed:
        raise _error((*path, "frame"), "must not be given: {name} has no direction", name=name)
    if frame not in allowed:
        raise _error((*path, "frame"), "must be {allowed} for {name}", allowed=" or ".join(allowed), name=name)


def _error(path: _Path, demand: Any, **context: Any) -> PydanticCustomError:
    return PydanticCustomError("mapping", demand, {**context, "path": path})
