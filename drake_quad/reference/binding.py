"""What binds a path: the limits it attains and the corridors it touches."""

from typing import NamedTuple

import numpy as np

from drake_quad.reference.path_problem import AXES, Box, Limits
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, norm_peaks, turning_points

# A limit is attained, and a corridor touched, within this share of the limit or of the corridor's largest extent.
_ATTAINED = 1e-3


class Binding(NamedTuple):
    """Where a path can go no faster, or no further.

    Attributes:
        what: "speed", "acceleration" or "corridor".
        where: the side of the corridor, as in "y max"; empty for a limit.
        segment: index.
        time: s.
    """

    what: str
    where: str
    segment: int
    time: float


def bindings(path: PolynomialPath, limits: Limits, corridors: tuple[Box | None, ...] | None = None) -> list[Binding]:
    """Returns what binds a path, in order of time.

    Args:
        path: of the position.
        limits: on its speed and acceleration.
        corridors: (segments), if it has any.
    """
    found = [*_attained(path, limits), *(_touched(path, corridors) if corridors else [])]
    return sorted(found, key=lambda binding: binding.time)


def _attained(path: PolynomialPath, limits: Limits) -> list[Binding]:
    found = []
    for order, limit in limits.by_order.items():
        peaks = norm_peaks(path, order)
        for i in np.flatnonzero(peaks.norm >= (1.0 - _ATTAINED) * limit):
            segment, s = int(peaks.segment[i]), float(peaks.s[i])
            found.append(Binding(("speed", "acceleration")[order - 1], "", segment, _time(path, segment, s)))
    return found


def _touched(path: PolynomialPath, corridors: tuple[Box | None, ...]) -> list[Binding]:
    found = []
    segments, axes, places = turning_points(path)
    positions = evaluate_at(path, segments, places)[np.arange(len(places)), axes]
    for segment, axis, s, position in zip(segments, axes, places, positions, strict=True):
        corridor = corridors[segment]
        if corridor is None or corridor.low[axis] == corridor.high[axis]:
            continue
        tolerance = _ATTAINED * float((corridor.high - corridor.low).max())
        for side, room in (("min", position - corridor.low[axis]), ("max", corridor.high[axis] - position)):
            if room < tolerance:
                time = _time(path, int(segment), float(s))
                found.append(Binding("corridor", f"{AXES[axis]} {side}", int(segment), time))
    return found


def _time(path: PolynomialPath, segment: int, s: float) -> float:
    return float(path.times[segment] + s * (path.times[segment + 1] - path.times[segment]))
