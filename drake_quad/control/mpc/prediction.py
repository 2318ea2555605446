"""Prediction of a regulated axis over a horizon, from its state and from perturbations of its commands.

With u = -K x + c and the regulator's gain K, a system x⁺ = A x + B u becomes x⁺ = (A - B K) x + B c. At tick k of the
horizon, every component y of x, and also u, is

    y_k = F_k x_0 + Σ_i G_ki c_i

The sum of xᵀ Q x + ρ u² over all ticks, including those after the horizon, is

    x_0ᵀ S x_0 + w Σ_i c_i²,    w = ρ + Bᵀ S B

where S solves the regulator's Riccati equation (J. A. Rossiter, B. Kouvaritakis and M. J. Rice, "A numerically robust
state-space approach to stable-predictive control strategies", Automatica 34(1), 1998).
"""

import itertools
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.control.lqg.design import Regulator


class Response(NamedTuple):
    """Response of a state or of the command over the horizon.

    Attributes:
        free: (ticks, n) F, gains on the state of the axis.
        forced: (ticks, ticks) G, gains on the perturbations of the commands.
        starts_next_tick: True if the first row applies to the next tick, False if it applies to the current tick.
    """

    free: np.ndarray
    forced: np.ndarray
    starts_next_tick: bool


class Prediction:
    """Prediction of an axis over a horizon."""

    def __init__(self, regulator: Regulator, num_ticks: int) -> None:
        A, self._B, self._K = (np.array(part) for part in (regulator.A, regulator.B, regulator.K))
        self._closed = A - np.outer(self._B, self._K)
        powers = itertools.accumulate(itertools.repeat(self._closed), np.matmul, initial=np.eye(len(A)))
        self._powers = list(itertools.islice(powers, num_ticks))

    def command(self) -> Response:
        """Return the response of the command u over the horizon, from the current tick on."""
        free = [-self._K @ power for power in self._powers]
        return Response(
            np.array(free), self._forced_response([1.0, *(row @ self._B for row in free)]), starts_next_tick=False
        )

    def state(self, number: int) -> Response:
        """Return the response of the state with an index over the horizon, from the next tick on."""
        rows = [power[number] for power in self._powers]
        free = np.array([row @ self._closed for row in rows])
        return Response(free, self._forced_response([row @ self._B for row in rows]), starts_next_tick=True)

    def _forced_response(self, impulse: list[float]) -> np.ndarray:
        """Return G for an impulse response. A perturbation affects only its own tick and later ticks."""
        zeros = np.zeros(len(self._powers))
        return np.array(scipy.linalg.toeplitz(impulse[: len(zeros)], zeros))
