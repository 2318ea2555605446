"""Limits on the motion of a vehicle in an offboard flight."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.signals import AttitudeTarget, Reference, State

_AXES = ("x", "y", "z")
_NUM_BISECTIONS = 30


class Fence(NamedTuple):
    """Geofence: a box in the autopilot's local frame, with axes north, west and up.

    Attributes:
        lower: smallest position (3,) inside the box, m.
        upper: largest position (3,) inside the box, m.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    @classmethod
    def around(cls, positions: np.ndarray, margin: float = 2.0) -> "Fence":
        """Return the box around a route (ticks, 3) with a margin, m."""
        return cls(tuple((positions.min(axis=0) - margin).tolist()), tuple((positions.max(axis=0) + margin).tolist()))

    def check_route(self, positions: np.ndarray) -> None:
        """Check that a route (ticks, 3) lies inside the geofence.

        Raises:
            InputError: if it does not.
        """
        outside = np.flatnonzero(np.any((positions < self.lower) | (positions > self.upper), axis=1))
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
        tilt: largest angle between the thrust and the vertical, rad. Larger commanded angles are reduced.
        error: largest distance from the reference, m.
    """

    fence: Fence | None = None
    speed: float = 10.0
    tilt: float = math.radians(45.0)
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
        if tilt > self.tilt:
            return f"the tilt of {math.degrees(tilt):.0f}° exceeds {math.degrees(self.tilt):.0f}°"
        error = math.dist(state[:3], reference[:3])
        if error > self.error:
            return f"the distance of {error:.2f} m from the reference exceeds {self.error:g} m"
        return None


def tilt_angle(roll: float, pitch: float) -> float:
    """Return the angle between the thrust and the vertical, rad."""
    return math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch))))


def with_limited_tilt(target: AttitudeTarget, tilt: float) -> AttitudeTarget:
    """Reduce roll and pitch by the same factor, so that the tilt is at most `tilt` (rad)."""
    low, high = 0.0, 1.0
    if tilt_angle(target.roll, target.pitch) <= tilt:
        return target
    for _ in range(_NUM_BISECTIONS):
        middle = 0.5 * (low + high)
        fits = tilt_angle(middle * target.roll, middle * target.pitch) <= tilt
        low, high = (middle, high) if fits else (low, middle)
    return target._replace(roll=low * target.roll, pitch=low * target.pitch)


def _point(values: Iterable[float]) -> str:
    return f"({', '.join(f'{each:.2f}' for each in values)})"
