"""Gains of a linear-quadratic-Gaussian controller for one axis, designed for the model of its chain."""

from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.control.lqg.chains import ContinuousModel, TorqueChain, discretise, discretise_noise
from drake_quad.signals import Row


class AxisLoop(NamedTuple):
    """Filter and regulator of one axis. Each vector of n states is an instance of the chain's class.

    Attributes:
        A: system matrix of x⁺ = A x + B u over a frame, row by row.
        B: input matrix, a single column.
        L: gain of the filter, with a column for each measured quantity.
        K: gain of the regulator.
        K_pending: gains on the commands in transit, the oldest first.
        outer_divisor: divisor k of K: the gains of the outer loop, which commands an acceleration, are K / k; see
            `axis_loop`.
    """

    A: tuple[Any, ...]
    B: Any
    L: tuple[Any, ...]
    K: Any
    K_pending: tuple[Row, ...]
    outer_divisor: Row


class Timing(NamedTuple):
    """Periods and delay of a control loop.

    Attributes:
        frame: frame period of the cameras, s.
        tick: control period, s; a whole number of frames.
        delay_ticks: delay from a command to its effect, in ticks.
    """

    frame: float
    tick: float
    delay_ticks: int


def kalman_gain(A: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Return L (n, p) of the steady-state filter x̂ = x⁻ + L (y - C x⁻), for noise covariances Q and R."""
    P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R)
    gain: np.ndarray = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return gain


def regulator_gain(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gain K (m, n) of u = -K x that minimises the sum of xᵀ Q x + uᵀ R u, and the cost matrix W (m, m).

    W is the cost of perturbations c of the command u = -K x + c: they increase the sum by the sum of cᵀ W c. It is W =
    R + Bᵀ S B, where S solves the Riccati equation.
    """
    S = scipy.linalg.solve_discrete_are(A, B, Q, R)
    W: np.ndarray = B.T @ S @ B + R
    gain: np.ndarray = np.linalg.solve(W, B.T @ S @ A)
    return gain, W


def augment_with_delay(A: np.ndarray, B: np.ndarray, delay: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A and B of a system whose input is delayed by a number of ticks.

    The inputs in transit are additional states, the oldest first.
    """
    n = len(A)
    if not delay:
        return A, B
    oldest = np.eye(1, delay)
    shift = np.hstack([np.zeros((delay, n)), np.eye(delay, k=1)])
    return np.vstack([np.hstack([A, B @ oldest]), shift]), np.vstack([np.zeros((n, 1)), np.fliplr(oldest).T])


class Regulator(NamedTuple):
    """Regulator u = -K x of an axis, with x⁺ = A x + B u over a tick.

    Attributes:
        A: (n, n) system matrix, row by row. The last states are the commands in transit, the oldest first.
        B: (n,) input matrix.
        K: (n,) gain.
        weight: w; a command u = -K x + c increases the cost by w c².
    """

    A: tuple[tuple[float, ...], ...]
    B: tuple[float, ...]
    K: tuple[float, ...]
    weight: float


def design_regulator(model: ContinuousModel, timing: Timing, command_weight: float) -> Regulator:
    """Return the regulator that minimises the sum of p² + ρ u² over all ticks, with commands in transit as states.

    Args:
        model: model of the chain.
        timing: periods and delay.
        command_weight: weight ρ of the command.

    Raises:
        numpy.linalg.LinAlgError: if the regulator cannot be computed in floating point.
    """
    A, B = augment_with_delay(*discretise(model.A, model.B, timing.tick), timing.delay_ticks)
    position, *_ = np.pad(model.C, ((0, 0), (0, timing.delay_ticks)))
    K, W = regulator_gain(A, B, np.outer(position, position), np.eye(1) * command_weight)
    rows = tuple([tuple(row) for row in A.tolist()])
    return Regulator(rows, tuple(B.ravel().tolist()), tuple(K.ravel().tolist()), W.item())


def axis_loop(model: ContinuousModel, timing: Timing, *, noise: np.ndarray, command_weight: float) -> AxisLoop:
    """Design filter and regulator of an axis.

    `design_regulator` designs the regulator u = -K x. For constant deviations of position p, velocity v and
    disturbance d, the inner states settle at a constant specific thrust s. The steady command u is then zero for a
    `TorqueChain`, and equal to s for the other chains. It follows that

        s = -(K_p p + K_v v + K_d d) / k

    The divisor k is the gain K_s on the specific thrust for a `TorqueChain`. For the other chains, it is 1 + K_s plus
    the sum of the gains `K_pending` on the commands in transit.

    Args:
        model: model of the chain.
        timing: periods and delay.
        noise: (p,) standard deviations of the measured quantities.
        command_weight: weight ρ of the command.

    Raises:
        numpy.linalg.LinAlgError: if a stable filter or the regulator cannot be computed in floating point.
    """
    n = len(model.A)
    A, B = discretise(model.A, model.B, timing.frame)
    L = kalman_gain(A, model.C, discretise_noise(model.A, model.Q, timing.frame), np.diag(noise**2))
    if not np.abs(np.linalg.eigvals(A - A @ L @ model.C)).max() < 1.0:
        raise np.linalg.LinAlgError("the Kalman filter is unstable")
    K = design_regulator(model, timing, command_weight).K
    record = model.kind
    on_state, pending = record(*K[:n]), K[n:]
    pending_fraction = 0.0 if record is TorqueChain else 1.0 + sum(pending)
    return AxisLoop(
        A=tuple(record(*row) for row in A.tolist()),
        B=record(*B.ravel().tolist()),
        L=tuple(record(*column) for column in L.T.tolist()),
        K=on_state,
        K_pending=pending,
        outer_divisor=on_state.thrust + pending_fraction,
    )
