"""Modes of a linear system, with their frequencies, damping ratios and participating states."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy

# A mode lists the states whose participation exceeds this fraction of the largest participation in the mode.
_MIN_PARTICIPATION = 0.1
MAX_POLE_ERROR = 0.01
"""Largest error that rounding causes in repeated eigenvalues, 1/s."""


class Mode(NamedTuple):
    """Eigenvalue, or pair of conjugate eigenvalues, of a linear system.

    Attributes:
        pole: pole s of a continuous system, or log(z) / period of a sampled system, 1/s; for a pair, the pole with
            positive imaginary part.
        frequency: natural frequency |s|, rad/s.
        damping: damping ratio -Re s / |s|; NaN for an integrator, whose |s| is at most
            `MAX_POLE_ERROR`.
        multiplicity: multiplicity of the eigenvalue.
        states: names of the states that participate in the mode, in descending order of their participation.
    """

    pole: complex
    frequency: float
    damping: float
    multiplicity: int
    states: tuple[str, ...]


def modes(A: np.ndarray, states: tuple[str, ...], *, period: float | None = None) -> list[Mode]:
    """Return the modes of ẋ = A x or of x⁺ = A x, slowest first.

    The participation of a state in a mode is its diagonal entry in the mode's spectral projector. This is the
    participation factor if the eigenvalue is simple, and it is also well defined for repeated eigenvalues. Modes that
    decay within a period, such as the modes of a delay line, are left out. Poles within 0.01 1/s of each other, or
    within 0.1 % of their magnitude, count as one pole.

    Args:
        A: (n, n) system matrix.
        states: names of the n states.
        period: sampling period, s; None for a continuous system.
    """

    def pole_of(value: complex) -> complex:
        return complex(value) if period is None else complex(np.log(complex(value))) / period

    def distance(value: complex, other: complex) -> float:
        # The logarithms of two values on opposite sides of the negative real axis differ by about 2π i, so the
        # logarithm of the quotient is used.
        return abs(value - other if period is None else pole_of(value / other))

    values = np.linalg.eigvals(A)
    remaining = [i for i, value in enumerate(values) if period is None or abs(value) > 1e-3]
    result = []
    while remaining:
        first = values[remaining[0]]
        radius = max(1e-3 * abs(pole_of(first)), MAX_POLE_ERROR)
        equal = [i for i in remaining if distance(values[i], first) < radius]
        remaining = [i for i in remaining if i not in equal]
        pole = pole_of(np.mean(values[equal]))
        if pole.imag <= -0.5 * radius:
            continue
        size = abs(pole)
        participation = np.abs(np.diag(_projector(A, partial(_is_among, values=values, indices=equal))))
        order = [
            int(i)
            for i in np.argsort(-participation, kind="stable")
            if participation[i] > _MIN_PARTICIPATION * participation.max()
        ]
        damping = -pole.real / size if size > MAX_POLE_ERROR else np.nan
        result.append(Mode(pole, size, damping, len(equal), tuple(states[i] for i in order)))
    return sorted(result, key=lambda mode: mode.frequency)


def _is_among(value: complex, *, values: np.ndarray, indices: Sequence[int]) -> bool:
    """Return whether the eigenvalue that is nearest to a value has one of the given indices."""
    return int(np.argmin(np.abs(values - value))) in indices


def _projector(A: np.ndarray, selects: Callable[[complex], bool]) -> np.ndarray:
    """Return the spectral projector (n, n) of selected eigenvalues."""
    T, Z, k = scipy.linalg.schur(A, output="complex", sort=selects)
    R = scipy.linalg.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
    return Z[:, :k] @ (Z[:, :k].conj().T - R @ Z[:, k:].conj().T)
