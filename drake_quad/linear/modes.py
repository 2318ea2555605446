"""Modes of a linear system."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy

_MIN_SHARE = 0.1  # smallest participation of a state that is named, relative to the largest one of the mode
_MAX_ERROR = 0.01  # 1/s; repeated eigenvalues are found with errors of this size


class Mode(NamedTuple):
    """An eigenvalue, or a pair of them.

    Attributes:
        pole: pole s of a continuous system, or log(z) / period of a sampled one, 1/s; of a pair, the one above the real
            axis.
        frequency: |s|, rad/s.
        damping: -Re s / |s|; nan for an integrator.
        multiplicity: number of equal eigenvalues.
        states: names of the states that participate in the mode, in descending order of their participation.
    """

    pole: complex
    frequency: float
    damping: float
    multiplicity: int
    states: tuple[str, ...]


def modes(A: np.ndarray, states: tuple[str, ...], *, period: float | None = None) -> list[Mode]:
    """Return the modes of ẋ = A x or of x⁺ = A x, the slowest first.

    The participation of a state in a mode is its entry on the diagonal of the mode's spectral projector. For a single
    eigenvalue this is the participation factor, and it is well defined for repeated eigenvalues, too. Modes that decay
    within a period, such as those of a delay line, are left out. Poles within 0.01 1/s of each other, or within 0.1 %
    of their magnitude, count as one.

    Args:
        A: (n, n) system matrix.
        states: names of the n states.
        period: sampling period, s; None for a continuous system.
    """

    def pole_of(value: complex) -> complex:
        return complex(value) if period is None else complex(np.log(complex(value))) / period

    def distance(value: complex, other: complex) -> float:
        # Neighbours on both sides of the negative real axis have logarithms that are far apart.
        return abs(value - other if period is None else pole_of(value / other))

    values = np.linalg.eigvals(A)
    left = [i for i, value in enumerate(values) if period is None or abs(value) > 1e-3]
    found = []
    while left:
        first = values[left[0]]
        radius = max(1e-3 * abs(pole_of(first)), _MAX_ERROR)
        alike = [i for i in left if distance(values[i], first) < radius]
        left = [i for i in left if i not in alike]
        pole = pole_of(np.mean(values[alike]))
        if pole.imag <= -0.5 * radius:
            continue
        size = abs(pole)
        shares = np.abs(np.diag(_projector(A, partial(_is_at, values=values, places=alike))))
        order = [int(i) for i in np.argsort(-shares, kind="stable") if shares[i] > _MIN_SHARE * shares.max()]
        damping = -pole.real / size if size > _MAX_ERROR else np.nan
        found.append(Mode(pole, size, damping, len(alike), tuple(states[i] for i in order)))
    return sorted(found, key=lambda mode: mode.frequency)


def _is_at(value: complex, *, values: np.ndarray, places: Sequence[int]) -> bool:
    """Return True if the one of some eigenvalues (n,) that is nearest to a value is at one of the places."""
    return int(np.argmin(np.abs(values - value))) in places


def _projector(A: np.ndarray, among: Callable[[complex], bool]) -> np.ndarray:
    """Return the projector (n, n) onto the invariant subspace of some eigenvalues, along that of the others."""
    T, Z, k = scipy.linalg.schur(A, output="complex", sort=among)
    R = scipy.linalg.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
    return Z[:, :k] @ (Z[:, :k].conj().T - R @ Z[:, k:].conj().T)
