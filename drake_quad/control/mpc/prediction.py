"""What a regulated axis will do over a horizon, as a function of where it is and of what is added to its commands.

With u = -K x + c and the regulator's K a system x⁺ = A x + B u is x⁺ = (A - B K) x + B c, so that over the ticks k of
the horizon every row of x and every u is

    y_k = F_k x_0 + Σ_i G_ki c_i

and the sum of xᵀ Q x + ρ u² over all ticks, those after the horizon at the regulator's cost, is

    x_0ᵀ S x_0 + w Σ_i c_i²,    w = ρ + Bᵀ S B

with the solution S of the regulator's Riccati equation (J. A. Rossiter, B. Kouvaritakis and M. J. Rice, "A numerically
robust state-space approach to stable-predictive control strategies", Automatica 34(1), 1998).
"""

import itertools
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.control.lqg.design import Regulator


class Response(NamedTuple):
    """What a row does over the horizon.

    Attributes:
        free: (ticks, n) F, by where the axis is.
        forced: (ticks, ticks) G, by what is added to the commands.
        later: whether the first is that of the next tick, and not of this one.
    """

    free: np.ndarray
    forced: np.ndarray
    later: bool


class Prediction:
    """An axis over a horizon.

    Args:
        regulator: of the axis.
        num_ticks: of the horizon.
    """

    def __init__(self, regulator: Regulator, num_ticks: int) -> None:
        A, self._B, self._K = (np.array(part) for part in (regulator.A, regulator.B, regulator.K))
        self._closed = A - np.outer(self._B, self._K)
        powers = itertools.accumulate(itertools.repeat(self._closed), np.matmul, initial=np.eye(len(A)))
        self._powers = list(itertools.islice(powers, num_ticks))

    def command(self) -> Response:
        """Of the commands of this tick and of those that follow."""
        free = [-self._K @ power for power in self._powers]
        return Response(np.array(free), self._caused([1.0, *(row @ self._B for row in free)]), later=False)

    def state(self, number: int) -> Response:
        """Of a row of the state at the ticks that follow this one."""
        rows = [power[number] for power in self._powers]
        free = np.array([row @ self._closed for row in rows])
        return Response(free, self._caused([row @ self._B for row in rows]), later=True)

    def _caused(self, impulse: list[float]) -> np.ndarray:
        """G of an impulse response: what is added at a tick shows at that and at those that follow."""
        nothing = np.zeros(len(self._powers))
        return np.array(scipy.linalg.toeplitz(impulse[: len(nothing)], nothing))
