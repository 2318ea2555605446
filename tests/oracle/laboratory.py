"""Cameras and radio link."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from oracle.randomness import NOISE, Stream
from oracle.vehicle import euler_to_body, rotation


class DelayLine:
    """Delay by a whole number of ticks.

    Args:
        first: initial output of the line.
        delay: delay, ticks.
    """

    def __init__(self, first, delay):
        self.waiting = [first] * (int(delay) + 1)

    @property
    def newest(self):
        return self.waiting[-1]

    @property
    def out(self):
        return self.waiting[0]

    def put(self, value):
        self.waiting = [*self.waiting[1:], value]


class Link(DelayLine):
    """Radio link that samples a command at each tick. If a packet is lost, the previous command is repeated.

    Args:
        parameters: command link of the scenario.
        hover: initial output.
        seed: seed of the study.
        sample: index of the sample in the study.
    """

    def __init__(self, parameters, hover, seed, sample):
        super().__init__(hover, parameters.delay_ticks)
        self.loss_rate = parameters.loss_rate
        self.stream = Stream(seed, sample, NOISE, "command_link.packet_loss", 1)

    def send(self, tick, wrench):
        lost = self.loss_rate > 0.0 and self.stream.uniform(tick)[0] < self.loss_rate
        self.put(self.newest if lost else wrench)


class Cameras(DelayLine):
    """Cameras that measure the pose of misaligned markers with noise, and filters that estimate rates.

    Args:
        parameters: motion capture of the scenario.
        seed: seed of the study.
        sample: index of the sample in the study.
        state: initial state of the vehicle, which the first frame shows.
    """

    def __init__(self, parameters, seed, sample, state):
        self.parameters, self.R_BM = parameters, rotation(*parameters.misalignment)
        self.noise = Stream(seed, sample, NOISE, "motion_capture.camera_noise", 6)
        self.loss = Stream(seed, sample, NOISE, "motion_capture.dropout", 1)
        self.drift_noise = Stream(seed, sample, NOISE, "motion_capture.velocity_drift", 3)
        self.drift, self.drifts = np.zeros(3), any(parameters.velocity_drift)
        pose = self.pose(0, state)
        self.factors = np.array([*(1.0 + fraction for fraction in parameters.velocity_error), 1.0, 1.0, 1.0])
        rates = self.factors * state[6:12] if parameters.derivative_bandwidth is None else np.zeros(6)
        self.previous_pose = pose
        super().__init__(np.concatenate([pose, rates]), parameters.latency_frames)

    def pose(self, k, state):
        """Return the measured position and attitude of the markers in frame k."""
        yaw = state[5]
        R_WM = rotation(*state[3:6]) @ self.R_BM
        turn = math.atan2(R_WM[1, 0], R_WM[0, 0]) - yaw  # from the body to the markers; the yaw is not wrapped
        attitude = [
            math.atan2(R_WM[2, 1], R_WM[2, 2]),
            -math.asin(R_WM[2, 0]),
            yaw + math.remainder(turn, math.tau),
        ]
        deviations = np.repeat([self.parameters.position_noise, self.parameters.attitude_noise], 3)
        return np.concatenate([state[0:3], attitude]) + deviations * self.noise.normal(k)

    def measure(self, k, state):
        """Measure the state of the vehicle in camera frame k."""
        parameters, last = self.parameters, self.newest
        lost = parameters.dropout_rate > 0.0 and self.loss.uniform(k)[0] < parameters.dropout_rate
        pose = last[0:6] if lost else self.pose(k, state)
        drift_before = np.concatenate([self.drift, np.zeros(3)])
        if self.drifts:
            d = math.exp(-parameters.period / parameters.drift_time)
            noise_deviations = np.array(parameters.velocity_drift) * math.sqrt(1.0 - d * d)
            self.drift = d * self.drift + noise_deviations * self.drift_noise.normal(k)
        drift = np.concatenate([self.drift, np.zeros(3)])
        if parameters.derivative_bandwidth is None:
            self.put(last if lost else np.concatenate([pose, self.factors * state[6:12] + drift]))
            return
        h = parameters.period
        a = math.exp(-parameters.derivative_bandwidth * h)
        # Velocities and rates follow from the change of the pose over two frames. If the change of the angles is small,
        # eq (2) at the middle frame converts it to body axes. Otherwise it is replaced by the rotation vector between
        # the two attitudes.
        steps = pose - self.previous_pose
        if np.abs(steps[3:6]).max() > 0.05:
            turn = rotation(*self.previous_pose[3:6]).T @ rotation(*pose[3:6])
            steps[3:6] = Rotation.from_matrix(turn).as_rotvec()
        else:
            steps[3:6] = euler_to_body(last[3], last[4]) @ steps[3:6]
        rates = a * (last[6:12] - drift_before) + (1.0 - a) * self.factors * steps / (2.0 * h) + drift
        self.previous_pose = last[0:6]
        self.put(np.concatenate([pose, rates]))
