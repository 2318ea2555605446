"""The cameras and their filters agree with theory."""

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
    CameraNumbers,
    Cameras,
    MotionCapture,
    Pose,
    VelocityDrift,
    VelocityError,
    _rotation,
    attitude_of_markers,
    measured_pose,
)
from drake_quad.randomness.noise import Samples
from drake_quad.randomness.streams import StreamKind
from drake_quad.signals import Attitude, State

H = 0.01


def seen(state, camera, *, duration, n=1):
    """Return times and (12, n, ticks) measurements of a trajectory of the state, as they are just before a frame."""
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("state", TrajectorySource(state))
    cameras = builder.AddNamedSystem("cameras", camera)
    builder.Connect(source.get_output_port(), cameras.GetInputPort("state"))
    feed_noise(builder, cameras, StreamKind.NOISE, Samples(1, range(n)))
    log = LogVectorOutput(cameras.GetOutputPort("measurement"), builder, publish_period=H)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    found = log.FindLog(simulator.get_context())
    return found.sample_times(), found.data().reshape(12, n, -1)


def still(n=1):
    state = np.tile(np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3] + [0.0] * 6)[:, None], n)
    return PiecewisePolynomial(state.reshape(-1, 1))


def filtering(bandwidth, **structure):
    return MotionCapture(filtered=True, numbers=CameraNumbers(derivative_bandwidth=bandwidth), **structure)


def ramp(rates):
    """Return a state whose six coordinates grow linearly from zero."""
    rows = np.zeros((12, 2))
    rows[:6, 1] = 100.0 * np.array(rates)
    return PiecewisePolynomial.FirstOrderHold([0.0, 100.0], rows)


def test_noise_has_the_stated_deviation_and_nothing_else():
    n = 40
    numbers = CameraNumbers(position_noise=1e-3, attitude_noise=4e-3)
    _, frames = seen(still(n), MotionCapture(num_vehicles=n, noisy=True, numbers=numbers), duration=5.0, n=n)
    np.testing.assert_allclose(frames[:3].std(axis=(1, 2)), 1e-3, rtol=0.03)
    np.testing.assert_allclose(frames[3:6].std(axis=(1, 2)), 4e-3, rtol=0.03)
    np.testing.assert_allclose(frames[:6].mean(axis=(1, 2)), [1.0, 2.0, 3.0, 0.1, -0.2, 0.3], atol=1e-4)
    np.testing.assert_array_equal(frames[6:], 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("bandwidth", [20.0, 100.0])
def test_the_velocity_noise_has_the_spectrum_of_the_filter(bandwidth):
    """White noise is filtered by (1 - a) / 2h (1 - z⁻²) / (1 - a z⁻¹); the variance is σ² (1 - a)² / 2h²."""
    n, sigma = 60, 1e-3
    numbers = CameraNumbers(sigma, derivative_bandwidth=bandwidth)
    camera = MotionCapture(num_vehicles=n, noisy=True, filtered=True, numbers=numbers)
    _, frames = seen(still(n), camera, duration=40.0, n=n)
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


def test_sampling_every_second_frame_aliases_no_noise_to_zero_frequency():
    """The mean velocity over 4 s has position noise over 4 s, not rate noise over √200."""
    n, sigma = 200, 1e-3
    numbers = CameraNumbers(sigma, derivative_bandwidth=100.0)
    camera = MotionCapture(num_vehicles=n, noisy=True, filtered=True, numbers=numbers)
    _, frames = seen(still(n), camera, duration=5.0, n=n)
    mean = frames[6, :, -400::2].mean(axis=1)
    # The sum telescopes: (x_end - x_begin) / 2h through the filter, over 200 readings.
    assert mean.std() < 2.0 * sigma / 4.0
    assert mean.std() < 0.1 * frames[6, :, 100:].std() / math.sqrt(200)


def test_the_filter_is_a_first_order_lag():
    rates = [0.5, -1.0, 2.0, 0.0, 0.0, 0.0]
    time, frames = seen(ramp(rates), filtering(25.0), duration=1.0)
    # The value logged at a tick is the frame before it. The difference over two frames is half a frame late. After a
    # start, the result is therefore the mean of the present lag and that of a frame ago.
    now, before = (1.0 - np.exp(-25.0 * np.maximum(time - late, 0.0)) for late in (H, 2.0 * H))
    np.testing.assert_allclose(frames[6:9, 0], np.outer(rates[:3], 0.5 * (now + before)), atol=1e-12)


def test_body_rates_are_those_of_the_rotating_body():
    """Roll, pitch and yaw change at the same time; the reference is Drake's angular velocity."""
    rates = np.array([0.3, -0.2, 0.5])
    time, frames = seen(ramp([0.0, 0.0, 0.0, *rates]), filtering(400.0), duration=2.0)
    for tick in (60, 120, 199):
        # A difference over a period is the rate at its middle, and the filter adds a lag of a few milliseconds.
        attitude = RollPitchYaw(rates * (time[tick] - H))
        w_WB_W = attitude.CalcAngularVelocityInParentFromRpyDt(rates)
        expected = attitude.ToRotationMatrix().inverse() @ w_WB_W
        np.testing.assert_allclose(frames[9:12, 0, tick], expected, atol=2e-3)


def test_angle_differences_are_converted_at_the_middle_frame():
    """The filter is so fast that it has no effect; the reference is Drake's angular velocity at that frame."""
    rates = np.array([0.3, -0.2, 0.5])
    time, frames = seen(ramp([0.0, 0.0, 0.0, *rates]), filtering(1e4), duration=2.0)
    for tick in (60, 120, 199):
        # The value logged at a tick is the frame before it, with the difference from two frames before that one.
        middle = RollPitchYaw(rates * (time[tick] - 2.0 * H))
        expected = middle.CalcAngularVelocityInChildFromRpyDt(rates)
        np.testing.assert_allclose(frames[9:12, 0, tick], expected, atol=1e-12)


@pytest.mark.parametrize("misaligned", [False, True])
@pytest.mark.parametrize(
    "turning", [(0.0, 6.0, 0.0), (0.0, 6.0, 0.05), (1.0, -5.0, 0.4), (8.0, 0.0, 0.0), (3.0, 4.0, 7.0)]
)
def test_body_rates_are_right_for_a_body_that_turns_over(turning, misaligned):
    """Constant rates lead through pitches of ±90° and rolls of ±180°, where angles jump. Markers rotate as the body."""
    times = H * np.arange(210)
    begun = Rotation.from_euler("ZYX", [0.4, 0.0, 0.0])
    turned = begun * scipy.spatial.transform.Rotation.from_rotvec(np.outer(times, turning))
    state = np.zeros((12, len(times)))
    state[3:6] = turned.as_euler("ZYX")[:, ::-1].T
    assert np.abs(np.diff(state[3:6], axis=1)).max() > 3.0
    off = Attitude(0.1, -0.05, 0.2)
    numbers = CameraNumbers(derivative_bandwidth=1e4, misalignment=off if misaligned else Attitude(0.0, 0.0, 0.0))
    held = PiecewisePolynomial.ZeroOrderHold(times, state)
    _, frames = seen(held, MotionCapture(filtered=True, misaligned=misaligned, numbers=numbers), duration=2.0)
    expected = np.array(turning)
    if misaligned:
        expected = Rotation.from_euler("ZYX", off[::-1]).inv().apply(expected)
    np.testing.assert_allclose(frames[9:12, 0, 4:], np.tile(expected[:, None], frames.shape[2] - 4), atol=0.02)


@pytest.mark.parametrize("change", [0.3, -0.3, 0.06, -0.06])
@pytest.mark.parametrize("angle", ["roll", "pitch", "yaw"])
def test_a_large_angle_change_is_measured_as_a_rotation_vector(angle, change):
    """Each angle changes alone, in both directions. A small change follows eq (2)."""
    before = Pose(0.0, 0.0, 0.0, 0.2, -0.4, 0.7)
    after = before._replace(**{angle: getattr(before, angle) + change})
    turns = [Rotation.from_euler("ZYX", (p.yaw, p.pitch, p.roll)) for p in (before, after)]
    expected = (turns[0].inv() * turns[1]).as_rotvec()
    middle = Attitude(before.roll, before.pitch, before.yaw)
    np.testing.assert_allclose(_rotation(before, middle, after), expected, atol=1e-12)
    slight = before._replace(**{angle: getattr(before, angle) + 0.1 * change})
    steps = Attitude(0.0, 0.0, 0.0)._replace(**{angle: 0.1 * change})
    np.testing.assert_allclose(_rotation(before, middle, slight), small_rotation(steps, middle), atol=1e-12)


def test_a_frame_of_markers_that_point_straight_up_is_finite():
    """Rounding makes the sine of their pitch slightly larger than 1."""
    rng = np.random.default_rng(7)
    for _ in range(200):
        misalignment = Attitude(*rng.uniform(-0.3, 0.3, 3))
        up = Rotation.from_euler("ZYX", [rng.uniform(-3.0, 3.0), 0.5 * np.pi, 0.0])
        body = up * Rotation.from_euler("ZYX", misalignment[::-1]).inv()
        attitude = Attitude(*body.as_euler("ZYX")[::-1].tolist())
        found = attitude_of_markers(attitude, BodyAxes.of(*misalignment))
        matrix = Rotation.from_euler("ZYX", found[::-1]).as_matrix()
        np.testing.assert_allclose(matrix, up.as_matrix(), atol=1e-7)


def test_a_frame_without_errors_is_the_state():
    """This holds exactly, even if the cameras have ports for noise and dropouts, latency and misalignment."""
    rng = np.random.default_rng(0)
    state = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], rng.normal(size=(12, 2)))
    time, ideal = seen(state, MotionCapture(), duration=1.0)
    np.testing.assert_allclose(ideal[:, 0], state.vector_values(np.maximum(time - H, 0.0)), atol=1e-14)
    _, real = seen(state, MotionCapture(noisy=True, loses_frames=True, longest_latency=3), duration=1.0)
    np.testing.assert_array_equal(real, ideal)
    _, turned = seen(state, MotionCapture(misaligned=True), duration=1.0)
    # The pitch is below a quarter turn, since other attitudes are returned as different angles of the same rotation.
    assert np.abs(ideal[3:5]).max() < 1.5
    np.testing.assert_allclose(turned, ideal, atol=1e-14)


def test_latency_is_a_whole_number_of_frames():
    rates = [1.0] * 6
    latency = np.array([0, 3, 1])
    line = ramp(rates).vector_values([0.0, 100.0])
    state = PiecewisePolynomial.FirstOrderHold([0.0, 100.0], np.repeat(line, 3, axis=0))
    camera = MotionCapture(num_vehicles=3, longest_latency=3, numbers=CameraNumbers(latency_frames=latency))
    time, frames = seen(state, camera, duration=0.2, n=3)
    expected = np.maximum(time[None] - H * (1 + latency[:, None]), 0.0)
    np.testing.assert_allclose(frames[0], expected, atol=1e-12)


@pytest.mark.parametrize("bandwidth", [None, 50.0])
def test_before_the_first_frame_arrives_the_output_is_the_initial_frame(bandwidth):
    """Without a filter it includes velocity and body rates; a filter starts at zero."""
    start = np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7, -0.8, 0.9])
    numbers = CameraNumbers(derivative_bandwidth=bandwidth or 0.0, latency_frames=4)
    camera = MotionCapture(filtered=bandwidth is not None, longest_latency=4, numbers=numbers)
    _, frames = seen(PiecewisePolynomial(start[:, None]), camera, duration=0.1)
    shown = start if bandwidth is None else np.concatenate([start[:6], np.zeros(6)])
    np.testing.assert_array_equal(frames[:, 0], np.repeat(shown[:, None], frames.shape[2], axis=1))


def test_lost_frames_repeat_the_one_before():
    n, rate = 30, 0.2
    state = PiecewisePolynomial.FirstOrderHold([0.0, 100.0], np.outer(np.ones(12 * n), [0.0, 100.0]))
    numbers = CameraNumbers(dropout_rate=rate, derivative_bandwidth=30.0)
    camera = MotionCapture(num_vehicles=n, loses_frames=True, numbers=numbers)
    time, frames = seen(state, camera, duration=10.0, n=n)
    steps = np.diff(frames[0, :, 2:], axis=1)
    lost = np.abs(steps) < 1e-9
    assert lost.mean() == pytest.approx(rate, abs=4.0 * math.sqrt(rate * (1.0 - rate) / lost.size))
    # The frame after a lost one is up to date.
    fresh = np.abs(frames[0] - (time - H)) < 1e-9
    np.testing.assert_array_equal(fresh[:, 3:], ~lost)
    # While frames are lost, the filter sees no motion. Afterwards it sees all of it at once.
    filtered = MotionCapture(num_vehicles=n, loses_frames=True, filtered=True, numbers=numbers)
    _, frames = seen(state, filtered, duration=10.0, n=n)
    assert frames[6, :, 100:].mean() == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.3, -0.7, 2.5), (-1.2, 1.1, -3.0)])
def test_misaligned_markers_rotate_with_the_body(attitude):
    """The reference is R_WB R_BM by Drake's rotation matrices."""
    misalignment = (0.05, -0.08, 0.2)
    turned = RollPitchYaw(attitude).ToRotationMatrix() @ RollPitchYaw(misalignment).ToRotationMatrix()
    found = RollPitchYaw(*attitude_of_markers(Attitude(*attitude), BodyAxes.of(*misalignment))).ToRotationMatrix()
    np.testing.assert_allclose(found.matrix(), turned.matrix(), atol=1e-14)


def test_cameras_measure_the_attitude_of_the_markers():
    """Each vehicle has its own misalignment; position, velocity and body rates are those of the body."""
    rolls = np.array([0.05, -0.1])
    numbers = CameraNumbers(misalignment=Attitude(rolls, -0.08, 0.2))
    state = np.tile([1.0, 2.0, 3.0, 0.1, -0.2, 0.3, 0.4, -0.5, 0.6, -0.7, 0.8, -0.9], (2, 1)).T
    camera = MotionCapture(num_vehicles=2, misaligned=True, numbers=numbers)
    _, frames = seen(PiecewisePolynomial(state.reshape(-1, 1)), camera, duration=0.05, n=2)
    for i, roll in enumerate(rolls):
        turned = RollPitchYaw(0.1, -0.2, 0.3).ToRotationMatrix() @ RollPitchYaw(roll, -0.08, 0.2).ToRotationMatrix()
        expected = np.concatenate([state[:3, i], RollPitchYaw(turned).vector(), state[6:, i]])
        np.testing.assert_allclose(frames[:, i, -1], expected, atol=1e-14)


def test_each_row_of_the_pose_has_independent_noise():
    noise = Pose(1.0, -2.0, 3.0, -4.0, 5.0, -6.0)
    state = State(1.0, 2.0, 3.0, 0.01, 0.02, 0.03, *[9.0] * 6)
    cameras = Cameras.of(CameraNumbers(position_noise=0.1, attitude_noise=0.5))
    found = measured_pose(state, noise, cameras, misaligned=True)
    np.testing.assert_allclose(found, Pose(1.1, 1.8, 3.3, -1.99, 2.52, -2.97))


@pytest.mark.parametrize("filtered", [False, True])
def test_only_the_velocity_has_the_scale_error(filtered):
    """Each vehicle has its own error on each axis, also if a filter estimates the velocity."""
    shares = np.array([[0.1, -0.2, 0.05], [0.3, 0.0, -0.1]])
    state = np.random.default_rng(3).normal(scale=0.3, size=(12, 3))
    line = PiecewisePolynomial.FirstOrderHold([0.0, 1.0, 2.0], np.repeat(state, 2, axis=0))
    numbers = CameraNumbers(derivative_bandwidth=40.0)
    mistaken = numbers._replace(velocity_error=VelocityError(*shares.T))
    _, true = seen(line, MotionCapture(num_vehicles=2, filtered=filtered, numbers=numbers), duration=2.0, n=2)
    camera = MotionCapture(num_vehicles=2, filtered=filtered, velocity_scaled=True, numbers=mistaken)
    _, frames = seen(line, camera, duration=2.0, n=2)
    expected = true.copy()
    expected[6:9] *= 1.0 + shares.T[:, :, None]
    assert np.abs(expected - true).max() > 0.01
    np.testing.assert_allclose(frames, expected, atol=1e-13)


def test_the_velocity_drift_has_its_deviation_and_correlation_time():
    """Each axis has its own drift, with the correlation exp(-h/T) between frames, and nothing else changes."""
    state = np.tile(np.arange(12.0)[:, None] * 0.1, 2)
    line = PiecewisePolynomial.FirstOrderHold([0.0, 100.0], state)
    numbers = CameraNumbers(velocity_drift=VelocityDrift(0.03, 0.01, 0.0), drift_time=0.1)
    _, frames = seen(line, MotionCapture(drifts=True, numbers=numbers), duration=100.0, n=1)
    off = frames[:, 0] - state[:, :1]
    assert np.abs(np.delete(off, [6, 7], axis=0)).max() < 1e-12
    for row, deviation in ((6, 0.03), (7, 0.01)):
        drift = off[row, 100:]
        assert drift.std() == pytest.approx(deviation, rel=0.15)
        assert np.corrcoef(drift[:-1], drift[1:])[0, 1] == pytest.approx(np.exp(-0.1), abs=0.02)
