"""Whether the rotors can fly a path."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drake_quad.reference.minimum_snap import PolynomialPath, evaluate

# A segment is a polynomial of degree 7; this many samples leave no peak of its derivatives unseen.
_SAMPLES = 64

# From (3, samples) acceleration, jerk and snap to (4, samples) rotor speeds in rad/s.
InverseDynamics = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Violation(NamedTuple):
    """The first moment at which a path asks for more than a rotor can give.

    Attributes:
        time: s.
        rotor: 1 to 4.
        speed: that the path asks for, rad/s.
        limit: that it breaks, rad/s.
    """

    time: float
    rotor: int
    speed: float
    limit: float

    def __str__(self) -> str:
        return (
            f"at {self.time:.2f} s rotor {self.rotor} would have to turn at {self.speed:.0f} rad/s, "
            f"but its limit is {self.limit:.0f} rad/s"
        )


def first_violation(
    path: PolynomialPath, inverse_dynamics: InverseDynamics, *, min_rotor_speed: float, max_rotor_speed: float
) -> Violation | None:
    """Returns where a path first breaks the rotors' limits, or None.

    Args:
        path: of the position, 3 axes.
        inverse_dynamics: the rotor speeds that accelerations, jerks and snaps ask for.
        min_rotor_speed: rad/s.
        max_rotor_speed: rad/s.
    """
    fractions = np.linspace(0.0, 1.0, _SAMPLES)
    times = (path.times[:-1, np.newaxis] + path.durations[:, np.newaxis] * fractions).ravel()
    speeds = inverse_dynamics(*(evaluate(path, times, order) for order in (2, 3, 4)))
    beyond = (speeds < min_rotor_speed) | (speeds > max_rotor_speed)
    if not beyond.any():
        return None
    sample = int(np.flatnonzero(beyond.any(axis=0))[0])
    rotor = int(np.flatnonzero(beyond[:, sample])[0])
    speed = float(speeds[rotor, sample])
    limit = min_rotor_speed if speed < min_rotor_speed else max_rotor_speed
    return Violation(float(times[sample]), rotor + 1, speed, limit)
