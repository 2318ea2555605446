"""Models from the command to the position for a linear-quadratic-Gaussian controller.

Along X and Y the vehicle is accelerated by the horizontal specific thrust s, which depends on the attitude. Without an
autopilot the command u is a snap, which the torques produce with the lag T of the rotors. With an autopilot the command
is an acceleration, an angle times g. In the simpler model with an autopilot, the attitude follows this command with a
second-order lag. In the model with rotor lag, the on-board loops command an angular acceleration, which is reached with
this lag:

    p' = v    v' = s + d₁ + d₂    s' = j

    without an autopilot             j' = a + δ,  a' = (u - a) / T
    with an autopilot                j' = b + δ,  b = ω² (u - s) - 2 ζ ω j
    with an autopilot and rotor lag  j' = a + δ,  a' = (b - a) / T

Along Z the thrust acts directly: p' = v, v' = s + d₁ + d₂, s' = (u - s) / T, where s is the acceleration in excess of
gravity.

The disturbing acceleration is the sum of two coloured noises. d₁ is white noise filtered by the first-order lag
1 / (1 + T₁ s), and d₂ is white noise filtered by the critically damped second-order lag 1 / (1 + T₂ s)². The bias δ of
the angular motion is coloured noise of first order:

    d₁' = -d₁ / T₁ + w₁    d₂' = e    e' = -d₂ / T₂² - 2 e / T₂ + w₂    δ' = -δ / T_δ + w_δ

(A. Gelb, "Applied optimal estimation", 1974, section 3.6). Modelled white noise on u makes the filter rely less on the
modelled effect of the command (J. C. Doyle and G. Stein, "Robustness with observers", IEEE Transactions on Automatic
Control 24(4), 1979).
"""

import math
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.signals import Row

# A chain is the state of the model on one axis: the chain of integrators from the command to the position, and the
# disturbances. All units are metres and seconds. The class of a chain identifies its model.


class TorqueChain(NamedTuple):
    """State of the model along X or Y if torques are sent over the radio link."""

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
    """State of the model along X or Y if an autopilot is on board."""

    position: Row
    velocity: Row
    thrust: Row
    jerk: Row
    first: Row
    second: Row
    second_rate: Row
    bias: Row


class LaggingAttitudeChain(TorqueChain):
    """State of the model along X or Y if an autopilot is on board and the rotor lag is modelled separately."""


class VerticalChain(NamedTuple):
    """State of the model along Z."""

    position: Row
    velocity: Row
    thrust: Row
    first: Row
    second: Row
    second_rate: Row


class ChainNoise(NamedTuple):
    """Coloured noise: white noise filtered by 1 / (1 + T s), or by 1 / (1 + T s)² for second order.

    Attributes:
        deviation: standard deviation, m/s² for a disturbance and m/s⁴ for the bias.
        time: time constant T, s.
    """

    deviation: float
    time: float


class Disturbances(NamedTuple):
    """Modelled disturbances on one axis.

    Attributes:
        first: first-order disturbing acceleration d₁.
        second: second-order disturbing acceleration d₂.
        bias: bias δ of the angular motion; None along Z.
        command_noise: square root of the spectral density of white command noise, in the unit of the command times √s.
    """

    first: ChainNoise
    second: ChainNoise
    bias: ChainNoise | None
    command_noise: float


class SecondOrderResponse(NamedTuple):
    """Second-order response of the attitude to an autopilot's command.

    Attributes:
        natural_frequency: natural frequency ω, rad/s.
        damping: damping ratio ζ.
    """

    natural_frequency: float
    damping: float


class ContinuousModel(NamedTuple):
    """Model x' = A x + B u + w, y = C x of a chain.

    Attributes:
        kind: type of the chain.
        A: (n, n) system matrix.
        B: (n, 1) input matrix.
        C: output matrix, (1, n) along Z for the measured position; (2, n) along X and Y for position and specific
            thrust.
        Q: (n, n) spectral density of w.
    """

    kind: Any
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    Q: np.ndarray


def torque_model(lag: float, disturbances: Disturbances) -> ContinuousModel:
    """Return the model of a `TorqueChain` for a time constant of the rotors (s)."""
    entries = {("jerk", "snap"): 1.0, ("jerk", "bias"): 1.0, ("snap", "snap"): -1.0 / lag}
    return _model(TorqueChain, {("thrust", "jerk"): 1.0, **entries}, {"snap": 1.0 / lag}, disturbances)


def attitude_model(response: SecondOrderResponse, disturbances: Disturbances) -> ContinuousModel:
    """Return the model of an `AttitudeChain`."""
    stiffness = response.natural_frequency**2
    friction = 2.0 * response.damping * response.natural_frequency
    entries = {("jerk", "thrust"): -stiffness, ("jerk", "jerk"): -friction, ("jerk", "bias"): 1.0}
    return _model(AttitudeChain, {("thrust", "jerk"): 1.0, **entries}, {"jerk": stiffness}, disturbances)


def lagging_attitude_model(response: SecondOrderResponse, lag: float, disturbances: Disturbances) -> ContinuousModel:
    """Return the model of a `LaggingAttitudeChain` for a time constant of the rotors (s)."""
    stiffness = response.natural_frequency**2 / lag
    friction = 2.0 * response.damping * response.natural_frequency / lag
    attitude_entries = {("jerk", "snap"): 1.0, ("jerk", "bias"): 1.0, ("snap", "snap"): -1.0 / lag}
    entries = {("thrust", "jerk"): 1.0, ("snap", "thrust"): -stiffness, ("snap", "jerk"): -friction, **attitude_entries}
    return _model(LaggingAttitudeChain, entries, {"snap": stiffness}, disturbances)


def lateral_model(
    lag: float | None, response: SecondOrderResponse | None, disturbances: Disturbances
) -> ContinuousModel:
    """Return the model along X or Y.

    Args:
        lag: time constant of the rotors, s; None if the response of the attitude includes this lag.
        response: response of the attitude with an autopilot; None without an autopilot, so that `lag` is required.
        disturbances: modelled disturbances.
    """
    if response is None:
        assert lag is not None
        return torque_model(lag, disturbances)
    return (
        attitude_model(response, disturbances) if lag is None else lagging_attitude_model(response, lag, disturbances)
    )


def vertical_model(lag: float, disturbances: Disturbances) -> ContinuousModel:
    """Return the model of a `VerticalChain` for a time constant of the thrust (s)."""
    return _model(VerticalChain, {("thrust", "thrust"): -1.0 / lag}, {"thrust": 1.0 / lag}, disturbances)


def discretise(A: np.ndarray, B: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return A and B of x⁺ = A x + B u over a period (s) with constant u."""
    n, m = B.shape
    exponential = scipy.linalg.expm(period * np.block([[A, B], [np.zeros((m, n + m))]]))
    return exponential[:n, :n], exponential[:n, n:]


def discretise_noise(A: np.ndarray, Q: np.ndarray, period: float) -> np.ndarray:
    """Return the covariance of the process noise over a period (s), for white noise of spectral density Q.

    C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Transactions on Automatic Control
    23(3), 1978.
    """
    n = len(A)
    # The covariance is computed over a short time and then doubled repeatedly, because exp(-A t) overflows for modes
    # that decay much faster than the period.
    doublings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(A, 1)) * period, 1.0))))
    exponential = scipy.linalg.expm(period / 2.0**doublings * np.block([[-A, Q], [np.zeros((n, n)), A.T]]))
    transition = exponential[n:, n:].T
    covariance: np.ndarray = transition @ exponential[:n, n:]
    for _ in range(doublings):
        covariance, transition = covariance + transition @ covariance @ transition.T, transition @ transition
    return 0.5 * (covariance + covariance.T)


def _model(
    kind: Any, motion_entries: dict[tuple[str, str], float], input_entries: dict[str, float], disturbances: Disturbances
) -> ContinuousModel:
    """Return the model with the given entries of A and B for the motion, and with the given disturbances."""
    first, second, bias, command_noise = disturbances
    entries = {
        **motion_entries,
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
    measured = ["position"]
    if bias is not None:
        entries["bias", "bias"] = -1.0 / bias.time
        densities["bias"] = 2.0 * bias.deviation**2 / bias.time
        measured = ["position", "thrust"]
    index = {name: i for i, name in enumerate(kind._fields)}
    A, Q, B = np.zeros((len(index), len(index))), np.zeros((len(index), len(index))), np.zeros((len(index), 1))
    for (row, column), value in entries.items():
        A[index[row], index[column]] = value
    for row, value in input_entries.items():
        B[index[row]] = value
    for row, value in densities.items():
        Q[index[row], index[row]] = value
    C = np.eye(len(index))[[index[name] for name in measured]]
    return ContinuousModel(kind, A, B, C, Q + command_noise**2 * B @ B.T)
