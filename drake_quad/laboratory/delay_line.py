"""Whole ticks of delay for a sampled signal."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from drake_quad.compiled import compiled
from drake_quad.elementary import Row, plain, where
from drake_quad.fleet import FleetSystem


class DelayLine:
    """The discrete-state groups of a system in which a signal waits for its time.

    What is sampled at a tick is out `delay` ticks later, and stays out until the next one is:

        tick            0          1          2
        sampled         u₀         u₁         u₂
        1 tick of delay initial    u₀         u₁

    The groups are one for what is out, `out`, then those under way, the newest first. If there can be any delay, it is
    a numeric parameter of the context, one row; none there may be longer than the longest at construction.

    Args:
        system: that the groups are declared in.
        name: of the group that is out; the others are called after their age.
        initial: rows that are out before the first sample is.
        delay: in whole ticks; a number, or an (N,) array for a fleet.
        longest: that a delay in the context will ever be; the longest of these if not given.
    """

    def __init__(
        self, system: FleetSystem, name: str, initial: Iterable[Row], delay: Row, longest: int | None = None
    ) -> None:
        self._system = system
        initial = list(initial)
        self.out = system.discrete_state(name, initial)
        longest = int(np.max(delay)) if longest is None else longest
        self._under_way = [system.discrete_state(f"{name}_{i}_ticks_old", initial) for i in range(longest)]
        self._delay = system.numeric_parameter([delay]) if self._under_way else None

    def newest(self, context: Any) -> Any:
        """The vector that was sampled last."""
        return context.get_discrete_state(self._under_way[0] if self._under_way else self.out)

    def fill(self, discrete_state: Any) -> None:
        """Puts what is out everywhere on the line."""
        for group in self._under_way:
            self._system.copy(discrete_state.get_mutable_vector(group), discrete_state.get_vector(self.out))

    def advance(self, context: Any, discrete_state: Any) -> Any:
        """Moves everything under way on by a tick, and returns the vector to write the new sample into.

        Args:
            context: of the system.
            discrete_state: of its discrete update.
        """
        for ahead, behind in zip(self._under_way[:0:-1], self._under_way[-2::-1], strict=True):
            self._system.copy(discrete_state.get_mutable_vector(ahead), context.get_discrete_state(behind))
        return discrete_state.get_mutable_vector(self._under_way[0] if self._under_way else self.out)

    def release(self, context: Any, discrete_state: Any) -> None:
        """Lets out what has waited for its time, once the new sample is written; arguments as for `advance`."""
        if self._delay is None:
            return
        vector, system = discrete_state.get_mutable_vector, self._system
        delay = plain(system.parameter_rows(context, self._delay)[0])
        if delay.__class__ is float:
            source = (
                context.get_discrete_state(self._under_way[int(delay) - 1]) if delay else vector(self._under_way[0])
            )
            system.copy(vector(self.out), source)
            return
        out = system.values_to_change(vector(self.out))
        put_aged(out, delay, system.values(vector(self._under_way[0])), 0)
        for ticks in range(1, len(self._under_way) + 1):
            put_aged(out, delay, system.values(context.get_discrete_state(self._under_way[ticks - 1])), ticks)
        if system.scalar is not float:
            vector(self.out).SetFromVector(out)


@compiled
def put_aged(out: np.ndarray, delay: np.ndarray, aged: np.ndarray, ticks: int) -> None:
    """Lets out what was sampled so many ticks ago, rows of N, for vehicles with that delay (N,)."""
    n = len(delay)
    for first in range(0, len(out), n):
        row, source = out[first : first + n], aged[first : first + n]
        for i in range(n):
            row[i] = where(delay[i] == ticks, source[i], row[i])
