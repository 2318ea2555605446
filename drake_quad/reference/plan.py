"""A plan: a route with times, as the trajectory that the controllers follow."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.reference.polynomial_path import PolynomialPath, path_derivative, refined
from drake_quad.reference.rest import moves_at_end, with_rest
from drake_quad.reference.routes import Leg
from drake_quad.reference.yaw import constant_yaw
from drake_quad.signals import SIGNALS, Jerk, Reference, Snap

# Derivatives of position and yaw that are continuous where a reference comes to rest, those of order zero included.
PATH_ORDERS, YAW_ORDERS = 4, 2
# Acceleration with which a reference brakes that was slower before: the paper's limit on it, m/s².
_BRAKING = 0.7
# Likewise of the yaw, rad/s²; an assumption, with which a turn of 1 rad/s ends within two seconds.
_YAW_BRAKING = 1.0

REFERENCE_PORTS = {name: SIGNALS[name] for name in ("reference", "reference_jerk", "reference_snap")}
"""What a plan shows at each of its ports."""


@dataclass(frozen=True)
class Plan:
    """Position and yaw over time.

    Before the beginning and after the end of its path the reference hovers: position and yaw hold, and all derivatives
    are zero. If the path ends in motion, the reference brakes first; see `drake_quad.reference.rest`.

    Attributes:
        path: the position in W.
        yaw: the yaw over the same time, a path of one axis, rad.
        legs: named parts of the route, for people to read.
        laps: when the laps begin and the last one ends, s; none of a route without laps.
    """

    path: PolynomialPath
    yaw: PolynomialPath
    legs: tuple[Leg, ...] = ()
    laps: tuple[float, ...] = ()

    @classmethod
    def facing(
        cls, path: PolynomialPath, yaw: float = 0.0, legs: tuple[Leg, ...] = (), laps: tuple[float, ...] = ()
    ) -> "Plan":
        """Returns the plan to fly a path with a constant yaw in rad."""
        return cls(path, constant_yaw(path.times[0], path.times[-1], yaw), legs, laps)

    @classmethod
    def hover(cls, position: ArrayLike, *, duration: float, yaw: float = 0.0) -> "Plan":
        """Returns the plan to stay at a position (3,) in m for a duration in s."""
        coefficients = np.zeros((1, 8, 3))
        coefficients[0, 0] = position
        return cls.facing(PolynomialPath(np.array([0.0, duration]), coefficients), yaw, (Leg("hover", 0),))

    @property
    def duration(self) -> float:
        """Time from the first to the last waypoint, s."""
        return self.path.duration

    @cached_property
    def flown_path(self) -> PolynomialPath:
        """The path between two pieces of rest, with braking at its end if it ends in motion."""
        return with_rest(self.path, orders=PATH_ORDERS, acceleration=_BRAKING)

    @cached_property
    def flown_yaw(self) -> PolynomialPath:
        """The yaw between two pieces of rest, with braking at its end if it ends in motion."""
        return with_rest(self.yaw, orders=YAW_ORDERS, acceleration=_YAW_BRAKING)

    @property
    def brakes(self) -> bool:
        """Whether the path or the yaw ends in motion, so that the reference brakes where a flight goes on."""
        return moves_at_end(self.path, PATH_ORDERS) or moves_at_end(self.yaw, YAW_ORDERS)

    @property
    def rest_time(self) -> float:
        """Time from which the reference rests for good, s."""
        return max(float(part.times[-2]) for part in (self.flown_path, self.flown_yaw))

    @property
    def lap_times(self) -> tuple[float, ...]:
        """When the laps begin and the last one ends, s; a route without laps is one."""
        return self.laps or (float(self.path.times[0]), float(self.path.times[-1]))

    @property
    def leg_times(self) -> list[float]:
        """When the legs begin, s."""
        return [float(self.path.times[leg.first]) for leg in self.legs]

    @property
    def waypoints(self) -> np.ndarray:
        """(segments + 1, 3) the points that the path passes, m."""
        return self.path.waypoints

    @property
    def initial_yaw(self) -> float:
        """Yaw at the beginning, rad."""
        return float(self.yaw.coefficients[0, 0, 0])

    def derivative(self, order: int) -> PiecewisePolynomial:
        """Return the (3, 1) trajectory of the position's derivative of that order, in m and s, at any time."""
        return to_piecewise_polynomial(path_derivative(self.flown_path, order))

    def reference(self) -> PiecewisePolynomial:
        """Return the trajectory of the reference at any time: the rows of the ports in `REFERENCE_PORTS`, in order."""
        end = max(self.flown_path.times[-1], self.flown_yaw.times[-1])
        path, yaw = (_until(end, part) for part in (self.flown_path, self.flown_yaw))
        path, yaw = refined(path, yaw.times), refined(yaw, path.times)
        position, velocity, acceleration, jerk, snap = (_axes(path_derivative(path, order)) for order in range(5))
        (angle,), (rate,), (angular_acceleration,) = (_axes(path_derivative(yaw, order)) for order in range(3))
        rows: list[Any] = [
            *Reference._make([*position, *velocity, *acceleration, angle, rate]),
            *Jerk._make(jerk),
            *Snap._make([*snap, angular_acceleration]),
        ]
        return _piecewise_polynomial(path.times, rows)


def to_piecewise_polynomial(path: PolynomialPath) -> PiecewisePolynomial:
    """Return the path as Drake's (axes, 1) trajectory."""
    return _piecewise_polynomial(path.times, _axes(path))


def _until(end: float, path: PolynomialPath) -> PolynomialPath:
    """A path that ends with rest, with that rest lasting until a time in s."""
    return path._replace(times=np.append(path.times[:-1], end))


def _axes(path: PolynomialPath) -> np.ndarray:
    """(axes, segments, powers) the coefficients."""
    return path.coefficients.transpose(2, 0, 1)


def _piecewise_polynomial(times: np.ndarray, rows: Iterable[np.ndarray]) -> PiecewisePolynomial:
    """Return Drake's (rows, 1) trajectory from (segments, powers) coefficients of each row in unit time."""
    durations = np.diff(times)[:, np.newaxis]
    segments = len(durations)
    rows = list(rows)
    matrix = np.empty((segments, len(rows), 1), dtype=object)
    for i, coefficients in enumerate(rows):
        in_seconds = coefficients * durations ** -np.arange(coefficients.shape[1])
        matrix[:, i, 0] = [Polynomial(row) for row in in_seconds]
    return PiecewisePolynomial(list(matrix), times)
