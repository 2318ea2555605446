"""The room in which is flown, and the solids in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from drake_quad.reference.regions import Box
from drake_quad.space.shapes import Shape


@dataclass(frozen=True)
class Obstacle:
    """A solid with a name.

    Attributes:
        name: for messages, tables and pictures.
        shape: where it is.
    """

    name: str
    shape: Shape


@dataclass(frozen=True)
class Space:
    """Obstacles, and the clearance that the vehicle's centre of mass keeps from them.

    Attributes:
        obstacles: solids.
        radius: radius of the vehicle around its centre of mass, m. A vehicle that is nearer to an obstacle has crashed.
        bounds: bounds of the centre of mass in plans; None if there are none.
        margin: additional clearance of plans, m.
        tracking: further clearance of plans for the predicted tracking error, m.
    """

    obstacles: tuple[Obstacle, ...]
    radius: float
    bounds: Box | None = None
    margin: float = 0.0
    tracking: float = 0.0

    @property
    def clearance(self) -> float:
        """How far a planned path keeps from obstacles, m."""
        return self.radius + self.margin + self.tracking

    @property
    def clearance_in_words(self) -> str:
        """What the clearance is made of."""
        parts = {"radius": self.radius, "margin": self.margin, "tracking": self.tracking}
        return " + ".join(f"{name} {share:.3g}" for name, share in parts.items() if share or name == "radius")

    @property
    def names(self) -> tuple[str, ...]:
        """Of the obstacles."""
        return tuple(obstacle.name for obstacle in self.obstacles)

    def nearest(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The distance (n,) to the nearest obstacle, m, and its number (n,), for points (n, 3).

        Without obstacles the distance is infinite and the number -1.
        """
        return nearest([obstacle.shape for obstacle in self.obstacles], points)


def nearest(shapes: Sequence[Shape], points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """The distance (n,) to the nearest solid, m, and its number (n,), for points (n, 3); infinity and -1 if none."""
    count = len(np.asarray(points))
    if not shapes:
        return np.full(count, np.inf), np.full(count, -1)
    distances = np.array([shape.distances(points) for shape in shapes])
    found = distances.argmin(axis=0)
    return distances[found, np.arange(count)], found
