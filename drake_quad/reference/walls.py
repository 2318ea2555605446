"""Points at which the distance from a path to a corridor wall has a local minimum."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, inner_maxima, turning_points
from drake_quad.reference.regions import AXES, Box, Corridor, Polytope


class WallApproach(NamedTuple):
    """Point inside a segment at which the position reverses along a direction across the corridor.

    Attributes:
        segment: index of the segment.
        s: unit time on the segment, 0 to 1.
        wall: axis of a box, such as "x", or face of a polytope, such as "face 0".
        direction: (axes,) unit vector perpendicular to the wall.
        position: position along the direction, m.
        low: position of the lower wall along the direction, m; -inf for a face.
        high: position of the upper wall along the direction, m.
        size: largest extent of the corridor, m.
    """

    segment: int
    s: float
    wall: str
    direction: np.ndarray
    position: float
    low: float
    high: float
    size: float

    @property
    def clearance(self) -> float:
        """Distance from the position to the nearer of the two walls, m; negative beyond the wall."""
        return min(self.position - self.low, self.high - self.position)


def wall_approaches(path: PolynomialPath, corridors: Sequence[Corridor | None]) -> Iterator[WallApproach]:
    """Yield the points at which the distance from a path to a wall of its corridor has a local minimum.

    Args:
        path: path of the position.
        corridors: corridor of each segment, or None for a segment without a corridor.
    """
    if any(isinstance(corridor, Box) for corridor in corridors):
        yield from _approaches_in_boxes(path, corridors)
    if any(isinstance(corridor, Polytope) for corridor in corridors):
        yield from _approaches_at_faces(path, corridors)


def _approaches_in_boxes(path: PolynomialPath, corridors: Sequence[Corridor | None]) -> Iterator[WallApproach]:
    """Yield the points at which a path reverses along an axis, for boxes with an extent along this axis."""
    segments, axes, unit_times = turning_points(path)
    positions = evaluate_at(path, segments, unit_times)[np.arange(len(unit_times)), axes]
    directions = np.eye(path.coefficients.shape[2])
    for segment, axis, s, position in zip(segments, axes, unit_times, positions, strict=True):
        corridor = corridors[segment]
        if isinstance(corridor, Box) and corridor.low[axis] < corridor.high[axis]:
            low, high = float(corridor.low[axis]), float(corridor.high[axis])
            size = float((corridor.high - corridor.low).max())
            wall = AXES[axis] if len(directions) <= len(AXES) else f"axis {axis}"
            yield WallApproach(int(segment), float(s), wall, directions[axis], float(position), low, high, size)


def _approaches_at_faces(path: PolynomialPath, corridors: Sequence[Corridor | None]) -> Iterator[WallApproach]:
    """Yield the points at which the position along the outward normal of a face has a local maximum."""
    faces = [
        (segment, face, corridor)
        for segment, corridor in enumerate(corridors)
        if isinstance(corridor, Polytope)
        for face in range(corridor.faces)
    ]
    heights = np.array([path.coefficients[segment] @ corridor.normals[face] for segment, face, corridor in faces])
    rows, unit_times, positions = inner_maxima(heights)
    for row, s, position in zip(rows, unit_times, positions, strict=True):
        segment, face, corridor = faces[row]
        offset = float(corridor.offsets[face])
        normal = corridor.normals[face]
        yield WallApproach(segment, float(s), f"face {face}", normal, float(position), -np.inf, offset, corridor.size)
