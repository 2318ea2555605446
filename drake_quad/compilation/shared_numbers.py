"""Numbers that are the same for all vehicles at an instant: times, ticks of random streams, references."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from drake_quad.framework.formulas import TickOf


class NumberSource(NamedTuple):
    """An element of an output port that depends on the time alone.

    Attributes:
        path: of the leaf system.
        output: of its ports.
        element: of the port.
    """

    path: str
    output: int
    element: int


class _Second(NamedTuple):
    """Whether an instant is the second of a pair of ticks, as 1 or 0."""

    ticks: TickOf


# The time itself, the number of a pair of ticks, or an element of a source.
_What = str | TickOf | _Second | NumberSource
TIME_ITSELF = "time"


class SharedNumbers:
    """A table of numbers: a row for each event, a column for each number that its instants need."""

    def __init__(self) -> None:
        self._columns: dict[tuple[int, _What], int] = {}

    @property
    def width(self) -> int:
        """Numbers of a row."""
        return len(self._columns)

    def place(self, instant: int, what: _What) -> int:
        """The column of a number, which is added unless it is there.

        Args:
            instant: of the event, counted from its beginning.
            what: the number is.
        """
        return self._columns.setdefault((instant, what), len(self._columns))

    def second(self, instant: int, ticks: TickOf) -> int:
        """The column that says whether an instant is the second of a pair of ticks."""
        return self.place(instant, _Second(ticks))

    def table(self, times: np.ndarray, values: Callable[[str, int, float], np.ndarray]) -> np.ndarray:
        """The (events, width) numbers.

        Args:
            times: (events, instants) of the instants, s.
            values: of an output port at a time (s), given the path of the leaf system and the number of the port.
        """
        table = np.empty((len(times), max(1, self.width)))
        made: dict[tuple[int, str, int], np.ndarray] = {}
        for (instant, what), column in self._columns.items():
            at = times[:, instant]
            if isinstance(what, NumberSource):
                key = instant, what.path, what.output
                if key not in made:
                    made[key] = np.array([values(what.path, what.output, time) for time in at.tolist()])
                table[:, column] = made[key][:, what.element]
            else:
                table[:, column] = _at(what, at)
        return table


def _at(what: Any, times: np.ndarray) -> np.ndarray:
    match what:
        case TickOf():
            return np.asarray(what.at(times).pair)  # type: ignore[arg-type]
        case _Second(ticks=ticks):
            return np.asarray(ticks.at(times).second, dtype=float)  # type: ignore[arg-type]
    return times
