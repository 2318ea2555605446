"""Models from the command to the position for a linear-quadratic-Gaussian controller.

Along X and Y the horizontal specific thrust s moves the vehicle, and the attitude changes s. Without an autopilot the
command u is a snap, which the torques produce after the lag T of the rotors. With an autopilot the command is an
acceleration, an angle times g. The attitude follows it as a second-order lag, or its angular acceleration follows that
of the on-board loops with the lag of the rotors:

    p' = v    v' = s + d₁ + d₂    s' = j    without: j' = a + δ,  a' = (u - a) / T
                                            with:    j' = b + δ,  b = ω² (u - s) - 2 ζ ω j
                                            or:      j' = a + δ,  a' = (b - a) / T

Along Z the thrust acts directly: p' = v, v' = s + d₁ + d₂, s' = (u - s) / T, where s is the acceleration in excess of
gravity.

The disturbing acceleration is the sum of two coloured noises: d₁ of first order, white noise filtered by
1 / (1 + T₁ s), and d₂ of second order, white noise filtered by the critically damped lag 1 / (1 + T₂ s)². The bias δ of
the angular motion is coloured noise of first order:

    d₁' = -d₁ / T₁ + w₁    d₂' = e    e' = -d₂ / T₂² - 2 e / T₂ + w₂    δ' = -δ / T_δ + w_δ

(A. Gelb, "Applied optimal estimation", 1974, section 3.6.) White noise on u makes the filter trust the model less where
the command acts (J. C. Doyle and G. Stein, "Robustness with observers", IEEE Transactions on Automatic Control 24(4),
1979).
"""

import math
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.signals import Row

# States of the chains: deviations are in metres and seconds. A chain is told by its fields.


class TorqueChain(NamedTuple):
    """Along X or Y, with torques over the link."""

    position: Row
    velocity: Row
    thrust: Row
    jerk: Row
    snap: Row
    first: Row
    second: Row
    second_rate: Row
    bias: Row


class AttitudeChain(NamedTuple):
    """Along X or Y, with an autopilot on board."""

    position: Row
    velocity: Row
    thrust: Row
    jerk: Row
    first: Row
    second: Row
    second_rate: Row
    bias: Row


class LaggingAttitudeChain(TorqueChain):
    """Along X or Y, with the loops of an autopilot on board behind the lag of the rotors."""


class VerticalChain(NamedTuple):
    """Along Z."""

    position: Row
    velocity: Row
    thrust: Row
    first: Row
    second: Row
    second_rate: Row


class ChainNoise(NamedTuple):
    """Coloured noise, which is white noise filtered by 1 / (1 + T s), or by 1 / (1 + T s)² for second order.

    Attributes:
        deviation: standard deviation, m/s² for a disturbance, and m/s⁴ for the bias.
        time: time constant T, s.
    """

    deviation: float
    time: float


class Disturbances(NamedTuple):
    """Modelled disturbances of an axis.

    Attributes:
        first: disturbing acceleration of first order.
        second: disturbing acceleration of second order, critically damped.
        bias: bias of the angular motion, m/s⁴; None along Z.
        command_noise: spectral density of white noise on the command, in the unit of the command times √s.
    """

    first: ChainNoise
    second: ChainNoise
    bias: ChainNoise | None
    command_noise: float


class Answer(NamedTuple):
    """How the attitude answers an autopilot's command.

    Attributes:
        natural_frequency: ω, rad/s.
        damping: ζ.
    """

    natural_frequency: float
    damping: float


class ContinuousModel(NamedTuple):
    """x' = A x + B u + w of a chain, y = C x.

    Attributes:
        kind: of the chain.
        A: (n, n).
        B: (n, 1).
        C: (1, n) along Z: the position; else (2, n): position and specific thrust.
        Q: (n, n) spectral density of w.
    """

    kind: Any
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    Q: np.ndarray


def torque_model(lag: float, disturbances: Disturbances) -> ContinuousModel:
    """The model of a `TorqueChain`, given the lag of the rotors (s)."""
    turning = {("jerk", "snap"): 1.0, ("jerk", "bias"): 1.0, ("snap", "snap"): -1.0 / lag}
    return _model(TorqueChain, {("thrust", "jerk"): 1.0, **turning}, {"snap": 1.0 / lag}, disturbances)


def attitude_model(answer: Answer, disturbances: Disturbances) -> ContinuousModel:
    """The model of an `AttitudeChain`."""
    stiffness = answer.natural_frequency**2
    friction = 2.0 * answer.damping * answer.natural_frequency
    turning = {("jerk", "thrust"): -stiffness, ("jerk", "jerk"): -friction, ("jerk", "bias"): 1.0}
    return _model(AttitudeChain, {("thrust", "jerk"): 1.0, **turning}, {"jerk": stiffness}, disturbances)


def lagging_attitude_model(answer: Answer, lag: float, disturbances: Disturbances) -> ContinuousModel:
    """The model of a `LaggingAttitudeChain`, given the lag of the rotors (s)."""
    stiffness = answer.natural_frequency**2 / lag
    friction = 2.0 * answer.damping * answer.natural_frequency / lag
    turning = {("jerk", "snap"): 1.0, ("jerk", "bias"): 1.0, ("snap", "snap"): -1.0 / lag}
    moving = {("thrust", "jerk"): 1.0, ("snap", "thrust"): -stiffness, ("snap", "jerk"): -friction, **turning}
    return _model(LaggingAttitudeChain, moving, {"snap": stiffness}, disturbances)


def lateral_model(lag: float | None, answer: Answer | None, disturbances: Disturbances) -> ContinuousModel:
    """The model along x or y, given the lag of the rotors (s) and the answer of an autopilot, of which one is given."""
    if answer is None:
        assert lag is not None
        return torque_model(lag, disturbances)
    return attitude_model(answer, disturbances) if lag is None else lagging_attitude_model(answer, lag, disturbances)


def vertical_model(lag: float, disturbances: Disturbances) -> ContinuousModel:
    """The model of a `VerticalChain`, given the lag of the thrust (s)."""
    return _model(VerticalChain, {("thrust", "thrust"): -1.0 / lag}, {"thrust": 1.0 / lag}, disturbances)


def sampled(A: np.ndarray, B: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """A and B of x⁺ = A x + B u over a period (s) in which u is held."""
    n, m = B.shape
    whole = scipy.linalg.expm(period * np.block([[A, B], [np.zeros((m, n + m))]]))
    return whole[:n, :n], whole[:n, n:]


def sampled_noise(A: np.ndarray, Q: np.ndarray, period: float) -> np.ndarray:
    """The covariance that white noise of spectral density Q adds over a period (s).

    C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Transactions on Automatic Control
    23(3), 1978.
    """
    n = len(A)
    # Over a short time, then twice that, and so on: what dies within a period would grow beyond all bounds backwards.
    doublings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(A, 1)) * period, 1.0))))
    whole = scipy.linalg.expm(period / 2.0**doublings * np.block([[-A, Q], [np.zeros((n, n)), A.T]]))
    over = whole[n:, n:].T
    covariance: np.ndarray = over @ whole[:n, n:]
    for _ in range(doublings):
        covariance, over = covariance + over @ covariance @ over.T, over @ over
    return 0.5 * (covariance + covariance.T)


def _model(
    kind: Any, moving: dict[tuple[str, str], float], acting: dict[str, float], disturbances: Disturbances
) -> ContinuousModel:
    """A model from the entries of A that make up its motion, those of B, and what disturbs it."""
    first, second, bias, command_noise = disturbances
    entries = {
        **moving,
        ("position", "velocity"): 1.0,
        **{("velocity", name): 1.0 for name in ("thrust", "first", "second")},
        ("first", "first"): -1.0 / first.time,
        ("second", "second_rate"): 1.0,
        ("second_rate", "second"): -1.0 / second.time**2,
        ("second_rate", "second_rate"): -2.0 / second.time,
    }
    densities = {
        "first": 2.0 * first.deviation**2 / first.time,
        "second_rate": 4.0 * second.deviation**2 / second.time**3,
    }
    seen = ["position"]
    if bias is not None:
        entries["bias", "bias"] = -1.0 / bias.time
        densities["bias"] = 2.0 * bias.deviation**2 / bias.time
        seen = ["position", "thrust"]
    place = {name: i for i, name in enumerate(kind._fields)}
    A, Q, B = np.zeros((len(place), len(place))), np.zeros((len(place), len(place))), np.zeros((len(place), 1))
    for (row, column), value in entries.items():
        A[place[row], place[column]] = value
    for row, value in acting.items():
        B[place[row]] = value
    for row, value in densities.items():
        Q[place[row], place[row]] = value
    C = np.eye(len(place))[[place[name] for name in seen]]
    return ContinuousModel(kind, A, B, C, Q + command_noise**2 * B @ B.T)
