"""Values that all vehicles share at an instant: the time, the ticks of random streams, and the reference."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from drake_quad.framework.formulas import CurrentTick


class SharedValueSource(NamedTuple):
    """Element of an output port that depends only on time.

    Attributes:
        path: path of the leaf system.
        output: index of the output port.
        element: index of the element.
    """

    path: str
    output: int
    element: int


class _SecondOfPair(NamedTuple):
    """Shared value that is 1 if an instant is the second of the two ticks of a pair, else 0.

    Random streams number ticks in pairs; see `Tick`.
    """

    ticks: CurrentTick


# A shared value is the time, the number of a pair of ticks, the position of a tick in its pair (see `Tick`), or an
# element of a port.
_SharedValue = str | CurrentTick | _SecondOfPair | SharedValueSource
TIME_VALUE = "time"
"""Shared value that is the time of the instant, s."""


class SharedValues:
    """Columns of a table of shared values. A row is an event, and a column is one value at one instant of the event."""

    def __init__(self) -> None:
        self._columns: dict[tuple[int, _SharedValue], int] = {}

    @property
    def width(self) -> int:
        """Number of columns of the table."""
        return len(self._columns)

    def column(self, instant: int, value: _SharedValue) -> int:
        """Return the index of a value's column; the column is added if it does not exist.

        Args:
            instant: index of the instant in the event.
            value: shared value in the column.
        """
        return self._columns.setdefault((instant, value), len(self._columns))

    def second(self, instant: int, ticks: CurrentTick) -> int:
        """Return the index of the column that is 1 where the instant is the second tick of a pair, else 0."""
        return self.column(instant, _SecondOfPair(ticks))

    def table(self, times: np.ndarray, values: Callable[[str, int, float], np.ndarray]) -> np.ndarray:
        """Return the table of the shared values of several events, an array (events, width).

        Args:
            times: (events, instants) times of the instants, s.
            values: function that returns an output port's value, given the path of its leaf system, its index, and the
                time (s).
        """
        table = np.empty((len(times), max(1, self.width)))
        port_values: dict[tuple[int, str, int], np.ndarray] = {}
        for (instant, value), column in self._columns.items():
            event_times = times[:, instant]
            if isinstance(value, SharedValueSource):
                key = instant, value.path, value.output
                if key not in port_values:
                    port = value.path, value.output
                    port_values[key] = np.array([values(*port, time) for time in event_times.tolist()])
                table[:, column] = port_values[key][:, value.element]
            else:
                table[:, column] = _values_at(value, event_times)
        return table


def _values_at(value: Any, times: np.ndarray) -> np.ndarray:
    match value:
        case CurrentTick():
            return np.asarray(value.at(times).pair)  # type: ignore[arg-type]
        case _SecondOfPair(ticks=ticks):
            return np.asarray(ticks.at(times).second, dtype=float)  # type: ignore[arg-type]
    return times
