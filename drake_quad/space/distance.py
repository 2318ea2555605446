"""Smallest distance of a path from obstacles, including all points between samples."""

from typing import NamedTuple

import numpy as np

from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, norm_peaks
from drake_quad.space.space import Space

# Accuracy with which the smallest distance is computed, m.
_DISTANCE_TOLERANCE = 1e-5
# Number of pieces into which a segment is divided initially.
_INITIAL_PIECES = 32


class NearestApproach(NamedTuple):
    """Point at which a path comes nearest to an obstacle.

    Attributes:
        distance: distance of the centre of mass from the surface, m; negative inside.
        time: time of the point, s.
        position: (3,) position of the point, m.
        obstacle: name of the obstacle.
    """

    distance: float
    time: float
    position: np.ndarray
    obstacle: str

    def __str__(self) -> str:
        location = ", ".join(f"{each:.3g}" for each in self.position)
        return f"{max(self.distance, 0.0):.3g} m from {self.obstacle} at {self.time:.2f} s, ({location}) m"


def nearest_approach(path: PolynomialPath, space: Space) -> NearestApproach | None:
    """Return the point at which a path comes nearest to an obstacle, or None if there are no obstacles.

    The distance is accurate to a hundredth of a millimetre. The method is branch and bound. The length of a piece of
    the path is at most its duration times the largest speed on its segment. Along the piece, the distance from an
    obstacle changes by at most this length. Pieces that cannot contain the minimum are discarded, and all other pieces
    are halved.
    """
    if not space.obstacles:
        return None
    peaks = norm_peaks(path, 1)
    top = np.zeros(len(path.durations))
    np.maximum.at(top, peaks.segment, peaks.norm)
    lengths = top * path.durations
    segment = np.repeat(np.arange(len(lengths)), _INITIAL_PIECES)
    middle, half = np.tile((np.arange(_INITIAL_PIECES) + 0.5) / _INITIAL_PIECES, len(lengths)), 0.5 / _INITIAL_PIECES
    best, location, name = np.inf, (0, 0.0), ""
    while len(segment):
        distance, number = space.nearest(evaluate_at(path, segment, middle))
        nearest = int(distance.argmin())
        if distance[nearest] < best:
            best, location = float(distance[nearest]), (int(segment[nearest]), float(middle[nearest]))
            name = space.names[int(number[nearest])]
        is_candidate = distance - half * lengths[segment] < best - _DISTANCE_TOLERANCE
        segment, middle, half = np.repeat(segment[is_candidate], 2), np.repeat(middle[is_candidate], 2), 0.5 * half
        middle[::2] -= half
        middle[1::2] += half
    best_segment, s = location
    position = evaluate_at(path, np.array([best_segment]), np.array([s]))[0]
    return NearestApproach(best, float(path.times[best_segment] + s * path.durations[best_segment]), position, name)
