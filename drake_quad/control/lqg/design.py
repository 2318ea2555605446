"""The gains of a linear-quadratic-Gaussian controller of one axis, from the model of its chain."""

from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.control.lqg.chains import ContinuousModel, TorqueChain, sampled, sampled_noise
from drake_quad.signals import Row


class AxisLoop(NamedTuple):
    """Filter and regulator of one axis; rows of records of its chain.

    Attributes:
        A: of x⁺ = A x + B u over a frame, row by row.
        B: a column.
        L: gain of the filter, a column for each of what is measured.
        K: gain of the regulator.
        K_pending: on the commands that are under way, the oldest first.
        outer: of the specific thrust on itself at rest, by which K becomes gains of an outer loop: see `axis_loop`.
    """

    A: tuple[Any, ...]
    B: Any
    L: tuple[Any, ...]
    K: Any
    K_pending: tuple[Row, ...]
    outer: Row


class Timing(NamedTuple):
    """When things happen.

    Attributes:
        frame: period of the cameras, s.
        tick: period of the control, s; a whole number of frames.
        delay_ticks: after which a command acts.
    """

    frame: float
    tick: float
    delay_ticks: int


def kalman_gain(A: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """(n, p) L of x̂ = x⁻ + L (y - C x⁻) in steady state, for noise of covariances Q and R."""
    P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R)
    gain: np.ndarray = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return gain


def regulator_gain(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m, n) K of u = -K x that minimises the sum of xᵀ Q x + uᵀ R u, and (m, m) what any other u costs.

    With u = -K x + c the sum is what it is without c, and that of cᵀ W c with this W = R + Bᵀ S B.
    """
    S = scipy.linalg.solve_discrete_are(A, B, Q, R)
    W: np.ndarray = B.T @ S @ B + R
    gain: np.ndarray = np.linalg.solve(W, B.T @ S @ A)
    return gain, W


def with_commands_under_way(A: np.ndarray, B: np.ndarray, delay: int) -> tuple[np.ndarray, np.ndarray]:
    """A and B of a system whose input acts some ticks later; the inputs under way are states, the oldest first."""
    n = len(A)
    if not delay:
        return A, B
    oldest = np.eye(1, delay)
    moving = np.hstack([np.zeros((delay, n)), np.eye(delay, k=1)])
    return np.vstack([np.hstack([A, B @ oldest]), moving]), np.vstack([np.zeros((n, 1)), np.fliplr(oldest).T])


class Regulator(NamedTuple):
    """The regulator of an axis: u = -K x of x⁺ = A x + B u over a tick.

    Attributes:
        A: row by row; the last of n are the commands under way, the oldest first.
        B: n numbers.
        K: n numbers.
        weight: w, what other commands u = -K x + c cost: w c² each.
    """

    A: tuple[tuple[float, ...], ...]
    B: tuple[float, ...]
    K: tuple[float, ...]
    weight: float


def regulator_of(model: ContinuousModel, timing: Timing, command_weight: float) -> Regulator:
    """The regulator that minimises the sum of p² + ρ u² over the ticks, with the commands under way among the states.

    Args:
        model: of the chain.
        timing: of frames and ticks.
        command_weight: ρ.

    Raises:
        numpy.linalg.LinAlgError: floating point finds none.
    """
    A, B = with_commands_under_way(*sampled(model.A, model.B, timing.tick), timing.delay_ticks)
    position, *_ = np.pad(model.C, ((0, 0), (0, timing.delay_ticks)))
    K, W = regulator_gain(A, B, np.outer(position, position), np.eye(1) * command_weight)
    rows = tuple([tuple(row) for row in A.tolist()])
    return Regulator(rows, tuple(B.ravel().tolist()), tuple(K.ravel().tolist()), W.item())


def axis_loop(model: ContinuousModel, timing: Timing, *, noise: np.ndarray, command_weight: float) -> AxisLoop:
    """Designs filter and regulator of an axis.

    The regulator is that of `regulator_of`. At rest u is nothing along a `TorqueChain`, and the specific thrust s
    otherwise; so a deviation of p, v and d asks for s = -(K_p p + K_v v + K_d d) / k with k = K_s in the first case,
    and k = 1 + K_s + ΣK_pending in the other.

    Args:
        model: of the chain.
        timing: of frames and ticks.
        noise: (p,) standard deviation of what is measured.
        command_weight: ρ.

    Raises:
        numpy.linalg.LinAlgError: floating point finds no stable filter, or no regulator.
    """
    n = len(model.A)
    A, B = sampled(model.A, model.B, timing.frame)
    L = kalman_gain(A, model.C, sampled_noise(model.A, model.Q, timing.frame), np.diag(noise**2))
    if not np.abs(np.linalg.eigvals(A - A @ L @ model.C)).max() < 1.0:
        raise np.linalg.LinAlgError("the filter is unstable")
    K = regulator_of(model, timing, command_weight).K
    record = model.kind
    on_state, pending = record(*K[:n]), K[n:]
    answers = 0.0 if record is TorqueChain else 1.0 + sum(pending)
    return AxisLoop(
        A=tuple(record(*row) for row in A.tolist()),
        B=record(*B.ravel().tolist()),
        L=tuple(record(*column) for column in L.T.tolist()),
        K=on_state,
        K_pending=pending,
        outer=on_state.thrust + answers,
    )
