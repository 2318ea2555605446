"""Checks that the rotors can fly a path."""

from typing import NamedTuple

import numpy as np

from drake_quad.reference.polynomial_path import PolynomialPath

# A segment is a polynomial of degree 7; this many samples leave no peak of its derivatives unseen.
_SAMPLES = 64


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


def sample_times(path: PolynomialPath) -> np.ndarray:
    """(samples,) times, dense enough on every segment to see all that happens, s."""
    fractions = np.linspace(0.0, 1.0, _SAMPLES)
    return np.asarray((path.times[:-1, np.newaxis] + path.durations[:, np.newaxis] * fractions).ravel())


def first_violation(
    times: np.ndarray, rotor_speeds: np.ndarray, *, min_rotor_speed: float, max_rotor_speed: float
) -> Violation | None:
    """Returns where rotor speeds first break the rotors' limits, or None.

    Args:
        times: (samples,), s.
        rotor_speeds: (4, samples) that a path asks for, rad/s.
        min_rotor_speed: rad/s.
        max_rotor_speed: rad/s.
    """
    beyond = (rotor_speeds < min_rotor_speed) | (rotor_speeds > max_rotor_speed)
    if not beyond.any():
        return None
    sample = int(np.flatnonzero(beyond.any(axis=0))[0])
    rotor = int(np.flatnonzero(beyond[:, sample])[0])
    speed = float(rotor_speeds[rotor, sample])
    limit = min_rotor_speed if speed < min_rotor_speed else max_rotor_speed
    return Violation(float(times[sample]), rotor + 1, speed, limit)
