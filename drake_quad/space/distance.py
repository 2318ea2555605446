"""How near a path comes to obstacles, anywhere between its samples."""

from typing import NamedTuple

import numpy as np

from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, norm_peaks
from drake_quad.space.space import Space

# The least distance is found to this, m.
_TOLERANCE = 1e-5
# Pieces into which a segment is cut at first.
_PIECES = 32


class Approach(NamedTuple):
    """Where a path comes nearest to an obstacle.

    Attributes:
        distance: of the centre of mass from the surface, m; negative inside.
        time: when, s.
        position: (3,) where, m.
        obstacle: its name.
    """

    distance: float
    time: float
    position: np.ndarray
    obstacle: str

    def __str__(self) -> str:
        place = ", ".join(f"{each:.3g}" for each in self.position)
        return f"{max(self.distance, 0.0):.3g} m from {self.obstacle} at {self.time:.2f} s, ({place}) m"


def nearest_approach(path: PolynomialPath, space: Space) -> Approach | None:
    """Where a path comes nearest to an obstacle, to a hundredth of a millimetre; None if there are no obstacles.

    A piece of a path is no longer than its duration at the segment's top speed, and no distance changes faster than the
    place: pieces that cannot hold the least are put away, and the others halved.
    """
    if not space.obstacles:
        return None
    peaks = norm_peaks(path, 1)
    top = np.zeros(len(path.durations))
    np.maximum.at(top, peaks.segment, peaks.norm)
    lengths = top * path.durations
    segment = np.repeat(np.arange(len(lengths)), _PIECES)
    middle, half = np.tile((np.arange(_PIECES) + 0.5) / _PIECES, len(lengths)), 0.5 / _PIECES
    best, place, name = np.inf, (0, 0.0), ""
    while len(segment):
        distance, number = space.nearest(evaluate_at(path, segment, middle))
        least = int(distance.argmin())
        if distance[least] < best:
            best, place = float(distance[least]), (int(segment[least]), float(middle[least]))
            name = space.names[int(number[least])]
        keep = distance - half * lengths[segment] < best - _TOLERANCE
        segment, middle, half = np.repeat(segment[keep], 2), np.repeat(middle[keep], 2), 0.5 * half
        middle[::2] -= half
        middle[1::2] += half
    where, s = place
    position = evaluate_at(path, np.array([where]), np.array([s]))[0]
    return Approach(best, float(path.times[where] + s * path.durations[where]), position, name)
