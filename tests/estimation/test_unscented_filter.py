"""Comparison of the error-state Kalman filter with an unscented filter of the library filterpy on the same readings.

The unscented filter needs no derivatives: it propagates points through the nonlinear equations, which are written here
with rotation matrices. Both filters describe the same errors, so estimates and covariances must agree up to the effect
of the nonlinearity over the uncertainty of the estimate.
"""

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.spatial.transform import Rotation
from test_error_state_filter import (
    DEVIATIONS,
    GRAVITY,
    INITIAL,
    NOISE,
    H,
    advance,
    figure_eight,
    innovation_of,
    make_filter,
    matrices,
    reading_of,
    start,
)

from drake_quad.estimation.error_state_filter import Aiding

PROCESS_NOISE = H * np.square(
    np.repeat([0.0, NOISE.accelerometer, NOISE.gyroscope, NOISE.gyroscope_walk, NOISE.accelerometer_walk], 3)
)


class NoNoise:
    """Substitute for a random generator that returns zeros."""

    @staticmethod
    def standard_normal(size):
        return np.zeros(size)


class UnscentedFilter:
    """Unscented filter for the errors of position, velocity, rotation and biases around an estimate."""

    def __init__(self, kinds, p, v, R):
        self.p, self.v, self.R = p, v, R
        self.b_g, self.b_a = np.zeros(3), np.zeros(3)
        self.kinds = kinds
        points = MerweScaledSigmaPoints(15, alpha=0.1, beta=2.0, kappa=0.0)
        deviations = np.concatenate([DEVIATIONS[kind] for kind in kinds])
        self.filter = UnscentedKalmanFilter(15, len(deviations), H, lambda x: x, lambda x, dt: x, points)
        self.filter.P = np.diag(np.square(INITIAL))
        self.filter.R = np.diag(np.square(deviations))

    def states(self, error):
        """Return the state that differs from the estimate by an error."""
        turn = Rotation.from_rotvec(error[6:9]).as_matrix()
        return self.p + error[:3], self.v + error[3:6], turn @ self.R, self.b_g + error[9:12], self.b_a + error[12:15]

    def reset(self):
        """Move the estimated error to the estimate."""
        self.p, self.v, self.R, self.b_g, self.b_a = self.states(self.filter.x)
        self.filter.x = np.zeros(15)

    def predict(self, gyroscope, accelerometer):
        def moved(p, v, R, b_g, b_a):
            turn = H * (gyroscope - b_g)
            middle = R @ Rotation.from_rotvec(0.5 * turn).as_matrix()
            after = v + H * (middle @ (accelerometer - b_a) - [0.0, 0.0, GRAVITY])
            return p + 0.5 * H * (v + after), after, R @ Rotation.from_rotvec(turn).as_matrix(), b_g, b_a

        nominal = moved(self.p, self.v, self.R, self.b_g, self.b_a)

        def propagate(error, dt):
            p, v, R, b_g, b_a = moved(*self.states(error))
            rotation = Rotation.from_matrix(R @ nominal[2].T).as_rotvec()
            return np.hstack([p - nominal[0], v - nominal[1], rotation, b_g - nominal[3], b_a - nominal[4]])

        self.filter.Q = np.diag(PROCESS_NOISE)
        self.filter.predict(fx=propagate)
        self.p, self.v, self.R, self.b_g, self.b_a = nominal
        self.reset()

    def update(self, readings, gyroscope):
        # The points of the prediction are replaced, since the estimate has been reset.
        self.filter.Q = np.zeros((15, 15))
        self.filter.predict(fx=lambda error, dt: error)
        innovations = [innovation_of(kind, readings[kind], gyroscope) for kind in self.kinds]

        def measured(error):
            return -np.hstack([innovation(*self.states(error)) for innovation in innovations])

        self.filter.update(np.zeros(len(self.filter.R)), hx=measured)
        self.reset()


# The tolerance is larger for measurements that depend nonlinearly on the state, since the uncertainty of the initial
# estimate is large.
@pytest.mark.long
@pytest.mark.parametrize(
    ("kinds", "tolerance"),
    [(("position", "velocity"), 0.06), (("pose",), 0.06), (("anchor_distance", "flow", "ground_distance"), 0.2)],
    ids=["position and velocity", "pose", "distances and flow"],
)
def test_estimates_and_covariances_agree_with_an_unscented_filter(kinds, tolerance):
    generator = np.random.default_rng(7)
    motion = figure_eight(6.0)
    error = 0.3 * np.array(INITIAL) * generator.standard_normal(15)
    p, v = motion.position[0] - error[:3], motion.velocity[0] - error[3:6]
    R = Rotation.from_rotvec(-error[6:9]).as_matrix() @ motion.rotations[0]
    system = make_filter(*[Aiding(kind, kind) for kind in kinds])
    context = start(system, p[None], v[None], R[None], np.zeros((1, 3)), np.zeros((1, 3)))
    reference = UnscentedFilter(kinds, p, v, R)
    differences, ratios, previous = [], [], None
    for k, (rates, force) in enumerate(zip(motion.rates, motion.forces, strict=True)):
        white = generator.standard_normal((2, 3)) / np.sqrt(H)
        gyroscope = rates + 0.01 + NOISE.gyroscope * white[0]
        accelerometer = force - 0.05 + NOISE.accelerometer * white[1]
        readings = {}
        for kind in kinds:
            true = reading_of(kind, motion.position[k], motion.velocity[k], motion.rotations[k], rates, NoNoise)
            noise = DEVIATIONS[kind] * generator.standard_normal(len(DEVIATIONS[kind]))
            readings[kind] = true + np.pad(noise, (0, len(true) - len(noise)))
        inertial = {"gyroscope": [gyroscope], "accelerometer": [accelerometer]}
        advance(system, context, inertial | {name: [reading] for name, reading in readings.items()})
        if previous is not None:
            reference.predict(*previous)
        reference.update(readings, gyroscope)
        previous = gyroscope, accelerometer
        estimate = system.get_state(context, "estimate")
        axes = np.array(estimate.attitude.axes()).T
        difference = np.hstack(
            [
                np.array(estimate.position) - reference.p,
                np.array(estimate.velocity) - reference.v,
                Rotation.from_matrix(axes @ reference.R.T).as_rotvec(),
                np.array(estimate.gyroscope_bias) - reference.b_g,
                np.array(estimate.accelerometer_bias) - reference.b_a,
            ]
        )
        covariance = matrices(system.get_state(context, "covariance"))[0]
        deviations = np.sqrt(np.diag(covariance))
        differences.append(abs(difference) / deviations)
        ratios.append(deviations / np.sqrt(np.diag(reference.filter.P)))
    assert np.max(differences) < tolerance
    np.testing.assert_allclose(ratios, 1.0, atol=0.02)
