"""Where a path comes nearest to the walls of its corridors."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, summits, turning_points
from drake_quad.reference.regions import AXES, Box, Corridor, Polytope


class Turn(NamedTuple):
    """A place inside a segment with a corridor, at which the position turns back along a direction.

    Attributes:
        segment: index.
        s: place on the segment, 0 to 1.
        wall: the name of the axis of a box, "x", or of the face of a polytope, "face 0".
        direction: (axes,) unit vector across the walls.
        position: along it, m.
        low: the lower wall on that axis, m; -inf for a face.
        high: the upper wall, m.
        size: the largest extent of the corridor, m.
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
    def room(self) -> float:
        """Distance to the nearer wall, m; negative beyond it."""
        return min(self.position - self.low, self.high - self.position)


def turns(path: PolynomialPath, corridors: Sequence[Corridor | None]) -> Iterator[Turn]:
    """Yields where a path turns back within corridors (segments) that leave it room in that direction."""
    if any(isinstance(corridor, Box) for corridor in corridors):
        yield from _turns_in_boxes(path, corridors)
    if any(isinstance(corridor, Polytope) for corridor in corridors):
        yield from _turns_at_faces(path, corridors)


def _turns_in_boxes(path: PolynomialPath, corridors: Sequence[Corridor | None]) -> Iterator[Turn]:
    segments, axes, places = turning_points(path)
    positions = evaluate_at(path, segments, places)[np.arange(len(places)), axes]
    directions = np.eye(path.coefficients.shape[2])
    for segment, axis, s, position in zip(segments, axes, places, positions, strict=True):
        corridor = corridors[segment]
        if isinstance(corridor, Box) and corridor.low[axis] < corridor.high[axis]:
            low, high = float(corridor.low[axis]), float(corridor.high[axis])
            size = float((corridor.high - corridor.low).max())
            wall = AXES[axis] if len(directions) <= len(AXES) else f"axis {axis}"
            yield Turn(int(segment), float(s), wall, directions[axis], float(position), low, high, size)


def _turns_at_faces(path: PolynomialPath, corridors: Sequence[Corridor | None]) -> Iterator[Turn]:
    """Yields where a path is farthest out along the normal of a face."""
    faces = [
        (segment, face, corridor)
        for segment, corridor in enumerate(corridors)
        if isinstance(corridor, Polytope)
        for face in range(corridor.faces)
    ]
    heights = np.array([path.coefficients[segment] @ corridor.normals[face] for segment, face, corridor in faces])
    rows, places, positions = summits(heights)
    for row, s, position in zip(rows, places, positions, strict=True):
        segment, face, corridor = faces[row]
        offset = float(corridor.offsets[face])
        normal = corridor.normals[face]
        yield Turn(segment, float(s), f"face {face}", normal, float(position), -np.inf, offset, corridor.size)
