"""Error-state Kalman filter in plain NumPy: dense matrices, derivatives by finite differences, rotation matrices.

It implements the same equations as `drake_quad.estimation` independently, for one vehicle: vector measurements are used
at once instead of one scalar at a time, in Joseph's form.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation


def skew(a):
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@dataclass
class DenseFilter:
    """State and covariance of the filter; errors are ordered p, v, rotation in W, gyroscope and accelerometer bias."""

    p: np.ndarray
    v: np.ndarray
    R: np.ndarray
    b_g: np.ndarray
    b_a: np.ndarray
    P: np.ndarray
    densities: tuple
    gravity: float
    duration: float = 0.0
    velocity_change: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rotations: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    def predict(self, gyroscope, accelerometer, period):
        rates = gyroscope - self.b_g
        mid_rotation = self.R @ Rotation.from_rotvec(0.5 * period * rates).as_matrix()
        change = period * mid_rotation @ (accelerometer - self.b_a)
        initial_velocity = self.v
        self.v = initial_velocity + change - np.array([0.0, 0.0, period * self.gravity])
        self.p = self.p + 0.5 * period * (initial_velocity + self.v)
        self.R = self.R @ Rotation.from_rotvec(period * rates).as_matrix()
        self.duration += period
        self.velocity_change = self.velocity_change + change
        self.rotations = self.rotations + period * mid_rotation

    def propagate(self):
        F, Q = np.eye(15), np.zeros((15, 15))
        F[0:3, 3:6] = self.duration * np.eye(3)
        F[3:6, 6:9] = -skew(self.velocity_change)
        F[3:6, 12:15] = F[6:9, 9:12] = -self.rotations
        gyroscope, accelerometer, gyroscope_walk, accelerometer_walk = self.densities
        for start, density in ((3, accelerometer), (6, gyroscope), (9, gyroscope_walk), (12, accelerometer_walk)):
            Q[start : start + 3, start : start + 3] = density**2 * self.duration * np.eye(3)
        self.P = F @ self.P @ F.T + Q
        self.duration, self.velocity_change, self.rotations = 0.0, np.zeros(3), np.zeros((3, 3))

    def with_error(self, error):
        """Return p, v, R, b_g and b_a after the errors are added."""
        R = Rotation.from_rotvec(error[6:9]).as_matrix() @ self.R
        return self.p + error[0:3], self.v + error[3:6], R, self.b_g + error[9:12], self.b_a + error[12:15]

    def correct(self, innovation_of, deviations, linearised=None):
        """Correct by a vector of measurements, and return the innovations, normalised one after another.

        The normalised innovations are L⁻¹ ν, where ν is the vector of innovations and L is the Cholesky factor of their
        covariance. Each of them is the part of an innovation that the innovations before it do not predict, divided by
        the standard deviation of this part.

        `innovation_of` is a function of p, v, R, b_g and b_a that returns measured minus predicted values. The
        derivatives are those of the function `linearised`, by default the same function.
        """
        linearised = linearised or innovation_of
        innovation, step = innovation_of(*self.with_error(np.zeros(15))), 1e-3
        # Derivatives by central differences of fourth order.
        points = [(-2.0, -1.0), (-1.0, 8.0), (1.0, -8.0), (2.0, 1.0)]
        H = np.array(
            [
                sum(weight * linearised(*self.with_error(k * step * unit)) for k, weight in points) / (12.0 * step)
                for unit in np.eye(15)
            ]
        ).T
        noise = np.diag(np.square(deviations))
        S = H @ self.P @ H.T + noise
        K = np.linalg.solve(S, H @ self.P).T
        self.p, self.v, self.R, self.b_g, self.b_a = self.with_error(K @ innovation)
        A = np.eye(15) - K @ H
        self.P = A @ self.P @ A.T + K @ noise @ K.T
        return np.linalg.solve(np.linalg.cholesky(S), innovation)
