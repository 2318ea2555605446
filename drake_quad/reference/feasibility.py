"""Check that the rotors can follow a path within their speed limits."""

from typing import NamedTuple

import numpy as np

from drake_quad.reference.polynomial_path import PolynomialPath

# Number of samples of a segment. A segment is a polynomial of degree 7, so 64 samples resolve every peak of its
# derivatives.
_SAMPLES_PER_SEGMENT = 64


class Violation(NamedTuple):
    """First violation of a rotor's speed limits.

    Attributes:
        time: time of the violation, s.
        rotor: number of the rotor, 1 to 4.
        speed: rotor speed that the path requires, rad/s.
        limit: idle or maximum speed that is violated, rad/s.
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
    """Return sample times, (samples,) in s, dense enough on each segment to resolve the peaks of the rotor speeds."""
    fractions = np.linspace(0.0, 1.0, _SAMPLES_PER_SEGMENT)
    return np.asarray((path.times[:-1, np.newaxis] + path.durations[:, np.newaxis] * fractions).ravel())


def first_violation(
    times: np.ndarray, rotor_speeds: np.ndarray, *, min_rotor_speed: float, max_rotor_speed: float
) -> Violation | None:
    """Return the first violation of the rotor speed limits, or None.

    Args:
        times: (samples,) times, s.
        rotor_speeds: (4, samples) rotor speeds that the path requires, rad/s.
        min_rotor_speed: idle speed, rad/s.
        max_rotor_speed: maximum speed, rad/s.
    """
    violates = (rotor_speeds < min_rotor_speed) | (rotor_speeds > max_rotor_speed)
    if not violates.any():
        return None
    sample = int(np.flatnonzero(violates.any(axis=0))[0])
    rotor = int(np.flatnonzero(violates[:, sample])[0])
    speed = float(rotor_speeds[rotor, sample])
    limit = min_rotor_speed if speed < min_rotor_speed else max_rotor_speed
    return Violation(float(times[sample]), rotor + 1, speed, limit)
