"""Lissajous figures: paths whose position along each axis is a sine of time. Many published flights use them."""

import math

import numpy as np
from numpy.typing import ArrayLike

from drake_quad.reference.polynomial_path import PolynomialPath, hermite_path

# Number of knots per period of the fastest sine. The path error between knots is then below 1e-10 of the amplitude.
_KNOTS_PER_TURN = 16


def lissajous(
    *, centre: ArrayLike, amplitude: ArrayLike, turns: ArrayLike, phase: ArrayLike, period: float, laps: int
) -> PolynomialPath:
    """Return the path c + a sin(2π n t / T + φ), evaluated for each axis of W.

    Args:
        centre: (3,) centre c, m.
        amplitude: (3,) amplitudes a, m.
        turns: (3,) numbers n of sine periods per lap, integers.
        phase: (3,) phases φ, rad.
        period: duration T of a lap, s.
        laps: number of laps.
    """
    a, n = np.asarray(amplitude), np.asarray(turns)
    knots = _KNOTS_PER_TURN * max(1, int(np.abs(n).max())) * laps
    times = np.linspace(0.0, period * laps, knots + 1)
    frequency = math.tau * n / period
    angle = frequency * times[:, np.newaxis] + np.asarray(phase)
    sine, cosine = a * np.sin(angle), a * np.cos(angle)
    derivatives = [np.asarray(centre) + sine, frequency * cosine, -(frequency**2) * sine, -(frequency**3) * cosine]
    return hermite_path(times, np.stack(derivatives, axis=1))
