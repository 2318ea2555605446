"""Lissajous figures, which many published flights follow: a sine of time along each axis."""

import math

import numpy as np
from numpy.typing import ArrayLike

from drake_quad.reference.polynomial_path import PolynomialPath, hermite_path

# Knots for a turn of the fastest sine; between them the path is within 1e-10 of the amplitude of it.
_KNOTS = 16


def lissajous(
    *, centre: ArrayLike, amplitude: ArrayLike, turns: ArrayLike, phase: ArrayLike, period: float, laps: int
) -> PolynomialPath:
    """Returns laps of c + a sin(2π n t / T + φ), each along its axis of W.

    Args:
        centre: (3,) c, m.
        amplitude: (3,) a, m.
        turns: (3,) n of each sine in a lap, whole numbers.
        phase: (3,) φ, rad.
        period: T of a lap, s.
        laps: how many.
    """
    a, n = np.asarray(amplitude), np.asarray(turns)
    knots = _KNOTS * max(1, int(np.abs(n).max())) * laps
    times = np.linspace(0.0, period * laps, knots + 1)
    frequency = math.tau * n / period
    angle = frequency * times[:, np.newaxis] + np.asarray(phase)
    sine, cosine = a * np.sin(angle), a * np.cos(angle)
    derivatives = [np.asarray(centre) + sine, frequency * cosine, -(frequency**2) * sine, -(frequency**3) * cosine]
    return hermite_path(times, np.stack(derivatives, axis=1))
