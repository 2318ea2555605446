"""First-order Gauss-Markov process, which models slowly varying errors of sensors.

A process d with the standard deviation σ and the correlation time T has the autocovariance σ² exp(-|τ| / T). Its exact
samples at intervals h are

    d⁺ = a d + √(1 - a²) σ n,    a = exp(-h / T)

with standard normal n. The process is stationary if the first sample is σ n.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from drake_quad.geometry.axes import Vector
from drake_quad.signals import Number, Row


class Correlation(NamedTuple):
    """Correlation between successive samples of a Gauss-Markov process.

    Attributes:
        decay: factor a of the previous sample.
        gain: factor √(1 - a²) of σ n.
    """

    decay: Number
    gain: Number

    @classmethod
    def of(cls, time: Row, period: float) -> "Correlation":
        """Return the correlation for a correlation time T and a sampling interval h, s; T may be an array."""
        intervals = period / time
        return cls(np.exp(-intervals), np.sqrt(-np.expm1(-2.0 * intervals)))

    def step(self, value: Row, deviation: Row, number: Row) -> Row:
        """Return the next sample, given the previous one, the standard deviation σ and a standard normal number."""
        return self.decay * value + self.gain * deviation * number

    def vector_step(self, value: Vector, deviation: Iterable[Row], numbers: Vector) -> Vector:
        """Return the next samples of three independent processes."""
        return Vector._make(map(self.step, value, deviation, numbers))


def stationary(deviation: Iterable[Row], numbers: Vector) -> Vector:
    """Return first samples of three independent stationary processes, given their standard deviations σ."""
    return Vector._make(size * number for size, number in zip(deviation, numbers, strict=True))
