"""Collisions with obstacles."""

import numpy as np
from pydrake.math import RollPitchYaw


class Obstacles:
    """Obstacles of a scenario, and the radius of the ball around the vehicle's centre of mass."""

    def __init__(self, scenario):
        space = scenario.space
        self.solids = [] if space is None else [*space.obstacles.values()]
        self.radius = 0.0
        if space is not None:
            nominal = scenario.nominal
            self.radius = nominal.arm_length if space.radius is None else space.radius

    def touch(self, position):
        """Return whether an obstacle is within the radius around a position."""
        return any(distance(solid, position) < self.radius for solid in self.solids)


def distance(solid, position):
    """Return the distance from a position to the nearest point of a solid; zero inside.

    The nearest point of a box or a cylinder is found by clipping coordinates, and the nearest point of a hull by
    `distance_to_hull`.
    """
    if solid.kind == "sphere":
        return max(0.0, np.linalg.norm(position - np.array(solid.centre)) - solid.radius)
    rotation = RollPitchYaw(np.array(solid.rotation)).ToRotationMatrix().matrix()
    local = rotation.T @ (position - np.array(solid.centre))
    if solid.kind == "box":
        half = 0.5 * np.array(solid.size)
        return np.linalg.norm(local - np.clip(local, -half, half))
    if solid.kind == "cylinder":
        nearest = local.copy()
        nearest[2] = np.clip(local[2], -0.5 * solid.height, 0.5 * solid.height)
        nearest[0:2] *= min(1.0, solid.radius / max(np.linalg.norm(local[0:2]), 1e-300))
        return np.linalg.norm(local - nearest)
    return distance_to_hull(solid.scale * np.array(solid.points), local)


def distance_to_hull(points, p, iterations=2000):
    """Return the distance from p to the convex hull of points, by Gilbert's algorithm.

    Each step moves towards the point of the hull that is farthest in the direction of p.
    """
    nearest = points[0]
    for _ in range(iterations):
        support = points[np.argmax(points @ (p - nearest))]
        step = support - nearest
        if (p - nearest) @ step <= 1e-12:
            break
        nearest = nearest + np.clip((p - nearest) @ step / (step @ step), 0.0, 1.0) * step
    return np.linalg.norm(p - nearest)
