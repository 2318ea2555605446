"""Tests of the error-state Kalman filter: against dense matrices, and the consistency of its covariance."""

import itertools
from typing import NamedTuple

import numpy as np
import pytest
import scipy
from oracle.estimation import DenseFilter
from scipy.spatial.transform import Rotation

from drake_quad.estimation.corrections import (
    AIDING_LAWS,
    AnchorAiding,
    AttitudeAiding,
    FixAiding,
    FlowAiding,
    GroundAiding,
    HeightAiding,
    MagneticAiding,
    PoseAiding,
    PositionAiding,
    VelocityAiding,
    YawAiding,
)
from drake_quad.estimation.covariance import (
    Covariance,
    Gate,
    InertialNoise,
    ScalarMeasurement,
    corrected_error,
    propagate,
)
from drake_quad.estimation.error_state_filter import Aiding, AidingParameters, ErrorStateKalmanFilter, FilterParameters
from drake_quad.estimation.estimate import NO_INCREMENT, ErrorState, Estimate, extend_increment, predict, state_of
from drake_quad.geometry.axes import Vector
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.signals import BodyRates, EstimateDeviation
from drake_quad.testing import check_system

H = 0.01  # s, sampling period
GRAVITY = 9.81  # m/s²
# Noise densities of gyroscope and accelerometer, and of the random walks of their biases.
NOISE = InertialNoise(2e-3, 0.02, 2e-4, 3e-3)
# Standard deviations of the initial errors.
INITIAL = EstimateDeviation(*[0.1] * 3, *[0.2] * 3, *[0.04] * 3, *[0.02] * 3, *[0.1] * 3)
POSITION = PositionAiding(0.02, 0.03, 0.04)  # m, standard deviations along X, Y and Z
NO_LIMIT = 1e9  # limit of the squared normalised innovation that no reading exceeds
GROUND = 0.4  # m, height of the ground
ANCHOR = Vector(3.0, -2.0, 2.5)  # m, position of the anchor of the range sensor
NORTH = 0.4  # rad, direction of magnetic north
EARTH_FIELD = np.array([np.cos(NORTH), np.sin(NORTH), -1.4])

AIDING = {
    "anchor_distance": AnchorAiding(0.05, ANCHOR),
    "attitude": AttitudeAiding(0.03),
    "fix": FixAiding(POSITION, VelocityAiding(0.1, 0.2, 0.3)),
    "flow": FlowAiding(0.05, GROUND),
    "ground_distance": GroundAiding(0.04, GROUND),
    "height": HeightAiding(0.06),
    "magnetic_field": MagneticAiding(0.05, Vector(*EARTH_FIELD)),
    "pose": PoseAiding(POSITION, AttitudeAiding(0.03)),
    "position": POSITION,
    "velocity": VelocityAiding(0.1, 0.2, 0.3),
    "yaw": YawAiding(0.04),
}
DEVIATIONS = {
    "anchor_distance": [0.05],
    "attitude": [0.03] * 3,
    "fix": [*POSITION, 0.1, 0.2, 0.3],
    "flow": [0.05] * 2,
    "ground_distance": [0.04],
    "height": [0.06],
    "magnetic_field": [0.05],
    "pose": [*POSITION, *[0.03] * 3],
    "position": POSITION,
    "velocity": [0.1, 0.2, 0.3],
    "yaw": [0.04],
}


class Motion(NamedTuple):
    """Exact motion of the discrete kinematics, and the exact readings of the inertial sensors."""

    position: np.ndarray
    velocity: np.ndarray
    rotations: np.ndarray
    rates: np.ndarray
    forces: np.ndarray


def motion_along(position, yaw, duration):
    """Return the motion of a quadrotor along a path whose position and yaw are functions of time."""
    times = H * np.arange(round(duration / H) + 1)
    step = 1e-4

    def velocity_at(t):
        return (position(t + step) - position(t - step)) / (2.0 * step)

    velocity = np.array([velocity_at(t) for t in times])
    gravity = np.array([0.0, 0.0, GRAVITY])
    up = np.array([(velocity_at(t + 0.01) - velocity_at(t - 0.01)) / 0.02 + gravity for t in times])
    z = up / np.linalg.norm(up, axis=1, keepdims=True)
    ahead = np.array([[np.cos(yaw(t)), np.sin(yaw(t)), 0.0] for t in times])
    y = np.cross(z, ahead)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    rotations = np.stack([np.cross(y, z), y, z], axis=2)
    turns = np.array([Rotation.from_matrix(a.T @ b).as_rotvec() for a, b in itertools.pairwise(rotations)])
    middle = np.array(
        [a @ Rotation.from_rotvec(0.5 * turn).as_matrix() for a, turn in zip(rotations[:-1], turns, strict=True)]
    )
    accelerations = np.diff(velocity, axis=0) / H + gravity
    forces = np.einsum("kij,ki->kj", middle, accelerations)
    positions = position(0.0) + np.cumsum(np.vstack([np.zeros(3), 0.5 * H * (velocity[:-1] + velocity[1:])]), axis=0)
    return Motion(positions, velocity, rotations, turns / H, forces)


def hover(duration):
    return motion_along(lambda t: np.array([0.3, -0.2, 1.0]), lambda t: 0.5, duration)


def figure_eight(duration):
    def position(t):
        phase = 1.5 * t**2 / (1.0 + t)  # begins at rest
        return np.array([1.2 * np.sin(phase), 0.6 * np.sin(2.0 * phase), 1.0 + 0.2 * np.sin(0.7 * phase)])

    return motion_along(position, lambda t: 0.4 * np.sin(0.8 * t), duration)


MOTIONS = {"hover": hover, "figure eight": figure_eight}


def make_filter(*aiding, num_vehicles=1, block_samples=1, limit=NO_LIMIT, lever=None):
    parameters = tuple(AidingParameters(AIDING[each.kind], limit, lever=lever) for each in aiding)
    return ErrorStateKalmanFilter(
        num_vehicles=num_vehicles,
        aiding=aiding,
        period=H,
        block_samples=block_samples,
        parameters=FilterParameters(NOISE, INITIAL, parameters, gravity=GRAVITY),
    )


def start(system, p, v, rotations, b_g, b_a):
    """Return a context whose filter has started with an estimate; the arguments have the shape (N, ...)."""
    context = system.CreateDefaultContext()
    w = np.roll(Rotation.from_matrix(rotations).as_quat(), 1, axis=1)
    estimate = system.get_state(context, "estimate")
    vectors = [Vector(*np.transpose(each)) for each in (p, v, b_g, b_a)]
    system.set_state(
        context,
        "estimate",
        estimate._replace(
            position=vectors[0],
            velocity=vectors[1],
            attitude=Quaternion(*w.T),
            gyroscope_bias=vectors[2],
            accelerometer_bias=vectors[3],
        ),
    )
    increment, counters = system.get_state(context, "increment"), system.get_state(context, "counters")
    system.set_state(context, "increment", increment._replace(gyroscope_bias=vectors[2], accelerometer_bias=vectors[3]))
    system.set_state(context, "counters", counters._replace(waits_for_start=0.0))
    return context


def advance(system, context, readings):
    """Execute an update of the filter; readings are arrays (N, rows) or (N,) by port name."""
    for name, rows in readings.items():
        system.GetInputPort(name).FixValue(context, np.transpose(np.asarray(rows, dtype=float)).ravel())
    context.SetTime(context.get_time() + H)
    values = system.EvalUniquePeriodicDiscreteUpdate(context).Clone()
    context.SetDiscreteState(values)


def matrices(covariance):
    """Return the covariances of a fleet as an array (N, 15, 15)."""
    return np.moveaxis(np.array([[np.atleast_1d(each) for each in row] for row in covariance.matrix()]), -1, 0)


def innovation_of(kind, reading, gyroscope, lever=None):
    """Return the function of p, v, R, b_g and b_a that computes measured minus predicted values."""
    at_centre = innovation_at_centre(kind, reading, gyroscope)
    if lever is None:
        return at_centre
    return lambda p, v, R, b_g, b_a: at_centre(p + R @ lever, v + R @ np.cross(gyroscope - b_g, lever), R, b_g, b_a)


def innovation_at_centre(kind, reading, gyroscope):
    """Return `innovation_of` for a sensor at the inertial measurement unit."""

    def wrapped(angle):
        return np.array([np.arctan2(np.sin(angle), np.cos(angle))])

    def flow(p, v, R, b_g, b_a):
        distance, along = (p[2] - GROUND) / R[2, 2], R.T @ v
        rates = gyroscope - b_g
        return reading - [along[0] / distance - rates[1], along[1] / distance + rates[0]]

    def rotation(R, attitude):
        return Rotation.from_matrix(Rotation.from_euler("ZYX", attitude[::-1]).as_matrix() @ R.T).as_rotvec()

    return {
        "anchor_distance": lambda p, v, R, b_g, b_a: reading - np.linalg.norm(p - np.array(ANCHOR)),
        "attitude": lambda p, v, R, b_g, b_a: rotation(R, reading),
        "fix": lambda p, v, R, b_g, b_a: reading - np.hstack([p, v]),
        "flow": flow,
        "ground_distance": lambda p, v, R, b_g, b_a: reading - (p[2] - GROUND) / R[2, 2],
        "height": lambda p, v, R, b_g, b_a: reading - p[2],
        "magnetic_field": lambda p, v, R, b_g, b_a: wrapped(NORTH - np.arctan2(*(R @ reading)[1::-1])),
        "pose": lambda p, v, R, b_g, b_a: np.hstack([reading[:3] - p, rotation(R, reading[3:6])]),
        "position": lambda p, v, R, b_g, b_a: reading - p,
        "velocity": lambda p, v, R, b_g, b_a: reading - v,
        "yaw": lambda p, v, R, b_g, b_a: wrapped(reading[0] - np.arctan2(R[1, 0], R[0, 0])),
    }[kind]


def reading_of(kind, p, v, R, rates, generator):
    """Return a noisy reading of a sensor in a given state."""
    true = {
        "anchor_distance": lambda: [np.linalg.norm(p - np.array(ANCHOR))],
        "attitude": lambda: Rotation.from_matrix(R).as_euler("ZYX")[::-1],
        "fix": lambda: [*p, *v],
        "flow": lambda: [
            (R.T @ v)[0] * R[2, 2] / (p[2] - GROUND) - rates[1],
            (R.T @ v)[1] * R[2, 2] / (p[2] - GROUND) + rates[0],
        ],
        "ground_distance": lambda: [(p[2] - GROUND) / R[2, 2]],
        "height": lambda: [p[2]],
        "magnetic_field": lambda: R.T @ EARTH_FIELD,
        "pose": lambda: [*p, *Rotation.from_matrix(R).as_euler("ZYX")[::-1], *v, *rates],
        "position": lambda: p,
        "velocity": lambda: v,
        "yaw": lambda: [np.arctan2(R[1, 0], R[0, 0])],
    }[kind]()
    return np.array(true) + 0.02 * generator.standard_normal(len(true))


@pytest.mark.slow
@pytest.mark.parametrize("lever", [None, Vector(0.3, -0.2, 0.1)], ids=["without lever", "with lever"])
@pytest.mark.parametrize("kind", AIDING_LAWS)
def test_the_filter_agrees_with_dense_matrices(kind, lever):
    """The filter corrects with one component after another, all linearised at one estimate, so both agree exactly."""
    generator, motion = np.random.default_rng(3), figure_eight(1.5)
    system = make_filter(Aiding("aid", kind, 4), block_samples=2, lever=lever)
    offset = Rotation.from_rotvec([0.03, -0.02, 0.04]).as_matrix()
    b_g, b_a = np.array([0.01, -0.02, 0.015]), np.array([0.05, 0.1, -0.08])
    initial = motion.position[0] + 0.05, motion.velocity[0] - 0.1, offset @ motion.rotations[0], b_g, b_a
    context = start(system, *[each[None] for each in initial])
    dense = DenseFilter(*initial, np.diag(np.square(INITIAL)), tuple(NOISE), GRAVITY)
    for k in range(len(motion.rates)):
        gyroscope = motion.rates[k] + 0.02 * generator.standard_normal(3)
        accelerometer = motion.forces[k] + 0.2 * generator.standard_normal(3)
        state = motion.position[k], motion.velocity[k], motion.rotations[k]
        reading = reading_of(kind, *state, motion.rates[k], generator)
        advance(system, context, {"gyroscope": [gyroscope], "accelerometer": [accelerometer], "aid": [reading]})
        if k % 2 == 0:
            dense.propagate()
        if k % 4 == 0:
            # Attitudes are linearised at the predicted attitude, and the magnetic field is linearised at the predicted
            # field of the earth.
            predicted_reading = {
                "attitude": Rotation.from_matrix(dense.R).as_euler("ZYX")[::-1],
                "magnetic_field": dense.R.T @ EARTH_FIELD,
                "pose": np.hstack([reading[:3], Rotation.from_matrix(dense.R).as_euler("ZYX")[::-1], reading[6:]]),
            }
            linearised = innovation_of(kind, predicted_reading.get(kind, reading), gyroscope, lever)
            innovation = innovation_of(kind, reading, gyroscope, lever)
            innovations = dense.correct(innovation, DEVIATIONS[kind], linearised)
        dense.predict(gyroscope, accelerometer, H)
    estimate = predict(system.get_state(context, "estimate"), system.get_state(context, "increment"), GRAVITY)
    R = np.array(estimate.attitude.axes()).T
    np.testing.assert_allclose(estimate.position, dense.p, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(estimate.velocity, dense.v, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(R, dense.R, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(estimate.gyroscope_bias, dense.b_g, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(estimate.accelerometer_bias, dense.b_a, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(matrices(system.get_state(context, "covariance"))[0], dense.P, atol=1e-9, rtol=0.0)
    np.testing.assert_allclose(system.GetOutputPort("innovation").Eval(context), innovations, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("latencies", [(2, 0), (1, 1), (0, 1)], ids=str)
def test_latencies_only_delay_the_estimate_at_the_horizon(latencies):
    """Readings of two sensors arrive out of order, but the filter uses them in the order in which they were taken.

    Biases that are known exactly make the comparison exact: stored samples need no correction for later biases.
    """
    generator, motion = np.random.default_rng(4), figure_eight(1.5)
    known = INITIAL._replace(**dict.fromkeys(EstimateDeviation._fields[9:], 0.0))
    noise = NOISE._replace(gyroscope_walk=0.0, accelerometer_walk=0.0)
    sensors = [("position", 4), ("yaw", 6)]
    systems, contexts = [], []
    for delays in [(0, 0), latencies]:
        aiding = tuple(
            Aiding(kind, kind, samples, latency=delay) for (kind, samples), delay in zip(sensors, delays, strict=True)
        )
        parameters = tuple(AidingParameters(AIDING[kind], NO_LIMIT) for kind, _ in sensors)
        systems.append(
            ErrorStateKalmanFilter(
                aiding=aiding,
                period=H,
                block_samples=2,
                parameters=FilterParameters(noise, known, parameters, gravity=GRAVITY),
            )
        )
        contexts.append(systems[-1].CreateDefaultContext())
    horizon = max(samples * delay for (_, samples), delay in zip(sensors, latencies, strict=True))
    taken = {kind: [] for kind, _ in sensors}
    estimates, gyroscopes, forces = [], [], []
    for k in range(len(motion.rates)):
        gyroscopes.append(motion.rates[k] + 0.02 * generator.standard_normal(3))
        forces.append(motion.forces[k] + 0.2 * generator.standard_normal(3))
        for kind, samples in sensors:
            if k % samples == 0:
                state = motion.position[k], motion.velocity[k], motion.rotations[k], motion.rates[k]
                taken[kind].append(reading_of(kind, *state, generator))
        for system, context, delays in zip(systems, contexts, [(0, 0), latencies], strict=True):
            readings = {
                kind: [taken[kind][max(0, k // samples - delay)]]
                for (kind, samples), delay in zip(sensors, delays, strict=True)
            }
            advance(system, context, {"gyroscope": [gyroscopes[k]], "accelerometer": [forces[k]], **readings})
        estimates.append(systems[0].get_state(contexts[0], "estimate"))
        if k >= horizon:
            at_horizon = systems[1].get_state(contexts[1], "estimate")
            np.testing.assert_allclose(flat(at_horizon), flat(estimates[k - horizon]), atol=1e-10, rtol=0.0)
    increment = NO_INCREMENT
    for gyroscope, force in zip(gyroscopes[k - k % 2 - horizon :], forces[k - k % 2 - horizon :], strict=True):
        increment = extend_increment(increment, BodyRates(*gyroscope), Vector(*force), H)
    expected = state_of(predict(at_horizon, increment, GRAVITY), BodyRates(*gyroscopes[-1]))
    np.testing.assert_allclose(systems[1].GetOutputPort("measurement").Eval(contexts[1]), expected, atol=1e-10)


def flat(estimate):
    return np.hstack(estimate)


def fly(motion, aiding, num_vehicles, seed, block_samples=1):
    """Return system and context after a simulated flight of a fleet, and the normalised squared errors (steps, N)."""
    generator = np.random.default_rng(seed)
    system = make_filter(*aiding, num_vehicles=num_vehicles, block_samples=block_samples)
    error = np.array(INITIAL) * generator.standard_normal((num_vehicles, 15))
    b_g, b_a = np.zeros((num_vehicles, 3)), np.zeros((num_vehicles, 3))
    turn = Rotation.from_rotvec(-error[:, 6:9]).as_matrix()
    context = start(
        system,
        motion.position[0] - error[:, 0:3],
        motion.velocity[0] - error[:, 3:6],
        turn @ motion.rotations[0],
        -error[:, 9:12],
        -error[:, 12:15],
    )
    squared_errors = []
    for k, (rates, force) in enumerate(zip(motion.rates, motion.forces, strict=True)):
        white = generator.standard_normal((4, num_vehicles, 3))
        readings = {
            "gyroscope": rates + b_g + NOISE.gyroscope / np.sqrt(H) * white[0],
            "accelerometer": force + b_a + NOISE.accelerometer / np.sqrt(H) * white[1],
        }
        for each in aiding:
            true = reading_of(each.kind, motion.position[k], motion.velocity[k], motion.rotations[k], rates, _Silence)
            # `DEVIATIONS` contains the deviation of the heading. Each axis of the field has the same deviation, because
            # the horizontal field is 1.
            deviations = DEVIATIONS[each.kind] * (3 if each.kind == "magnetic_field" else 1)
            noise = np.zeros((num_vehicles, len(true)))
            noise[:, : len(deviations)] = deviations * generator.standard_normal((num_vehicles, len(deviations)))
            readings[each.name] = true + noise
        advance(system, context, readings)
        b_g = b_g + NOISE.gyroscope_walk * np.sqrt(H) * white[2]
        b_a = b_a + NOISE.accelerometer_walk * np.sqrt(H) * white[3]
        if k % 100 == 99:
            truth = motion.position[k + 1], motion.velocity[k + 1], motion.rotations[k + 1], b_g, b_a
            squared_errors.append(normalised_errors(system, context, *truth))
    return system, context, np.array(squared_errors)


class _Silence:
    """Substitute for a random generator that returns zeros, for readings without noise."""

    @staticmethod
    def standard_normal(size):
        return np.zeros(size)


def normalised_errors(system, context, p, v, R, b_g, b_a):
    """Return the normalised squared error δxᵀ P⁻¹ δx of each vehicle."""
    estimate, covariance, increment = (
        system.get_state(context, name) for name in ("estimate", "covariance", "increment")
    )
    P = matrices(propagate(covariance, increment, estimate.attitude.axes(), NOISE))
    estimate = predict(estimate, increment, GRAVITY)
    axes = np.moveaxis(np.array(estimate.attitude.axes()), -1, 0).transpose(0, 2, 1)
    errors = np.hstack(
        [
            p - np.array(estimate.position).T,
            v - np.array(estimate.velocity).T,
            Rotation.from_matrix(R @ axes.transpose(0, 2, 1)).as_rotvec(),
            b_g - np.array(estimate.gyroscope_bias).T,
            b_a - np.array(estimate.accelerometer_bias).T,
        ]
    )
    return np.einsum("ni,nij,nj->n", errors, np.linalg.inv(P), errors)


@pytest.mark.slow
@pytest.mark.parametrize("kind", AIDING_LAWS)
def test_squared_errors_have_their_chi_squared_distribution(kind):
    """At the end of a figure eight, the sum over the fleet is within the 99.9 % interval of its distribution."""
    aiding = Aiding("position", "position", 4), Aiding("other", kind, 4)
    _, _, squared_errors = fly(figure_eight(4.0), aiding, 150, 5, block_samples=2)
    low, high = scipy.stats.chi2.interval(0.999, 15 * squared_errors.shape[1])
    assert low < squared_errors[-1].sum() < high


@pytest.mark.long
@pytest.mark.parametrize("name", MOTIONS)
def test_the_mean_squared_error_is_the_number_of_states(name):
    """The mean over 2,000 flights deviates by less than 2 % from 15; its standard error is 0.8 %."""
    aiding = Aiding("position", "position", 4), Aiding("yaw", "yaw", 10)
    _, _, squared_errors = fly(MOTIONS[name](6.0), aiding, 2000, 5)
    assert abs(squared_errors[-1].mean() - 15.0) < 0.02 * 15.0


@pytest.mark.slow
def test_yaw_is_not_observable_in_hover_without_a_measurement_of_the_direction():
    motion = hover(8.0)
    position, yaw = Aiding("position", "position", 4), Aiding("yaw", "yaw", 10)
    deviations = []
    for aiding in [(position,), (position, yaw)]:
        system, context, _ = fly(motion, aiding, 2, 5)
        deviation = system.GetOutputPort("estimate_deviation").Eval(context).reshape(15, 2)
        deviations.append(EstimateDeviation(*deviation.min(axis=1)))
    without, with_yaw = deviations
    # The uncertainty of the yaw grows, because the bias of the gyroscope about Z remains unknown. This bias is reduced
    # by a few per cent at most, because the initial tilt error accelerates the estimate sideways.
    assert without.rotation_z > 3.0 * INITIAL.rotation_z
    assert without.gyroscope_z > 0.95 * INITIAL.gyroscope_z
    assert max(without.rotation_x, without.rotation_y) < 0.5 * INITIAL.rotation_x
    assert with_yaw.rotation_z < 0.5 * INITIAL.rotation_z
    assert with_yaw.gyroscope_z < 0.5 * INITIAL.gyroscope_z


def test_an_outlier_is_rejected_and_shown_in_the_innovation():
    system = make_filter(Aiding("position", "position"), limit=25.0)
    motion = hover(1.0)
    estimate = motion.position[:1], np.zeros((1, 3)), motion.rotations[:1]
    context = start(system, *estimate, *np.zeros((2, 1, 3)))
    at_rest = {"gyroscope": [[0.0, 0.0, 0.0]], "accelerometer": [[0.0, 0.0, GRAVITY]]}
    for _ in range(50):
        advance(system, context, {**at_rest, "position": [motion.position[0]]})
    before = system.get_state(context, "estimate"), system.GetOutputPort("estimate_deviation").Eval(context)
    advance(system, context, {**at_rest, "position": [motion.position[0] + [0.0, 5.0, 0.0]]})
    estimate, deviation = (
        system.get_state(context, "estimate"),
        system.GetOutputPort("estimate_deviation").Eval(context),
    )
    np.testing.assert_allclose(estimate.position, before[0].position, atol=1e-12)
    assert deviation[1] > before[1][1]
    x, y, z = system.GetOutputPort("innovation").Eval(context)
    assert y > 5.0 > 1e-6 > abs(x) + abs(z)


def test_readings_are_used_again_after_too_many_rejections():
    """The position jumps, as after a relocation of the origin, and all later readings agree with each other."""
    system = make_filter(Aiding("position", "position"), limit=25.0)
    context = system.CreateDefaultContext()
    at_rest = {"gyroscope": [[0.0, 0.0, 0.0]], "accelerometer": [[0.0, 0.0, GRAVITY]]}
    for _ in range(50):
        advance(system, context, {**at_rest, "position": np.zeros((1, 3))})
    positions = []
    for _ in range(300):
        advance(system, context, {**at_rest, "position": [[2.0, 0.0, 0.0]]})
        positions.append(system.get_state(context, "estimate").position.x)
    assert max(positions[:10]) < 1e-6  # the default of `max_rejections` is 10
    assert abs(positions[10] - 2.0) < 1e-2
    assert abs(positions[-1] - 2.0) < 1e-2
    assert np.abs(system.GetOutputPort("measurement").Eval(context)[3:6]).max() < 0.05  # the attitude stays level
    assert system.get_state(context, "counters").rejections == (0.0,)


def test_a_reset_adds_the_variance_of_a_velocity_that_explains_the_jump():
    """The position jumps by 2 m, and the tenth rejected reading comes 0.4 s after the last accepted one."""
    system = make_filter(Aiding("position", "position", 4), limit=25.0)
    context = system.CreateDefaultContext()
    at_rest = {"gyroscope": [[0.0, 0.0, 0.0]], "accelerometer": [[0.0, 0.0, GRAVITY]]}
    for _ in range(200):
        advance(system, context, {**at_rest, "position": np.zeros((1, 3))})
    deviations = []
    for _ in range(48):
        advance(system, context, {**at_rest, "position": [[2.0, 0.0, 0.0]]})
        deviations.append(system.GetOutputPort("estimate_deviation").Eval(context)[3:5])
    x, y = np.transpose(deviations)
    assert abs(x.max() - 2.0 / 0.4) < 0.2
    assert y.max() < 0.5


def test_resets_of_the_velocity_leave_the_variance_of_the_position():
    derivatives = ErrorState(None, Vector(1.0, None, None), None, None, None)
    measurement = ScalarMeasurement(9.0, derivatives, 0.1, "velocity")
    before = Covariance.diagonal(INITIAL)
    _, after, _ = corrected_error(before, [measurement], Gate(25.0, True, 0.5))
    others = [i for i in range(len(INITIAL)) if i != 3]
    np.testing.assert_allclose(np.array(after.deviations())[others], np.array(INITIAL)[others], rtol=1e-12)


def test_a_missing_reading_corrects_nothing():
    system = make_filter(Aiding("position", "position", can_miss=True))
    context = system.CreateDefaultContext()
    readings = {"gyroscope": np.zeros((1, 3)), "accelerometer": [[0.0, 0.0, GRAVITY]], "position": [[1.0, 2.0, 3.0]]}
    advance(system, context, {**readings, "position_valid": [[0.0]]})
    np.testing.assert_allclose(system.get_state(context, "estimate").position, 0.0, atol=1e-12)
    advance(system, context, {**readings, "position_valid": [[1.0]]})
    assert np.all(np.array(system.get_state(context, "estimate").position) > 0.9)


@pytest.mark.slow
def test_the_filter_starts_with_the_direction_of_gravity_and_the_first_reading():
    """The first reading is used although it is a hundred standard deviations away."""
    aiding = Aiding("position", "position"), Aiding("yaw", "yaw")
    parameters = tuple(AidingParameters(AIDING[each.kind], 9.0) for each in aiding)
    initial = INITIAL._replace(x=100.0, y=100.0, z=100.0, rotation_z=3.0)
    system = ErrorStateKalmanFilter(
        aiding=aiding, period=H, parameters=FilterParameters(NOISE, initial, parameters, gravity=GRAVITY)
    )
    context = system.CreateDefaultContext()
    R = Rotation.from_euler("ZYX", [2.0, -0.2, 0.3]).as_matrix()
    force = R.T @ [0.0, 0.0, GRAVITY]
    position = [3.0, -400.0, 5.0]
    advance(
        system, context, {"gyroscope": [np.zeros(3)], "accelerometer": [force], "position": [position], "yaw": [[2.0]]}
    )
    measurement = system.GetOutputPort("measurement").Eval(context)
    np.testing.assert_allclose(measurement[:3], position, atol=1e-3)
    np.testing.assert_allclose(measurement[3:6], [0.3, -0.2, 2.0], atol=2e-3)


def test_the_covariance_stays_positive_definite_with_precise_measurements():
    """Variances differ by a factor of 10¹⁰ at the first reading."""
    position = Aiding("position", "position")
    initial = INITIAL._replace(x=10.0, y=10.0, z=10.0)
    precise = AidingParameters(PositionAiding(1e-4, 1e-4, 1e-4), NO_LIMIT)
    system = ErrorStateKalmanFilter(
        aiding=(position,), period=H, parameters=FilterParameters(NOISE, initial, (precise,), gravity=GRAVITY)
    )
    context, smallest = system.CreateDefaultContext(), []
    readings = {"gyroscope": np.zeros((1, 3)), "accelerometer": [[0.0, 0.0, GRAVITY]], "position": np.zeros((1, 3))}
    for _ in range(500):
        advance(system, context, readings)
        (P,) = matrices(system.get_state(context, "covariance"))
        scale = np.sqrt(np.diag(P))
        smallest.append(np.linalg.eigvalsh(P / np.outer(scale, scale))[0])
    assert min(smallest) > 0.0


@pytest.mark.long
def test_the_filter_obeys_the_rules_of_systems():
    aiding = Aiding("position", "position", 2, can_miss=True), Aiding("flow", "flow", 4)
    applied = check_system(lambda num: make_filter(*aiding, num_vehicles=num, block_samples=2, limit=25.0))
    assert {"vehicles", "derivatives", "compiled"} <= set(applied)


@pytest.mark.parametrize(
    ("aiding", "samples", "message"),
    [
        (Aiding("position", "position", 3), 2, "a period of 3 samples"),
        (Aiding("position", "height above ground"), 1, "has the kind 'height above ground'"),
        (Aiding("position", "position"), 0, "must be at least 1"),
    ],
)
def test_impossible_structures_are_refused(aiding, samples, message):
    parameters = FilterParameters(NOISE, INITIAL, (AidingParameters(POSITION, 25.0),))
    with pytest.raises(ValueError, match=message):
        ErrorStateKalmanFilter(aiding=(aiding,), period=H, block_samples=samples, parameters=parameters)


def test_parameters_of_another_sensor_are_refused():
    parameters = FilterParameters(NOISE, INITIAL, (AidingParameters(POSITION, 25.0),))
    with pytest.raises(ValueError, match="parameters of type PositionAiding"):
        ErrorStateKalmanFilter(aiding=(Aiding("yaw", "yaw"),), period=H, parameters=parameters)


def test_the_diagonal_covariance_has_the_given_deviations():
    np.testing.assert_allclose(Covariance.diagonal(INITIAL).deviations(), INITIAL)


def test_the_state_at_the_centre_of_mass_follows_from_that_at_the_inertial_sensors():
    rotation, rates, lever = (
        Rotation.from_rotvec([0.3, -0.2, 0.5]),
        np.array([0.5, -1.2, 2.0]),
        Vector(0.05, 0.02, -0.1),
    )
    bias = Vector(0.01, -0.02, 0.03)
    x, y, z, w = rotation.as_quat()
    at_sensors = Estimate(
        Vector(1.0, 2.0, 3.0), Vector(0.1, 0.2, 0.3), Quaternion(w, x, y, z), bias, Vector(0.0, 0.0, 0.0)
    )
    state = state_of(at_sensors, BodyRates(*(rates + bias)), lever)
    np.testing.assert_allclose(state[:3], np.array([1.0, 2.0, 3.0]) - rotation.apply(lever))
    np.testing.assert_allclose(state[6:9], np.array([0.1, 0.2, 0.3]) - rotation.apply(np.cross(rates, lever)))
    np.testing.assert_allclose(state[9:], rates)
