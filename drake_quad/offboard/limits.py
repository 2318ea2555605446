"""Limits on the motion of a vehicle in an offboard flight, and on its commands."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.signals import AttitudeTarget, BodyRates, Reference, State

_AXES = ("x", "y", "z")
_NUM_BISECTIONS = 30
_MARGIN = 2.0  # m around the route, of the default geofence
_TILT_MARGIN = math.radians(10.0)  # angle by which a vehicle may exceed the largest commanded tilt
_GRAVITY = 9.80665  # m/s²


class Fence(NamedTuple):
    """Geofence: a box in the autopilot's local frame, with axes north, west and up.

    Attributes:
        lower: smallest coordinates (3,) of the box, m.
        upper: largest coordinates (3,) of the box, m.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    @classmethod
    def around(cls, positions: np.ndarray) -> "Fence":
        """Return the box around a route (ticks, 3) with a margin of 2 m.

        The margin below is at most half of the smallest height above the origin.
        """
        low, high = positions.min(axis=0) - _MARGIN, positions.max(axis=0) + _MARGIN
        lowest = float(positions[:, 2].min())
        low[2] = lowest - (min(_MARGIN, 0.5 * lowest) if lowest > 0.0 else _MARGIN)
        return cls(tuple(low.tolist()), tuple(high.tolist()))

    def check_route(self, positions: np.ndarray) -> None:
        """Check that a route (ticks, 3) lies inside the geofence.

        Raises:
            InputError: if a position of the route lies outside the geofence.
        """
        outside = np.flatnonzero(~np.all((positions >= self.lower) & (positions <= self.upper), axis=1))
        if len(outside):
            place, low, high = (_point(each) for each in (positions[outside[0]], self.lower, self.upper))
            raise InputError(
                f"the route, which begins where the vehicle is, leaves the geofence at {place} m; the geofence reaches"
                f" from {low} to {high} m (north, west and up of the origin of the autopilot)"
            )


class Limits(NamedTuple):
    """Limits on the motion of a vehicle. The flight ends if the vehicle exceeds one of them.

    The defaults are assumptions for small vehicles.

    Attributes:
        fence: geofence; None for the box around the route with a margin of 2 m.
        speed: largest speed, m/s.
        tilt: largest commanded angle between the thrust and the vertical, rad. Larger commands are reduced. The flight
            ends if the measured angle is 10° larger.
        rate: largest commanded body rate about each axis, rad/s. Larger commands are reduced.
        error: largest distance from the reference, m.
    """

    fence: Fence | None = None
    speed: float = 10.0
    tilt: float = math.radians(45.0)
    rate: float = math.radians(200.0)
    error: float = 2.0

    def violation(self, state: State, reference: Reference) -> str | None:
        """Return a description of the first limit that a vehicle exceeds; None if it exceeds no limit.

        Args:
            state: measured state.
            reference: reference, in the same coordinates as the state.
        """
        if not all(map(math.isfinite, state)):
            return "the measured state is not finite"
        if self.fence is not None:
            for axis, value, low, high in zip(_AXES, state[:3], self.fence.lower, self.fence.upper, strict=True):
                if not low <= value <= high:
                    return f"the vehicle left the geofence: {axis} is {value:.2f} m, outside {low:.2f} to {high:.2f} m"
        speed, tilt = math.hypot(state.v_x, state.v_y, state.v_z), tilt_angle(state.roll, state.pitch)
        if speed > self.speed:
            return f"the speed of {speed:.1f} m/s exceeds {self.speed:g} m/s"
        if tilt > self.tilt + _TILT_MARGIN:
            return f"the tilt of {math.degrees(tilt):.0f}° exceeds {math.degrees(self.tilt + _TILT_MARGIN):.0f}°"
        error = math.dist(state[:3], reference[:3])
        if error > self.error:
            return f"the distance of {error:.2f} m from the reference exceeds {self.error:g} m"
        return None

    def check_reference(self, velocities: np.ndarray, accelerations: np.ndarray) -> None:
        """Check the speed of a route, and the tilt that its acceleration requires; both arrays are (ticks, 3).

        Raises:
            InputError: if the route exceeds a limit.
        """
        speed = float(np.linalg.norm(velocities, axis=1).max())
        if not speed <= self.speed:
            raise InputError(f"the route has a speed of {speed:.1f} m/s, more than the limit of {self.speed:g} m/s")
        horizontal, vertical = np.hypot(accelerations[:, 0], accelerations[:, 1]), _GRAVITY + accelerations[:, 2]
        tilt = float(np.arctan2(horizontal, vertical).max())
        if not tilt <= self.tilt:
            raise InputError(
                f"the route needs a tilt of {math.degrees(tilt):.0f}°, more than the limit of"
                f" {math.degrees(self.tilt):.0f}°"
            )


def tilt_angle(roll: float, pitch: float) -> float:
    """Return the angle between the thrust and the vertical, rad."""
    return math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch))))


def with_limited_tilt(target: AttitudeTarget, tilt: float) -> AttitudeTarget:
    """Return the target with roll and pitch scaled by one factor, so that the tilt is at most `tilt` (rad)."""
    low, high = 0.0, 1.0
    if tilt_angle(target.roll, target.pitch) <= tilt:
        return target
    for _ in range(_NUM_BISECTIONS):
        middle = 0.5 * (low + high)
        fits = tilt_angle(middle * target.roll, middle * target.pitch) <= tilt
        low, high = (middle, high) if fits else (low, middle)
    return target._replace(roll=low * target.roll, pitch=low * target.pitch)


def with_limited_rates(rates: BodyRates, limit: float) -> BodyRates:
    """Return the body rates, each limited to the range from -limit to limit, rad/s."""
    return BodyRates._make(max(-limit, min(limit, each)) for each in rates)


def _point(values: Iterable[float]) -> str:
    return f"({', '.join(f'{each:.2f}' for each in values)})"
