"""A plan: a route with times, as the trajectory that the controllers follow."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.reference.minimum_snap import PolynomialPath
from drake_quad.reference.routes import Leg


@dataclass(frozen=True)
class Plan:
    """Position over time and a constant yaw, at rest at both ends.

    After its end, and before its beginning, the reference hovers there.

    Attributes:
        path: the position in W.
        yaw: rad.
        legs: named parts of the route, for people to read.
    """

    path: PolynomialPath
    yaw: float = 0.0
    legs: tuple[Leg, ...] = ()

    @classmethod
    def hover(cls, position: ArrayLike, *, duration: float, yaw: float = 0.0) -> "Plan":
        """Returns the plan to stay at a position (3,) in m for a duration in s."""
        coefficients = np.zeros((1, 8, 3))
        coefficients[0, 0] = position
        return cls(PolynomialPath(np.array([0.0, duration]), coefficients), yaw, (Leg("hover", 0),))

    @property
    def duration(self) -> float:
        """Time from the first to the last waypoint, s."""
        return float(self.path.times[-1] - self.path.times[0])

    @property
    def waypoints(self) -> np.ndarray:
        """(segments + 1, 3) the points that the path passes, m."""
        coefficients = self.path.coefficients
        return np.vstack([coefficients[:, 0], coefficients[-1:].sum(axis=1)])

    def derivative(self, order: int) -> PiecewisePolynomial:
        """The (3, 1) trajectory of the position's derivative of that order, in m and s."""
        return to_piecewise_polynomial(path_derivative(self.path, order))

    @cached_property
    def reference(self) -> PiecewisePolynomial:
        """The (11, 1) trajectory of the `reference` port: position, velocity, acceleration, yaw, yaw rate."""
        parts = [path_derivative(self.path, order).coefficients for order in range(3)]
        yaw = np.zeros((len(self.path.coefficients), 8, 2))
        yaw[:, 0, 0] = self.yaw
        return to_piecewise_polynomial(PolynomialPath(self.path.times, np.concatenate([*parts, yaw], axis=2)))


def path_derivative(path: PolynomialPath, order: int) -> PolynomialPath:
    """Returns the path's derivative in time, with as many powers as the path."""
    powers = path.coefficients.shape[1]
    falling = np.array([math.perm(k, order) for k in range(powers)], dtype=float)
    coefficients = np.zeros_like(path.coefficients)
    coefficients[:, : powers - order] = (path.coefficients * falling[:, np.newaxis])[:, order:]
    return PolynomialPath(path.times, coefficients * (path.durations**-order)[:, np.newaxis, np.newaxis])


def to_piecewise_polynomial(path: PolynomialPath) -> PiecewisePolynomial:
    """Returns the path as Drake's (axes, 1) trajectory."""
    segments, powers, axes = path.coefficients.shape
    in_seconds = path.coefficients * path.durations[:, np.newaxis, np.newaxis] ** -np.arange(powers)[:, np.newaxis]
    columns = np.ascontiguousarray(in_seconds.transpose(0, 2, 1)).reshape(-1, powers)
    polynomials = np.empty(segments * axes, dtype=object)
    polynomials[:] = [Polynomial(column) for column in columns]
    return PiecewisePolynomial(list(polynomials.reshape(segments, axes, 1)), path.times)
