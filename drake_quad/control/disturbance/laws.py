"""Laws that estimate, on each axis by itself, the acceleration that is not commanded: v' = a + d.

a is how the vehicle is believed to follow its commands (`drake_quad.control.disturbance.response`). A law is a record
of its numbers on an axis. At every tick it corrects its memory by what is measured, and predicts its memory at the next
tick from the velocity and the distance that a gains on the way. The memory has a field `disturbance`, which is d.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np
import scipy

from drake_quad.control.disturbance.response import lagging
from drake_quad.framework.elementary import exp, sin_cos
from drake_quad.signals import Row


class Measured(NamedTuple):
    """What is measured on an axis.

    Attributes:
        position: m.
        velocity: m/s.
    """

    position: Row
    velocity: Row


class Gained(NamedTuple):
    """What the modelled acceleration gains from one tick to the next.

    Attributes:
        velocity: m/s.
        distance: m.
    """

    velocity: Row
    distance: Row


class DisturbanceLaw(Protocol):
    """An estimator of the disturbance on an axis."""

    def at_rest(self, position: Row) -> "tuple[Row, ...]":
        """The memory of a vehicle that rests at a position (m) without disturbance."""

    def corrected(self, memory: "tuple[Row, ...]", measured: Measured, period: float) -> "tuple[Row, ...]":
        """The memory after what is measured at a tick."""

    def predicted(self, memory: "tuple[Row, ...]", gained: Gained, period: float) -> "tuple[Row, ...]":
        """The memory at the next tick, before anything is measured there."""


class KalmanMemory(NamedTuple):
    """What a Kalman filter knows: the state of its model.

    Attributes:
        position: m.
        velocity: m/s.
        disturbance: d, m/s².
    """

    position: Row
    velocity: Row
    disturbance: Row


class KalmanLaw(NamedTuple):
    """A Kalman filter in steady state on the measured position, with the disturbance a Gauss-Markov process.

        p' = v,    v' = a + d,    d' = -d / T + w,    y = p + n

    It takes the velocity from positions alone: what cameras have for velocity is made of the same positions, later. A
    relative of NF-Constant of Neural-Fly (O'Connell et al., Science Robotics 7, 2022), which filters a force likewise.

    Attributes:
        time_constant: T, s; a long one makes a random walk.
        gain: of the correction by y - p.
    """

    time_constant: Row
    gain: KalmanMemory

    @classmethod
    def of(cls, *, deviation: float, time_constant: float, position_noise: float, period: float) -> "KalmanLaw":
        """The filter for these statistics, by the discrete Riccati equation.

        Args:
            deviation: standard deviation of the disturbance, m/s².
            time_constant: of its autocorrelation, s.
            position_noise: standard deviation of the measured position, m.
            period: of the ticks, s.
        """
        A, Q = _disturbed_motion(deviation, time_constant, period)
        # In units of the noise the equation is well scaled.
        C, R = np.array([[1.0, 0.0, 0.0]]), position_noise**2
        P = R * scipy.linalg.solve_discrete_are(A.T, C.T, Q / R, np.eye(1))
        gain = P @ C.T / (C @ P @ C.T + R)
        return cls(time_constant, KalmanMemory(*gain.ravel().tolist()))

    def at_rest(self, position: Row) -> KalmanMemory:
        """See `DisturbanceLaw`."""
        return KalmanMemory(position, 0.0, 0.0)

    def corrected(self, memory: KalmanMemory, measured: Measured, period: float) -> KalmanMemory:
        """See `DisturbanceLaw`: x̂ + L (y - p̂)."""
        innovation = measured.position - memory.position
        return KalmanMemory._make(known + gain * innovation for known, gain in zip(memory, self.gain, strict=True))

    def predicted(self, memory: KalmanMemory, gained: Gained, period: float) -> KalmanMemory:
        """See `DisturbanceLaw`: the model, exactly."""
        position, velocity, disturbance = memory
        after, speed, distance = lagging(disturbance, 0.0, self.time_constant, period)
        return KalmanMemory(
            position + period * velocity + distance + gained.distance, velocity + speed + gained.velocity, after
        )


def _disturbed_motion(deviation: float, time_constant: float, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition of (p, v, d) over a tick, and covariance of what noise adds in it (C. F. Van Loan, IEEE TAC, 1978)."""
    slope = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / time_constant]])
    density = np.diag([0.0, 0.0, 2.0 * deviation**2 / time_constant])
    upper, lower = np.vsplit(scipy.linalg.expm(period * np.block([[-slope, density], [np.zeros((3, 3)), slope.T]])), 2)
    _, noise = np.hsplit(upper, 2)
    _, transposed = np.hsplit(lower, 2)
    return transposed.T, transposed.T @ noise


class DifferencedMemory(NamedTuple):
    """What a law on differences of the velocity remembers.

    Attributes:
        velocity: measured at the tick before, m/s.
        modelled: what has been gained since by the model, m/s.
        disturbance: d behind the law's filter, m/s².
        rate: of that, m/s³; 0 with a filter of first order.
    """

    velocity: Row
    modelled: Row
    disturbance: Row
    rate: Row


def _rest(position: Row) -> DifferencedMemory:
    return DifferencedMemory(0.0, 0.0, 0.0, 0.0)


def _residual(memory: DifferencedMemory, velocity: Row, period: float) -> Row:
    """The acceleration that the model does not explain, in the mean over the last tick, m/s²."""
    return (velocity - memory.velocity - memory.modelled) / period


class AdaptiveLaw(NamedTuple):
    """L1 adaptive augmentation with piecewise-constant adaptation, on the velocity.

        v̂' = a + σ̂ - a_s ṽ,    ṽ = v̂ - v,    σ̂ = -Φ⁻¹ exp(-a_s h) ṽ at each tick,    Φ = (1 - exp(-a_s h)) / a_s

    and d is σ̂ behind C(s) = ω / (s + ω) (N. Hovakimyan and C. Cao, "L1 Adaptive Control Theory", 2010, section 3.3;
    Z. Wu et al., "L1Quad", IEEE TCST, 2025). The adaptation takes away over a tick what ṽ was at its beginning; what is
    left at its end is what the model did not explain meanwhile, with v a straight line between two measurements:
    ṽ = -Φ (Δv - ∫a) / h. The method is the subject of US patent 8,712,559.

    Attributes:
        adaptation: a_s, 1/s.
        bandwidth: ω, rad/s.
    """

    adaptation: Row
    bandwidth: Row

    def at_rest(self, position: Row) -> DifferencedMemory:
        """See `DisturbanceLaw`."""
        return _rest(position)

    def corrected(self, memory: DifferencedMemory, measured: Measured, period: float) -> DifferencedMemory:
        """See `DisturbanceLaw`: the adaptation, and its filter under what is held from the tick on."""
        decay = exp(-self.adaptation * period)
        phi = (1.0 - decay) / self.adaptation
        prediction_error = -phi * _residual(memory, measured.velocity, period)
        sigma = -decay / phi * prediction_error
        filtered = sigma + exp(-self.bandwidth * period) * (memory.disturbance - sigma)
        return DifferencedMemory(measured.velocity, 0.0, filtered, 0.0)

    def predicted(self, memory: DifferencedMemory, gained: Gained, period: float) -> DifferencedMemory:
        """See `DisturbanceLaw`."""
        return memory._replace(modelled=gained.velocity)


class IncrementalLaw(NamedTuple):
    """Incremental nonlinear dynamic inversion: command = a_f + (a_c - v'_f), and so d = H (v' - a).

    a_c is the acceleration that is wanted, a_f the modelled and v'_f the measured one, both behind the same filter
    H(s) = ω² / (s² + √2 ω s + ω²), so that they are late alike (E. J. J. Smeur, Q. P. Chu and G. C. H. E. de Croon,
    JGCD 39, 2016; E. J. J. Smeur, G. C. H. E. de Croon and Q. P. Chu, Control Engineering Practice 73, 2018; E. Tal and
    S. Karaman, IEEE TCST 29, 2021). The difference v' - a is taken in the mean over each tick.

    Attributes:
        bandwidth: ω, rad/s.
    """

    bandwidth: Row

    def at_rest(self, position: Row) -> DifferencedMemory:
        """See `DisturbanceLaw`."""
        return _rest(position)

    def corrected(self, memory: DifferencedMemory, measured: Measured, period: float) -> DifferencedMemory:
        """See `DisturbanceLaw`: the filter, exactly, under the difference of the last tick."""
        residual = _residual(memory, measured.velocity, period)
        damped = self.bandwidth * math.sqrt(0.5)
        sine, cosine = sin_cos(damped * period)
        decay = exp(-damped * period)
        off, rate = memory.disturbance - residual, memory.rate
        return DifferencedMemory(
            measured.velocity,
            0.0,
            residual + decay * ((cosine + sine) * off + sine / damped * rate),
            decay * ((cosine - sine) * rate - 2.0 * damped * sine * off),
        )

    def predicted(self, memory: DifferencedMemory, gained: Gained, period: float) -> DifferencedMemory:
        """See `DisturbanceLaw`."""
        return memory._replace(modelled=gained.velocity)
