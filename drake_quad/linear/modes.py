"""Modes of a linear system."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy

# How much of a mode a state must carry to be named, and how near poles count as one, 1/s: repeated eigenvalues are
# found with errors of that size.
_SHARE, _NEAR = 0.1, 0.01


class Mode(NamedTuple):
    """An eigenvalue, or a pair of them.

    Attributes:
        pole: s, 1/s; of a pair, the one above the real axis. For a sampled system log(z) / period.
        frequency: |s|, rad/s.
        damping: -Re s / |s|; nan for an integrator.
        multiplicity: how often it occurs.
        states: that take part in it, the most first.
    """

    pole: complex
    frequency: float
    damping: float
    multiplicity: int
    states: tuple[str, ...]


def modes(A: np.ndarray, states: tuple[str, ...], *, period: float | None = None) -> list[Mode]:
    """Return the modes of ẋ = A x, or of x⁺ = A x, the slowest first.

    A state takes part by its entry on the diagonal of the mode's spectral projector, which for a single eigenvalue is
    its participation factor and is sound for repeated ones, too. What dies within a period, as a delay line does, is
    left out. Poles within 0.01 1/s, or within 0.1 % of their size, of each other count as one.

    Args:
        A: (n, n).
        states: the n names.
        period: between two samples, s; None for a continuous system.
    """

    def pole_of(value: complex) -> complex:
        if period is None:
            return complex(value)
        return complex(np.log(complex(value))) / period if value else complex(-np.inf)

    values = np.linalg.eigvals(A)
    left = [pole_of(value) for value in values if period is None or abs(value) > 1e-3]
    found = []
    while left:
        first = left[0]
        radius = max(1e-3 * abs(first), _NEAR)
        alike = [pole for pole in left if abs(pole - first) < radius]
        left = [pole for pole in left if not abs(pole - first) < radius]
        pole = complex(np.mean(alike))
        if pole.imag <= -0.5 * radius:
            continue
        size = abs(pole)
        among = partial(_is_near, pole_of=pole_of, pole=first, radius=1.5 * radius)
        shares = np.abs(np.diag(_projector(A, among)))
        order = [int(i) for i in np.argsort(-shares, kind="stable") if shares[i] > _SHARE * shares.max()]
        damping = -pole.real / size if size > _NEAR else np.nan
        found.append(Mode(pole, size, damping, len(alike), tuple(states[i] for i in order)))
    return sorted(found, key=lambda mode: mode.frequency)


def _is_near(value: complex, *, pole_of: Callable[[complex], complex], pole: complex, radius: float) -> bool:
    return abs(pole_of(value) - pole) < radius


def _projector(A: np.ndarray, among: Callable[[complex], bool]) -> np.ndarray:
    """(n, n) onto the invariant subspace of some eigenvalues, along that of the others."""
    T, Z, k = scipy.linalg.schur(A, output="complex", sort=among)
    R = scipy.linalg.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
    return Z[:, :k] @ (Z[:, :k].conj().T - R @ Z[:, k:].conj().T)
