"""Plans: the position and yaw over time that controllers follow."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.reference.polynomial_path import PolynomialPath, path_derivative, subdivide
from drake_quad.reference.rest import moves_at_end, with_rest
from drake_quad.reference.routes import Leg
from drake_quad.reference.yaw import constant_yaw
from drake_quad.signals import SIGNALS, Jerk, Reference, Snap

PATH_ORDERS = 4
"""Number of continuous derivatives of the position where a reference comes to rest, including order zero."""
YAW_ORDERS = 2
"""Number of continuous derivatives of the yaw where a reference comes to rest, including order zero."""
# Acceleration that braking may use even if the route needs less, m/s². It is the paper's acceleration limit.
_BRAKING_ACCELERATION = 0.7
# Angular acceleration that braking of the yaw may use, rad/s². With this value, a yaw rate of 1 rad/s ends within two
# seconds.
_YAW_BRAKING_ACCELERATION = 1.0

REFERENCE_PORTS = {name: SIGNALS[name] for name in ("reference", "reference_jerk", "reference_snap")}
"""Type of the signal at each output port of a reference."""


@dataclass(frozen=True)
class Plan:
    """Position and yaw as functions of time.

    The reference hovers before the start and after the end of the path: position and yaw are constant, and all
    derivatives are zero. If the path ends in motion, the reference brakes first; see `drake_quad.reference.rest`.

    Attributes:
        path: path of the position in W.
        yaw: path of the yaw over the same time, with one axis, rad.
        legs: named parts of the route, for display.
        laps: start times of the laps and end time of the last lap, s; empty for a route without laps.
    """

    path: PolynomialPath
    yaw: PolynomialPath
    legs: tuple[Leg, ...] = ()
    laps: tuple[float, ...] = ()

    @classmethod
    def with_constant_yaw(
        cls, path: PolynomialPath, yaw: float = 0.0, legs: tuple[Leg, ...] = (), laps: tuple[float, ...] = ()
    ) -> "Plan":
        """Return the plan that follows a path with a constant yaw (rad)."""
        return cls(path, constant_yaw(path.times[0], path.times[-1], yaw), legs, laps)

    @classmethod
    def hover(cls, position: ArrayLike, *, duration: float, yaw: float = 0.0) -> "Plan":
        """Return the plan that stays at a position (3,), m, for a duration, s."""
        coefficients = np.zeros((1, 8, 3))
        coefficients[0, 0] = position
        return cls.with_constant_yaw(PolynomialPath(np.array([0.0, duration]), coefficients), yaw, (Leg("hover", 0),))

    @property
    def duration(self) -> float:
        """Time from the first to the last waypoint, s."""
        return self.path.duration

    @cached_property
    def extended_path(self) -> PolynomialPath:
        """Path that is at rest before its start and after its end. A path that ends in motion brakes first."""
        return with_rest(self.path, orders=PATH_ORDERS, acceleration=_BRAKING_ACCELERATION)

    @cached_property
    def extended_yaw(self) -> PolynomialPath:
        """Yaw that is constant before its start and after its end. A yaw that ends in motion brakes first."""
        return with_rest(self.yaw, orders=YAW_ORDERS, acceleration=_YAW_BRAKING_ACCELERATION)

    @property
    def brakes(self) -> bool:
        """True if the path or the yaw ends in motion, so that the reference brakes after the route."""
        return moves_at_end(self.path, PATH_ORDERS) or moves_at_end(self.yaw, YAW_ORDERS)

    @property
    def rest_time(self) -> float:
        """Time after which the reference stays at rest, s."""
        return max(float(part.times[-2]) for part in (self.extended_path, self.extended_yaw))

    @property
    def lap_times(self) -> tuple[float, ...]:
        """Start times of the laps and end time of the last lap, s; a route without laps counts as one lap."""
        return self.laps or (float(self.path.times[0]), float(self.path.times[-1]))

    @property
    def leg_times(self) -> list[float]:
        """Start times of the legs of the plan, s."""
        return [float(self.path.times[leg.first]) for leg in self.legs]

    @property
    def waypoints(self) -> np.ndarray:
        """(segments + 1, 3) points at which the segments of the path begin and end, m."""
        return self.path.waypoints

    @property
    def initial_yaw(self) -> float:
        """Yaw of the reference at the beginning of the plan, rad."""
        return float(self.yaw.coefficients[0, 0, 0])

    def derivative(self, order: int) -> PiecewisePolynomial:
        """Return a derivative of the position as a Drake (3, 1) trajectory in m and s, defined for all times.

        Args:
            order: order of the derivative, 0 for the position itself.
        """
        return to_piecewise_polynomial(path_derivative(self.extended_path, order))

    def reference(self) -> PiecewisePolynomial:
        """Return a trajectory, defined for all times, with the components of all `REFERENCE_PORTS` in order."""
        end = max(self.extended_path.times[-1], self.extended_yaw.times[-1])
        path, yaw = (_extend_rest(end, part) for part in (self.extended_path, self.extended_yaw))
        path, yaw = subdivide(path, yaw.times), subdivide(yaw, path.times)
        position, velocity, acceleration, jerk, snap = (_by_axis(path_derivative(path, order)) for order in range(5))
        (angle,), (rate,), (angular_acceleration,) = (_by_axis(path_derivative(yaw, order)) for order in range(3))
        rows: list[Any] = [
            *Reference._make([*position, *velocity, *acceleration, angle, rate]),
            *Jerk._make(jerk),
            *Snap._make([*snap, angular_acceleration]),
        ]
        return _piecewise_polynomial(path.times, rows)


def to_piecewise_polynomial(path: PolynomialPath) -> PiecewisePolynomial:
    """Return the path as Drake's (axes, 1) trajectory."""
    return _piecewise_polynomial(path.times, _by_axis(path))


def _extend_rest(end: float, path: PolynomialPath) -> PolynomialPath:
    """Extend the last piece of a path, in which it is at rest, to a given time (s)."""
    return path._replace(times=np.append(path.times[:-1], end))


def _by_axis(path: PolynomialPath) -> np.ndarray:
    """Return the coefficients of a path's polynomials as an (axes, segments, powers) array."""
    return path.coefficients.transpose(2, 0, 1)


def _piecewise_polynomial(times: np.ndarray, rows: Iterable[np.ndarray]) -> PiecewisePolynomial:
    """Return Drake's (rows, 1) trajectory, given the (segments, powers) coefficients of each component in unit time."""
    durations = np.diff(times)[:, np.newaxis]
    segments = len(durations)
    rows = list(rows)
    matrix = np.empty((segments, len(rows), 1), dtype=object)
    for i, coefficients in enumerate(rows):
        in_seconds = coefficients * durations ** -np.arange(coefficients.shape[1])
        matrix[:, i, 0] = [Polynomial(row) for row in in_seconds]
    return PiecewisePolynomial(list(matrix), times)
