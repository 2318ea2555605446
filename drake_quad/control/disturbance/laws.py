"""Laws that estimate the disturbing acceleration d on each axis independently: v' = a + d.

a is the modelled response to the commands (`drake_quad.control.disturbance.response`). A law is a named tuple of its
parameters on one axis. At every tick, the law corrects its memory with the measurement. It then predicts the memory at
the next tick from the changes of velocity and position that a causes until then. The field `disturbance` of the memory
is d.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np
import scipy

from drake_quad.control.disturbance.response import lag_step
from drake_quad.framework.elementary import exp, sin_cos
from drake_quad.signals import Row


class AxisMeasurement(NamedTuple):
    """Measured motion on an axis.

    Attributes:
        position: position, m.
        velocity: velocity, m/s.
    """

    position: Row
    velocity: Row


class ModelIncrement(NamedTuple):
    """Change of the motion from one tick to the next due to the modelled acceleration.

    Attributes:
        velocity: change of the velocity, m/s.
        distance: change of the position in addition to the motion at constant velocity, m.
    """

    velocity: Row
    distance: Row


class DisturbanceLaw(Protocol):
    """Law that estimates the disturbance on one axis. Its memory is the state that it keeps from tick to tick."""

    def initial_memory(self, position: Row) -> "tuple[Row, ...]":
        """Return the memory for a vehicle at rest at a position (m) without disturbance."""

    def correct(self, memory: "tuple[Row, ...]", measured: AxisMeasurement, period: float) -> "tuple[Row, ...]":
        """Return the law's memory after the measurement of a tick has corrected it."""

    def predict(self, memory: "tuple[Row, ...]", increment: ModelIncrement, period: float) -> "tuple[Row, ...]":
        """Return the law's memory as predicted for the next tick.

        Args:
            memory: memory at this tick.
            increment: change of the motion until the next tick, computed from the model.
            period: tick period, s.
        """


class KalmanMemory(NamedTuple):
    """State estimate of a Kalman filter.

    Attributes:
        position: position, m.
        velocity: velocity, m/s.
        disturbance: disturbance d, m/s².
    """

    position: Row
    velocity: Row
    disturbance: Row


class KalmanLaw(NamedTuple):
    """Steady-state Kalman filter for the measured position, with a Gauss-Markov process as disturbance.

        p' = v,    v' = a + d,    d' = -d / T + w,    y = p + n

    The filter does not use measured velocities, since motion capture derives them from the same positions, with a
    delay. The law is related to NF-Constant of Neural-Fly (O'Connell et al., Science Robotics 7, 2022), which also
    filters a force.

    Attributes:
        time_constant: T, s; a disturbance with a large T approximates a random walk.
        gain: gain of the correction by y - p.
    """

    time_constant: Row
    gain: KalmanMemory

    @classmethod
    def of(cls, *, deviation: float, time_constant: float, position_noise: float, period: float) -> "KalmanLaw":
        """Return the optimal filter for given noise statistics, from the discrete Riccati equation.

        Args:
            deviation: standard deviation of the disturbance, m/s².
            time_constant: time constant of the autocorrelation of the disturbance, s.
            position_noise: standard deviation of the noise of the measured position, m.
            period: tick period, s.
        """
        A, Q = _disturbed_motion(deviation, time_constant, period)
        # The variances are divided by the variance of the position noise, so that the equation is well scaled.
        C, R = np.array([[1.0, 0.0, 0.0]]), position_noise**2
        P = R * scipy.linalg.solve_discrete_are(A.T, C.T, Q / R, np.eye(1))
        gain = P @ C.T / (C @ P @ C.T + R)
        return cls(time_constant, KalmanMemory(*gain.ravel().tolist()))

    def initial_memory(self, position: Row) -> KalmanMemory:
        """Return the memory of the law for a vehicle at rest; see `DisturbanceLaw`."""
        return KalmanMemory(position, 0.0, 0.0)

    def correct(self, memory: KalmanMemory, measured: AxisMeasurement, period: float) -> KalmanMemory:
        """Return the corrected state estimate x̂ + L (y - p̂); see `DisturbanceLaw`."""
        innovation = measured.position - memory.position
        return KalmanMemory._make(known + gain * innovation for known, gain in zip(memory, self.gain, strict=True))

    def predict(self, memory: KalmanMemory, increment: ModelIncrement, period: float) -> KalmanMemory:
        """Return the state that the Kalman filter predicts for the next tick; see `DisturbanceLaw`."""
        position, velocity, disturbance = memory
        after, speed, distance = lag_step(disturbance, 0.0, self.time_constant, period)
        return KalmanMemory(
            position + period * velocity + distance + increment.distance, velocity + speed + increment.velocity, after
        )


def _disturbed_motion(deviation: float, time_constant: float, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the transition matrix of (p, v, d) over a tick, and the covariance of the process noise.

    C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Transactions on Automatic Control
    23(3), 1978.
    """
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / time_constant]])
    density = np.diag([0.0, 0.0, 2.0 * deviation**2 / time_constant])
    upper, lower = np.vsplit(scipy.linalg.expm(period * np.block([[-A, density], [np.zeros((3, 3)), A.T]])), 2)
    _, noise = np.hsplit(upper, 2)
    _, transposed = np.hsplit(lower, 2)
    return transposed.T, transposed.T @ noise


class DifferencedMemory(NamedTuple):
    """Memory of a law that differentiates the measured velocity.

    Attributes:
        velocity: measured velocity at the previous tick, m/s.
        modelled: modelled change of the velocity since the previous tick, m/s.
        disturbance: disturbance d, which is the output of the law's filter, m/s².
        rate: derivative of d, m/s³; zero for a first-order filter.
    """

    velocity: Row
    modelled: Row
    disturbance: Row
    rate: Row


def _differenced_memory_at_rest(position: Row) -> DifferencedMemory:
    return DifferencedMemory(0.0, 0.0, 0.0, 0.0)


def _residual(memory: DifferencedMemory, velocity: Row, period: float) -> Row:
    """Return the mean unmodelled acceleration over the last tick, m/s²."""
    return (velocity - memory.velocity - memory.modelled) / period


class AdaptiveLaw(NamedTuple):
    """L1 adaptive augmentation with piecewise-constant adaptation, on the velocity.

        v̂' = a + σ̂ - a_s ṽ,    ṽ = v̂ - v,    σ̂ = -Φ⁻¹ exp(-a_s h) ṽ at each tick,    Φ = (1 - exp(-a_s h)) / a_s

    d is σ̂ filtered by C(s) = ω / (s + ω) (N. Hovakimyan and C. Cao, "L1 Adaptive Control Theory", 2010, section 3.3;
    Z. Wu et al., "L1Quad", IEEE TCST, 2025). During each tick the adaptation cancels the value of ṽ at the start of the
    tick. If v is linear between two measurements, the value of ṽ at the end of the tick is therefore due only to the
    part of the velocity change that the model does not explain: ṽ = -Φ (Δv - ∫a) / h. The method is the subject of US
    patent 8,712,559.

    Attributes:
        adaptation: adaptation rate a_s, 1/s.
        bandwidth: bandwidth ω of the filter, rad/s.
    """

    adaptation: Row
    bandwidth: Row

    def initial_memory(self, position: Row) -> DifferencedMemory:
        """Return the memory of the law for a vehicle at rest; see `DisturbanceLaw`."""
        return _differenced_memory_at_rest(position)

    def correct(self, memory: DifferencedMemory, measured: AxisMeasurement, period: float) -> DifferencedMemory:
        """Return the memory after adaptation; σ̂ is held constant over the tick. See `DisturbanceLaw`."""
        decay = exp(-self.adaptation * period)
        phi = (1.0 - decay) / self.adaptation
        prediction_error = -phi * _residual(memory, measured.velocity, period)
        sigma = -decay / phi * prediction_error
        filtered = sigma + exp(-self.bandwidth * period) * (memory.disturbance - sigma)
        return DifferencedMemory(measured.velocity, 0.0, filtered, 0.0)

    def predict(self, memory: DifferencedMemory, increment: ModelIncrement, period: float) -> DifferencedMemory:
        """Return the memory for the next tick, which contains the modelled change of the velocity until then."""
        return memory._replace(modelled=increment.velocity)


class IncrementalLaw(NamedTuple):
    """Incremental nonlinear dynamic inversion: command = a_f + (a_c - v'_f), and therefore d = H (v' - a).

    a_c is the desired acceleration. a_f and v'_f are the modelled and the measured acceleration, both filtered by

        H(s) = ω² / (s² + √2 ω s + ω²)

    so that they have the same delay (E. J. J. Smeur, Q. P. Chu and G. C. H. E. de Croon, JGCD 39, 2016; E. J. J.
    Smeur, G. C. H. E. de Croon and Q. P. Chu, Control Engineering Practice 73, 2018; E. Tal and S. Karaman, IEEE TCST
    29, 2021). The difference v' - a is averaged over each tick.

    Attributes:
        bandwidth: bandwidth ω of the filter, rad/s.
    """

    bandwidth: Row

    def initial_memory(self, position: Row) -> DifferencedMemory:
        """Return the memory of the law for a vehicle at rest; see `DisturbanceLaw`."""
        return _differenced_memory_at_rest(position)

    def correct(self, memory: DifferencedMemory, measured: AxisMeasurement, period: float) -> DifferencedMemory:
        """Return the memory after one exact step of the filter with a constant input; see `DisturbanceLaw`."""
        residual = _residual(memory, measured.velocity, period)
        damped = self.bandwidth * math.sqrt(0.5)
        sine, cosine = sin_cos(damped * period)
        decay = exp(-damped * period)
        offset, rate = memory.disturbance - residual, memory.rate
        return DifferencedMemory(
            measured.velocity,
            0.0,
            residual + decay * ((cosine + sine) * offset + sine / damped * rate),
            decay * ((cosine - sine) * rate - 2.0 * damped * sine * offset),
        )

    def predict(self, memory: DifferencedMemory, increment: ModelIncrement, period: float) -> DifferencedMemory:
        """Return the memory for the next tick, which contains the modelled change of the velocity until then."""
        return memory._replace(modelled=increment.velocity)
