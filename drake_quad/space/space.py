"""Obstacles, bounds and clearance for planning and crash detection."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from drake_quad.reference.regions import Box
from drake_quad.space.shapes import Shape


@dataclass(frozen=True)
class Obstacle:
    """Solid with a name.

    Attributes:
        name: name in messages, tables and pictures.
        shape: shape and position of the solid.
    """

    name: str
    shape: Shape


@dataclass(frozen=True)
class Space:
    """Obstacles, and the clearance between them and the vehicle's centre of mass.

    Attributes:
        obstacles: solids.
        radius: radius of the vehicle around its centre of mass, m. The vehicle has crashed if its centre is closer to
            an obstacle.
        bounds: bounds of the centre of mass in plans; None for no bounds.
        margin: clearance that plans keep in addition to the radius, m.
        tracking: further clearance that plans keep for the predicted tracking error, m.
    """

    obstacles: tuple[Obstacle, ...]
    radius: float
    bounds: Box | None = None
    margin: float = 0.0
    tracking: float = 0.0

    @property
    def clearance(self) -> float:
        """Smallest allowed distance between a planned path and obstacles, m."""
        return self.radius + self.margin + self.tracking

    @property
    def clearance_text(self) -> str:
        """Sum that makes up the clearance, such as "radius 0.2 + margin 0.1"."""
        parts = {"radius": self.radius, "margin": self.margin, "tracking": self.tracking}
        return " + ".join(f"{name} {fraction:.3g}" for name, fraction in parts.items() if fraction or name == "radius")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the obstacles."""
        return tuple(obstacle.name for obstacle in self.obstacles)

    def nearest(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance (n,) from the nearest obstacle, m, and its index (n,), for points (n, 3), m.

        If there are no obstacles, the distances are infinite and the indices are -1.
        """
        return nearest([obstacle.shape for obstacle in self.obstacles], points)


def nearest(shapes: Sequence[Shape], points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance (n,) from the nearest solid, m, and its index (n,), for points (n, 3), m.

    If there are no solids, the distances are infinite and the indices are -1.
    """
    count = len(np.asarray(points))
    if not shapes:
        return np.full(count, np.inf), np.full(count, -1)
    distances = np.array([shape.distances(points) for shape in shapes])
    indices = distances.argmin(axis=0)
    return distances[indices, np.arange(count)], indices
