"""What binds a path: the limits it attains and the corridors it touches."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.polynomial_path import PolynomialPath, norm_peaks
from drake_quad.reference.regions import Corridor
from drake_quad.reference.walls import turns

# A limit is attained, and a corridor touched, within this share of the limit or of the corridor's largest extent.
_ATTAINED = 1e-3


class Binding(NamedTuple):
    """Where a path can go no faster, or no further.

    Attributes:
        what: "speed", "acceleration" or "corridor".
        where: the side of the corridor, as in "y max", or its "face 0"; empty for a limit.
        segment: index.
        time: s.
    """

    what: str
    where: str
    segment: int
    time: float


def bindings(path: PolynomialPath, limits: PathLimits, corridors: Sequence[Corridor | None] = ()) -> list[Binding]:
    """Returns what binds a path, in order of time.

    Args:
        path: of the position.
        limits: on its speed and acceleration.
        corridors: (segments), if it has any.
    """
    found = [*_attained(path, limits), *_touched(path, corridors)]
    return sorted(found, key=lambda binding: binding.time)


def _attained(path: PolynomialPath, limits: PathLimits) -> list[Binding]:
    found = []
    for order, limit in limits.by_order.items():
        peaks = norm_peaks(path, order)
        for i in np.flatnonzero(peaks.norm >= (1.0 - _ATTAINED) * limit):
            segment, s = int(peaks.segment[i]), float(peaks.s[i])
            found.append(Binding(("speed", "acceleration")[order - 1], "", segment, _time(path, segment, s)))
    return found


def _touched(path: PolynomialPath, corridors: Sequence[Corridor | None]) -> list[Binding]:
    found = []
    for turn in turns(path, corridors):
        for side, room in (("min", turn.position - turn.low), ("max", turn.high - turn.position)):
            if room < _ATTAINED * turn.size:
                # The lower wall of a face is infinitely far.
                where = f"{turn.wall} {side}" if np.isfinite(turn.low) else turn.wall
                found.append(Binding("corridor", where, turn.segment, _time(path, turn.segment, turn.s)))
    return found


def _time(path: PolynomialPath, segment: int, s: float) -> float:
    return float(path.times[segment] + s * (path.times[segment + 1] - path.times[segment]))
