"""Where a path comes nearest to the walls of its corridors."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.reference.path_problem import Box
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, turning_points


class Turn(NamedTuple):
    """A place inside a segment with a corridor, at which one axis of the position turns back.

    Attributes:
        segment: index.
        axis: index.
        s: place on the segment, 0 to 1.
        position: of that axis, m.
        low: the lower wall on that axis, m.
        high: the upper wall, m.
        size: the largest extent of the corridor, m.
    """

    segment: int
    axis: int
    s: float
    position: float
    low: float
    high: float
    size: float

    @property
    def room(self) -> float:
        """Distance to the nearer wall, m; negative beyond it."""
        return min(self.position - self.low, self.high - self.position)


def turns(path: PolynomialPath, corridors: Sequence[Box | None]) -> Iterator[Turn]:
    """Yields where a path turns back within corridors (segments) that leave it room on that axis."""
    if not any(corridors):
        return
    segments, axes, places = turning_points(path)
    positions = evaluate_at(path, segments, places)[np.arange(len(places)), axes]
    for segment, axis, s, position in zip(segments, axes, places, positions, strict=True):
        corridor = corridors[segment]
        if corridor is not None and corridor.low[axis] < corridor.high[axis]:
            low, high = float(corridor.low[axis]), float(corridor.high[axis])
            size = float((corridor.high - corridor.low).max())
            yield Turn(int(segment), int(axis), float(s), float(position), low, high, size)
