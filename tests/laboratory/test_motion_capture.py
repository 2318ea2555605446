"""Tests that cameras and their filters agree with theory."""

import math

import numpy as np
import pytest
import scipy
from noise_feed import feed_noise
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.spatial.transform import Rotation

from drake_quad.geometry.axes import BodyAxes
from drake_quad.geometry.kinematics import small_rotation
from drake_quad.laboratory.motion_capture import (
    CameraParameters,
    Cameras,
    MotionCapture,
    Pose,
    VelocityDrift,
    VelocityError,
    _rotation,
    attitude_of_markers,
    measured_pose,
)
from drake_quad.randomness.streams import Samples, StreamKind
from drake_quad.signals import Attitude, State

H = 0.01  # s, time between two camera frames


def measurements_of(state, camera, *, duration, n=1):
    """Return the times of frames and the (12, n, ticks) measurements just before them, for a state trajectory."""
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("state", TrajectorySource(state))
    cameras = builder.AddNamedSystem("cameras", camera)
    builder.Connect(source.get_output_port(), cameras.GetInputPort("state"))
    feed_noise(builder, cameras, StreamKind.NOISE, Samples(1, range(n)))
    log = LogVectorOutput(cameras.GetOutputPort("measurement"), builder, publish_period=H)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    log_data = log.FindLog(simulator.get_context())
    return log_data.sample_times(), log_data.data().reshape(12, n, -1)


def state_at_rest(n=1):
    state = np.tile(np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3] + [0.0] * 6)[:, None], n)
    return PiecewisePolynomial(state.reshape(-1, 1))


def camera_with_filter(bandwidth, **structure):
    return MotionCapture(filtered=True, parameters=CameraParameters(derivative_bandwidth=bandwidth), **structure)


def state_ramp(rates):
    """Return a state whose six coordinates grow linearly from zero."""
    rows = np.zeros((12, 2))
    rows[:6, 1] = 100.0 * np.array(rates)
    return PiecewisePolynomial.FirstOrderHold([0.0, 100.0], rows)


def test_pose_noise_has_the_given_deviation_and_zero_mean():
    n = 40
    parameters = CameraParameters(position_noise=1e-3, attitude_noise=4e-3)
    _, frames = measurements_of(
        state_at_rest(n), MotionCapture(num_vehicles=n, noisy=True, parameters=parameters), duration=5.0, n=n
    )
    np.testing.assert_allclose(frames[:3].std(axis=(1, 2)), 1e-3, rtol=0.03)
    np.testing.assert_allclose(frames[3:6].std(axis=(1, 2)), 4e-3, rtol=0.03)
    np.testing.assert_allclose(frames[:6].mean(axis=(1, 2)), [1.0, 2.0, 3.0, 0.1, -0.2, 0.3], atol=1e-4)
    np.testing.assert_array_equal(frames[6:], 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("bandwidth", [20.0, 100.0])
def test_the_velocity_noise_has_the_spectrum_of_the_filter(bandwidth):
    """The filter (1 - a) / 2h (1 - z⁻²) / (1 - a z⁻¹) gives white noise the variance σ² (1 - a)² / 2h²."""
    n, sigma = 60, 1e-3
    parameters = CameraParameters(sigma, derivative_bandwidth=bandwidth)
    camera = MotionCapture(num_vehicles=n, noisy=True, filtered=True, parameters=parameters)
    _, frames = measurements_of(state_at_rest(n), camera, duration=40.0, n=n)
    velocity = frames[6, :, 200:]
    decay = math.exp(-bandwidth * H)
    gain = (1.0 - decay) / (2.0 * H)
    assert velocity.std() == pytest.approx(sigma * gain * math.sqrt(2.0), rel=0.01)
    frequency, density = scipy.signal.welch(velocity, fs=1.0 / H, nperseg=512, axis=1, detrend=False)
    z = np.exp(-2j * np.pi * frequency * H)
    theory = 2.0 * sigma**2 * H * np.abs(gain * (1.0 - z**2) / (1.0 - decay * z)) ** 2
    for low in range(4, 240, 20):
        band = slice(low, low + 20)
        assert density.mean(axis=0)[band].mean() == pytest.approx(theory[band].mean(), rel=0.05)


def test_the_velocity_noise_cancels_in_the_mean_over_every_second_frame():
    """The mean velocity over 4 s is a difference of two positions divided by 4 s, so its noise is smaller than the mean
    of 200 independent velocity errors."""
    n, sigma = 200, 1e-3
    parameters = CameraParameters(sigma, derivative_bandwidth=100.0)
    camera = MotionCapture(num_vehicles=n, noisy=True, filtered=True, parameters=parameters)
    _, frames = measurements_of(state_at_rest(n), camera, duration=5.0, n=n)
    mean = frames[6, :, -400::2].mean(axis=1)
    # The differences add up to the last minus the first position, so the noise in between cancels.
    assert mean.std() < 2.0 * sigma / 4.0
    assert mean.std() < 0.1 * frames[6, :, 100:].std() / math.sqrt(200)


def test_the_velocity_filter_is_a_first_order_lag():
    rates = [0.5, -1.0, 2.0, 0.0, 0.0, 0.0]
    time, frames = measurements_of(state_ramp(rates), camera_with_filter(25.0), duration=1.0)
    # The value logged at a tick is from the previous frame. The filter is a first-order lag of differences over two
    # frames. Its output is the mean of the lag's step responses at the last two frames.
    response, response_of_previous_frame = (
        1.0 - np.exp(-25.0 * np.maximum(time - delay, 0.0)) for delay in (H, 2.0 * H)
    )
    np.testing.assert_allclose(
        frames[6:9, 0], np.outer(rates[:3], 0.5 * (response + response_of_previous_frame)), atol=1e-12
    )


def test_body_rates_agree_with_the_rotation_of_the_body():
    """Roll, pitch and yaw change at the same time. Body rates agree with Drake's angular velocity."""
    rates = np.array([0.3, -0.2, 0.5])
    time, frames = measurements_of(state_ramp([0.0, 0.0, 0.0, *rates]), camera_with_filter(400.0), duration=2.0)
    for tick in (60, 120, 199):
        # A difference over two frames gives the rate at the middle frame. The filter adds a lag of a few milliseconds.
        attitude = RollPitchYaw(rates * (time[tick] - H))
        w_WB_W = attitude.CalcAngularVelocityInParentFromRpyDt(rates)
        expected = attitude.ToRotationMatrix().inverse() @ w_WB_W
        np.testing.assert_allclose(frames[9:12, 0, tick], expected, atol=2e-3)


def test_angle_differences_become_body_rates_with_the_attitude_of_the_middle_frame():
    """Body rates agree with Drake's angular velocity at the middle one of three frames. The filter has no effect."""
    rates = np.array([0.3, -0.2, 0.5])
    time, frames = measurements_of(state_ramp([0.0, 0.0, 0.0, *rates]), camera_with_filter(1e4), duration=2.0)
    for tick in (60, 120, 199):
        # The value logged at a tick belongs to the previous frame, and is the difference between this frame and the
        # frame two periods before it.
        middle = RollPitchYaw(rates * (time[tick] - 2.0 * H))
        expected = middle.CalcAngularVelocityInChildFromRpyDt(rates)
        np.testing.assert_allclose(frames[9:12, 0, tick], expected, atol=1e-12)


@pytest.mark.parametrize("misaligned", [False, True])
@pytest.mark.parametrize(
    "body_rates", [(0.0, 6.0, 0.0), (0.0, 6.0, 0.05), (1.0, -5.0, 0.4), (8.0, 0.0, 0.0), (3.0, 4.0, 7.0)]
)
def test_body_rates_are_correct_for_a_body_that_turns_over(body_rates, misaligned):
    """The body turns at constant rates and passes pitches of ±90° and rolls of ±180°, where angles jump."""
    times = H * np.arange(210)
    initial_rotation = Rotation.from_euler("ZYX", [0.4, 0.0, 0.0])
    rotations = initial_rotation * scipy.spatial.transform.Rotation.from_rotvec(np.outer(times, body_rates))
    state = np.zeros((12, len(times)))
    state[3:6] = rotations.as_euler("ZYX")[:, ::-1].T
    assert np.abs(np.diff(state[3:6], axis=1)).max() > 3.0
    misalignment = Attitude(0.1, -0.05, 0.2)
    parameters = CameraParameters(
        derivative_bandwidth=1e4, misalignment=misalignment if misaligned else Attitude(0.0, 0.0, 0.0)
    )
    trajectory = PiecewisePolynomial.ZeroOrderHold(times, state)
    _, frames = measurements_of(
        trajectory, MotionCapture(filtered=True, misaligned=misaligned, parameters=parameters), duration=2.0
    )
    expected = np.array(body_rates)
    if misaligned:
        expected = Rotation.from_euler("ZYX", misalignment[::-1]).inv().apply(expected)
    np.testing.assert_allclose(frames[9:12, 0, 4:], np.tile(expected[:, None], frames.shape[2] - 4), atol=0.02)


@pytest.mark.parametrize("change", [0.3, -0.3, 0.06, -0.06])
@pytest.mark.parametrize("angle", ["roll", "pitch", "yaw"])
def test_a_large_angle_change_is_measured_as_a_rotation_vector(angle, change):
    """One angle changes at a time, in both directions. A small change agrees with eq (2)."""
    before = Pose(0.0, 0.0, 0.0, 0.2, -0.4, 0.7)
    after = before._replace(**{angle: getattr(before, angle) + change})
    rotations = [Rotation.from_euler("ZYX", (p.yaw, p.pitch, p.roll)) for p in (before, after)]
    expected = (rotations[0].inv() * rotations[1]).as_rotvec()
    middle = Attitude(before.roll, before.pitch, before.yaw)
    np.testing.assert_allclose(_rotation(before, middle, after), expected, atol=1e-12)
    after_small_change = before._replace(**{angle: getattr(before, angle) + 0.1 * change})
    steps = Attitude(0.0, 0.0, 0.0)._replace(**{angle: 0.1 * change})
    np.testing.assert_allclose(_rotation(before, middle, after_small_change), small_rotation(steps, middle), atol=1e-12)


def test_the_measured_attitude_of_markers_at_a_pitch_of_90_degrees_is_finite():
    """Rounding errors can make the sine of the pitch slightly larger than 1."""
    rng = np.random.default_rng(7)
    for _ in range(200):
        misalignment = Attitude(*rng.uniform(-0.3, 0.3, 3))
        vertical = Rotation.from_euler("ZYX", [rng.uniform(-3.0, 3.0), 0.5 * np.pi, 0.0])
        body = vertical * Rotation.from_euler("ZYX", misalignment[::-1]).inv()
        attitude = Attitude(*body.as_euler("ZYX")[::-1].tolist())
        result = attitude_of_markers(attitude, BodyAxes.of(*misalignment))
        matrix = Rotation.from_euler("ZYX", result[::-1]).as_matrix()
        np.testing.assert_allclose(matrix, vertical.as_matrix(), atol=1e-7)


def test_a_frame_without_errors_equals_the_state():
    """The values are exactly equal, even if the cameras have ports for noise and states for delayed frames."""
    rng = np.random.default_rng(0)
    state = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], rng.normal(size=(12, 2)))
    time, ideal = measurements_of(state, MotionCapture(), duration=1.0)
    np.testing.assert_allclose(ideal[:, 0], state.vector_values(np.maximum(time - H, 0.0)), atol=1e-14)
    _, real = measurements_of(state, MotionCapture(noisy=True, loses_frames=True, longest_latency=3), duration=1.0)
    np.testing.assert_array_equal(real, ideal)
    _, misaligned = measurements_of(state, MotionCapture(misaligned=True), duration=1.0)
    # Roll and pitch stay below 90°, where the angles of a rotation are unique.
    assert np.abs(ideal[3:5]).max() < 1.5
    np.testing.assert_allclose(misaligned, ideal, atol=1e-14)


def test_measurements_are_delayed_by_a_whole_number_of_frames():
    rates = [1.0] * 6
    latency = np.array([0, 3, 1])
    rows = state_ramp(rates).vector_values([0.0, 100.0])
    state = PiecewisePolynomial.FirstOrderHold([0.0, 100.0], np.repeat(rows, 3, axis=0))
    camera = MotionCapture(num_vehicles=3, longest_latency=3, parameters=CameraParameters(latency_frames=latency))
    time, frames = measurements_of(state, camera, duration=0.2, n=3)
    expected = np.maximum(time[None] - H * (1 + latency[:, None]), 0.0)
    np.testing.assert_allclose(frames[0], expected, atol=1e-12)


@pytest.mark.parametrize("bandwidth", [None, 50.0])
def test_the_output_is_the_initial_frame_until_the_first_frame_arrives(bandwidth):
    """The initial frame contains velocity and body rates if there is no filter. Both are zero if there is a filter."""
    start = np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7, -0.8, 0.9])
    parameters = CameraParameters(derivative_bandwidth=bandwidth or 0.0, latency_frames=4)
    camera = MotionCapture(filtered=bandwidth is not None, longest_latency=4, parameters=parameters)
    _, frames = measurements_of(PiecewisePolynomial(start[:, None]), camera, duration=0.1)
    expected = start if bandwidth is None else np.concatenate([start[:6], np.zeros(6)])
    np.testing.assert_array_equal(frames[:, 0], np.repeat(expected[:, None], frames.shape[2], axis=1))


def test_a_lost_frame_repeats_the_previous_frame():
    n, rate = 30, 0.2
    state = PiecewisePolynomial.FirstOrderHold([0.0, 100.0], np.outer(np.ones(12 * n), [0.0, 100.0]))
    parameters = CameraParameters(dropout_rate=rate, derivative_bandwidth=30.0)
    camera = MotionCapture(num_vehicles=n, loses_frames=True, parameters=parameters)
    time, frames = measurements_of(state, camera, duration=10.0, n=n)
    steps = np.diff(frames[0, :, 2:], axis=1)
    lost = np.abs(steps) < 1e-9
    assert lost.mean() == pytest.approx(rate, abs=4.0 * math.sqrt(rate * (1.0 - rate) / lost.size))
    # The frame after a lost one is up to date.
    is_current = np.abs(frames[0] - (time - H)) < 1e-9
    np.testing.assert_array_equal(is_current[:, 3:], ~lost)
    # While frames are lost, the filter measures no motion. Afterwards, it measures all of the motion at once.
    filtered = MotionCapture(num_vehicles=n, loses_frames=True, filtered=True, parameters=parameters)
    _, frames = measurements_of(state, filtered, duration=10.0, n=n)
    assert frames[6, :, 100:].mean() == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.3, -0.7, 2.5), (-1.2, 1.1, -3.0)])
def test_misaligned_markers_rotate_with_the_body(attitude):
    """The measured rotation agrees with R_WB R_BM computed from Drake's rotation matrices."""
    misalignment = (0.05, -0.08, 0.2)
    expected = RollPitchYaw(attitude).ToRotationMatrix() @ RollPitchYaw(misalignment).ToRotationMatrix()
    measured = RollPitchYaw(*attitude_of_markers(Attitude(*attitude), BodyAxes.of(*misalignment))).ToRotationMatrix()
    np.testing.assert_allclose(measured.matrix(), expected.matrix(), atol=1e-14)


def test_cameras_measure_the_attitude_of_the_markers():
    """Each vehicle has its own misalignment. Position, velocity and body rates are not affected."""
    rolls = np.array([0.05, -0.1])
    parameters = CameraParameters(misalignment=Attitude(rolls, -0.08, 0.2))
    state = np.tile([1.0, 2.0, 3.0, 0.1, -0.2, 0.3, 0.4, -0.5, 0.6, -0.7, 0.8, -0.9], (2, 1)).T
    camera = MotionCapture(num_vehicles=2, misaligned=True, parameters=parameters)
    _, frames = measurements_of(PiecewisePolynomial(state.reshape(-1, 1)), camera, duration=0.05, n=2)
    for i, roll in enumerate(rolls):
        marker_rotation = (
            RollPitchYaw(0.1, -0.2, 0.3).ToRotationMatrix() @ RollPitchYaw(roll, -0.08, 0.2).ToRotationMatrix()
        )
        expected = np.concatenate([state[:3, i], RollPitchYaw(marker_rotation).vector(), state[6:, i]])
        np.testing.assert_allclose(frames[:, i, -1], expected, atol=1e-14)


def test_each_component_of_the_pose_has_independent_noise():
    noise = Pose(1.0, -2.0, 3.0, -4.0, 5.0, -6.0)
    state = State(1.0, 2.0, 3.0, 0.01, 0.02, 0.03, *[9.0] * 6)
    cameras = Cameras.of(CameraParameters(position_noise=0.1, attitude_noise=0.5))
    pose = measured_pose(state, noise, cameras, misaligned=True)
    np.testing.assert_allclose(pose, Pose(1.1, 1.8, 3.3, -1.99, 2.52, -2.97))


@pytest.mark.parametrize("filtered", [False, True])
def test_only_the_velocity_has_a_scale_error(filtered):
    """Each vehicle has its own error on each axis, with and without a filter that estimates the velocity."""
    fractions = np.array([[0.1, -0.2, 0.05], [0.3, 0.0, -0.1]])
    state = np.random.default_rng(3).normal(scale=0.3, size=(12, 3))
    trajectory = PiecewisePolynomial.FirstOrderHold([0.0, 1.0, 2.0], np.repeat(state, 2, axis=0))
    parameters = CameraParameters(derivative_bandwidth=40.0)
    numbers_with_errors = parameters._replace(velocity_error=VelocityError(*fractions.T))
    _, exact_frames = measurements_of(
        trajectory, MotionCapture(num_vehicles=2, filtered=filtered, parameters=parameters), duration=2.0, n=2
    )
    camera = MotionCapture(num_vehicles=2, filtered=filtered, velocity_scaled=True, parameters=numbers_with_errors)
    _, frames = measurements_of(trajectory, camera, duration=2.0, n=2)
    expected = exact_frames.copy()
    expected[6:9] *= 1.0 + fractions.T[:, :, None]
    assert np.abs(expected - exact_frames).max() > 0.01
    np.testing.assert_allclose(frames, expected, atol=1e-13)


def test_the_velocity_drift_has_the_given_deviation_and_correlation_time():
    """The correlation between successive frames is exp(-h / T). Only the velocity changes."""
    state = np.tile(np.arange(12.0)[:, None] * 0.1, 2)
    trajectory = PiecewisePolynomial.FirstOrderHold([0.0, 100.0], state)
    parameters = CameraParameters(velocity_drift=VelocityDrift(0.03, 0.01, 0.0), drift_time=0.1)
    _, frames = measurements_of(trajectory, MotionCapture(drifts=True, parameters=parameters), duration=100.0, n=1)
    errors = frames[:, 0] - state[:, :1]
    assert np.abs(np.delete(errors, [6, 7], axis=0)).max() < 1e-12
    for velocity_row, deviation in ((6, 0.03), (7, 0.01)):
        drift = errors[velocity_row, 100:]
        assert drift.std() == pytest.approx(deviation, rel=0.15)
        assert np.corrcoef(drift[:-1], drift[1:])[0, 1] == pytest.approx(np.exp(-0.1), abs=0.02)
