"""Tests of the filter that predicts a log one measurement ahead, by comparison with the Kalman filter equations."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from drake_quad import load_scenario
from drake_quad.identification import fit as fitting
from drake_quad.identification import prediction_errors
from drake_quad.identification.model import NUM_BODY, NUM_DISTURBANCE, STATE_ROWS, LogModel
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.prediction_errors import FORCE, Output, PredictionNoise, Predictor
from drake_quad.identification.windows import LogWindow, WindowSizes
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.record import FlightRecord

PERIOD = 0.01  # s, sampling period
SIZES = WindowSizes(length=20, settle=10, warm_up=5)  # samples
POSE = [Output(signal, column) for signal in ("position", "attitude") for column in range(3)]
IMU = [Output(signal, column) for signal in ("body_rates", FORCE) for column in range(3)]


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("laboratory:low_wind", ["vehicle.inertia=[0.0066, 0.0079, 0.0121]", "vehicle.linear_drag=0.1"])


@pytest.fixture(scope="module")
def log(scenario):
    """Return a noisy log of two seconds of unsteady hover."""
    random = np.random.default_rng(3)
    time = PERIOD * np.arange(200)
    hover = np.sqrt(scenario.vehicle.mass * scenario.vehicle.gravity / (4.0 * scenario.vehicle.thrust_factor))

    def noisy(size, mean):
        return size * random.normal(size=(200, 3)) + np.array(mean)

    return FlightRecord(
        "log",
        time,
        position=noisy(1e-3, [0.5, -0.2, 1.0]),
        attitude=noisy(4e-3, [0.02, -0.03, 1.0]),
        body_rates=noisy(0.02, [0.0, 0.0, 0.0]),
        specific_force=noisy(0.3, [0.0, 0.0, 9.8]),
        rotor_speed_command=hover + 5.0 * np.sin(9.0 * time[:, None] + np.arange(4)),
    )


def predictor_of(
    scenario, log, outputs=POSE, windows=(LogWindow(0, 30), LogWindow(0, 50), LogWindow(0, 90)), sizes=SIZES, **options
):
    model = LogModel(scenario, ["mass", "linear_drag"])
    return Predictor(model, [log], windows, sizes, outputs, **options)


@pytest.fixture
def values(scenario):
    return np.array([scenario.vehicle.mass, scenario.vehicle.linear_drag])


def noise_of(outputs, *, white=1.0, push=1.0, memory=1.0):
    usual = {"position": 1e-3, "attitude": 4e-3, "body_rates": 0.02, FORCE: 0.3}
    return PredictionNoise(
        white * np.array([usual[output.signal] for output in outputs]),
        push * np.array([0.3, 0.35, 0.5, 1.0, 1.1, 0.7]),
        memory * np.array([0.5, 0.6, 0.7, 0.3, 0.2, 0.4]),
    )


def test_the_measurement_update_is_that_of_a_kalman_filter():
    random = np.random.default_rng(0)
    root, output = random.normal(size=(3, 5, 5)), random.normal(size=(3, 2, 5))
    covariance, variances = root @ root.swapaxes(1, 2), np.diag([0.3, 0.7])
    result = prediction_errors._update(covariance, output, variances)
    for P, H, *update in zip(covariance, output, *result, strict=True):
        S = H @ P @ H.T + variances
        K = P @ H.T @ np.linalg.inv(S)
        complement = np.eye(5) - K @ H
        for actual, expected in zip(update, (K, complement @ P @ complement.T + K @ variances @ K.T, S), strict=True):
            np.testing.assert_allclose(actual, expected, atol=1e-9)


def test_the_variance_of_a_disturbance_is_stationary(scenario, log):
    """The disturbance decays by exp(-Δ/T) between two measurements, and process noise restores its variance."""
    noise = noise_of(POSE)
    for split in (1, 2):
        predictor = predictor_of(scenario, log, split=split)
        assert predictor.period == pytest.approx(PERIOD)
        added = predictor.process_noise(noise)
        np.testing.assert_array_equal(added[:NUM_BODY], 0.0)
        added_variance = added[NUM_BODY : NUM_BODY + 6]
        remaining_variance = np.exp(-2.0 * PERIOD / noise.correlation_time) * noise.disturbance**2
        np.testing.assert_allclose(remaining_variance + added_variance, noise.disturbance**2)
        # The constant part of the horizontal force does not decay.
        np.testing.assert_array_equal(added[NUM_BODY + 6 :], [0.0, 0.0])


@pytest.mark.parametrize("duration", [0.05, 0.5, 5.0])
def test_the_variance_of_a_mean_force_follows_from_its_correlation_time(duration):
    """The variance of the mean is the variance times the mean of exp(-|t - s| / T) over all pairs of times."""
    noise = noise_of(POSE)
    result = noise.mean_force(duration)
    for deviation, force, memory in zip(result, noise.force, noise.correlation_time, strict=False):
        integral, _ = scipy.integrate.quad(lambda t, T=memory: 2.0 * (duration - t) * np.exp(-t / T), 0.0, duration)
        assert deviation == pytest.approx(force * np.sqrt(integral) / duration)


def test_equivalent_axes_share_one_noise_parameter(scenario, log):
    """The three axes of a position or attitude share one parameter.

    For rates, forces and disturbances, x and y share one parameter, and z has its own.
    """
    both = POSE + IMU
    noise_groups = predictor_of(scenario, log, both).noise_groups
    groups = [
        *([f"{signal}"] * 3 for signal in ("position", "attitude")),
        *(
            [f"{quantity}xy", f"{quantity}xy", f"{quantity}z"]
            for quantity in ("rates", "felt", "push", "turn", "memory", "forget")
        ),
    ]
    names = [name for group in groups for name in group]
    assert len(noise_groups) == len(names) == 12 + 12
    np.testing.assert_array_equal(
        noise_groups[:, None] == noise_groups, [[one == other for other in names] for one in names]
    )
    values = np.arange(24.0)
    noise = PredictionNoise.of(values)
    np.testing.assert_array_equal(np.concatenate(noise), values)
    np.testing.assert_array_equal(noise.force, noise.disturbance[:3])


def test_states_without_influence_on_the_outputs_are_left_out_of_the_filter(scenario, log):
    """The state contains positions if they are outputs, and the yaw if attitudes are outputs.

    It contains velocities and disturbing forces if positions or specific forces are outputs.
    """
    rates = [Output("body_rates", column) for column in range(3)]
    for outputs, left_out in (
        (POSE, set()),
        (IMU, {0, 1, 2, 5}),
        (POSE[3:], {0, 1, 2, 6, 7, 8, 12, 13, 14, 18, 19}),
        (rates, {0, 1, 2, 5, 6, 7, 8, 12, 13, 14, 18, 19}),
    ):
        assert {*predictor_of(scenario, log, outputs).rows.tolist()} == set(
            range(NUM_BODY + NUM_DISTURBANCE)
        ) - left_out


def test_the_filter_estimates_only_states_that_the_outputs_determine(scenario, log):
    log = replace(log, velocity=np.zeros((200, 3)))
    assert predictor_of(scenario, log, [Output("position", 2)]).rows.tolist() == [2, 8, 14]
    velocities = [Output(signal, column) for signal in ("attitude", "velocity") for column in range(3)]
    everything = set(range(NUM_BODY + NUM_DISTURBANCE))
    assert {*predictor_of(scenario, log, velocities).rows.tolist()} == everything - {0, 1, 2}
    # If disturbances act along the axes of the body, no constant force along the axes of W is estimated.
    model = LogModel(scenario, ["mass"], frame="body")
    windows = [LogWindow(0, 30)]
    assert {*Predictor(model, [log], windows, SIZES, POSE).rows.tolist()} == everything - {18, 19}
    assert {*Predictor(model, [log], windows, SIZES, IMU).rows.tolist()} == everything - {0, 1, 2, 5, 18, 19}


def test_a_logged_attitude_that_is_not_predicted_is_initially_known_to_two_degrees(scenario, log, values):
    """A predicted attitude begins at its first measurement. An attitude that is not logged is initially unknown."""
    without_attitude = replace(log, attitude=None)
    for record, outputs, expected in ((log, IMU, 0.03), (without_attitude, IMU, 0.5), (log, POSE, 0.5)):
        predictor = predictor_of(scenario, record, outputs)
        first = predictor.gains(values, noise_of(outputs)).initial_covariance
        attitude_rows = np.flatnonzero(np.isin(predictor.rows, [3, 4, 5]))
        deviations = np.sqrt(np.diagonal(first, axis1=1, axis2=2))
        np.testing.assert_allclose(deviations[:, attitude_rows], expected)
        np.testing.assert_allclose(deviations[:, predictor.rows.tolist().index(9)], 10.0)


def test_the_predicted_attitude_is_that_of_the_marker_frame(log, values):
    scenario = load_scenario("laboratory:low_wind", ["laboratory.motion_capture.misalignment=[0.02, -0.03, 0.1]"])
    predictor = predictor_of(scenario, log)
    flight, state = predictor._begin(values[None])
    markers = rotation_matrices(state[3:6, 0].T) * rotation_matrices(np.array([0.02, -0.03, 0.1]))
    expected = markers.as_euler("ZYX").T[::-1]
    np.testing.assert_allclose(predictor._predicted(flight, state)[3:, 0], expected, atol=1e-12)


@pytest.mark.parametrize("split", [1, 2])
def test_an_open_loop_prediction_begins_at_the_last_measurement_of_the_filter(scenario, log, values, split):
    """The gains are zero after this measurement.

    The two predictions, without and with the disturbance, differ by its force and torque from the first step on.
    """
    predictor, noise = predictor_of(scenario, log, split=split), noise_of(POSE)
    gains = predictor.gains(values, noise)
    steps = [1, 3, 20]
    begin, *ends = predictor.open_loop(values, gains, steps)
    last = SIZES.settle - 1
    errors, before = predictor.errors(values[None], gains, return_state_at=last)
    after = before[:, 0].copy()
    after[predictor.rows] += np.einsum("nmw,mw->nw", gains.gain[last], errors[last, :, 0])
    for column in (0, 1):
        np.testing.assert_allclose(begin[:, column], after[:NUM_BODY], atol=1e-12)
    held = gains._replace(gain=np.where(predictor.evaluated[:, None, None, None], 0.0, gains.gain))
    for step, end in zip(steps, ends, strict=True):
        _, expected = predictor.errors(values[None], held, return_state_at=last + step)
        np.testing.assert_allclose(end[:, 1], expected[:NUM_BODY, 0], atol=1e-9)
    disturbed, undisturbed = ends[0][:, 1], ends[0][:, 0]
    force, torque, constant = after[NUM_BODY : NUM_BODY + 3], after[NUM_BODY + 3 : NUM_BODY + 6], after[NUM_BODY + 6 :]
    assert min(np.abs(force).max(), np.abs(torque).max(), np.abs(constant).max()) > 0.01
    force[:2] += constant
    np.testing.assert_allclose((disturbed - undisturbed)[6:9], PERIOD * force, rtol=2e-2, atol=1e-4)
    np.testing.assert_allclose((disturbed - undisturbed)[9:12], PERIOD * torque, rtol=2e-2, atol=1e-4)


def test_windows_begin_at_the_measured_states_with_zeros_for_unmeasured_states(scenario, log, values):
    predictor = predictor_of(scenario, log)
    state = predictor.initial.state
    for w, start in enumerate((30, 50, 90)):
        first = start - SIZES.settle
        np.testing.assert_array_equal(state[:3, w], log.position[first])
        np.testing.assert_array_equal(state[3:6, w], log.attitude[first])
        np.testing.assert_array_equal(state[9:12, w], log.body_rates[first])
        np.testing.assert_array_equal(predictor.measured[:, :3, w], log.position[first : start + SIZES.length])
        np.testing.assert_array_equal(predictor.measured[:, 3:, w], log.attitude[first : start + SIZES.length])
    np.testing.assert_array_equal(state[[6, 7, 8, *range(NUM_BODY, NUM_BODY + NUM_DISTURBANCE)]], 0.0)
    np.testing.assert_array_equal(predictor.evaluated, np.arange(30) >= 10)
    # The initial standard deviations are 1 m, 0.5 rad, 2 m/s and 10 rad/s, followed by those of disturbance and wind
    # force.
    noise = noise_of(POSE)
    first = predictor.gains(values, noise).initial_covariance
    unknown = np.concatenate([np.repeat([1.0, 0.5, 2.0, 10.0], 3), noise.disturbance, [1.0, 1.0]])
    np.testing.assert_allclose(first, np.tile(np.diag(unknown**2), (3, 1, 1)))


@pytest.mark.parametrize("outputs", [POSE, IMU], ids=["pose", "imu"])
def test_gains_satisfy_the_equations_of_a_kalman_filter(scenario, log, values, outputs):
    """The covariance is corrected, propagated, and increased by process noise, from measurement to measurement."""
    predictor, noise = predictor_of(scenario, log, outputs), noise_of(outputs)
    gains = predictor.gains(values, noise)
    R, Q = np.diag(noise.measured**2), np.diag(predictor.process_noise(noise))
    for w in range(3):
        P = gains.initial_covariance[w]
        for j in range(30):
            if j == SIZES.length:
                np.testing.assert_allclose(gains.final_covariance[w], P, rtol=1e-6, atol=1e-9)
            H, F = gains.output[j, w], gains.transition[j, w]
            S = H @ P @ H.T + R
            K = P @ H.T @ np.linalg.inv(S)
            np.testing.assert_allclose(gains.gain[j, :, :, w], K, rtol=1e-6, atol=1e-8)
            np.testing.assert_allclose(gains.whitening[j, w] @ S @ gains.whitening[j, w].T, np.eye(6), atol=1e-6)
            np.testing.assert_array_equal(np.triu(gains.whitening[j, w], 1), 0.0)
            P = F @ (P - K @ H @ P) @ F.T + Q
    # The transition matrix contains the decay of the disturbance, and the effect of a force on the velocity.
    rows = predictor.rows.tolist()
    disturbance_rows = [rows.index(NUM_BODY + i) for i in range(6)]
    np.testing.assert_allclose(
        gains.transition[:, :, disturbance_rows, disturbance_rows],
        np.broadcast_to(np.exp(-PERIOD / noise.correlation_time), (30, 3, 6)),
        rtol=1e-5,
    )
    velocity_rows = [rows.index(STATE_ROWS["velocity"] + i) for i in range(3)]
    np.testing.assert_allclose(gains.transition[:, :, velocity_rows, disturbance_rows[:3]], PERIOD, rtol=1e-3)
    constant_rows = [rows.index(NUM_BODY + i) for i in (6, 7)]
    np.testing.assert_allclose(gains.transition[:, :, constant_rows, constant_rows], 1.0, rtol=1e-5)
    np.testing.assert_allclose(gains.transition[:, :, velocity_rows[:2], constant_rows], PERIOD, rtol=1e-3)


@pytest.mark.parametrize("outputs", [POSE, IMU], ids=["pose", "imu"])
@pytest.mark.parametrize("split", [1, 2])
def test_errors_for_the_parameters_of_the_gains_equal_the_errors_of_the_filter(scenario, log, values, outputs, split):
    """For other parameters, the errors differ from those of the filter."""
    predictor, noise = predictor_of(scenario, log, outputs, split=split), noise_of(outputs)
    gains = predictor.gains(values, noise)
    other_values = values * [1.001, 1.0]
    errors, _ = predictor.errors(np.stack([values, other_values, values]), gains)
    np.testing.assert_allclose(errors[:, :, 0], gains.errors, atol=1e-9)
    np.testing.assert_array_equal(errors[:, :, 2], errors[:, :, 0])
    assert np.abs(errors[:, :, 1] - errors[:, :, 0]).max() > 1e-6


def test_a_window_continues_from_the_end_of_the_previous_one(scenario, log, values):
    """The window at sample 50 directly follows the window at sample 30. The window at sample 90 follows no window."""
    # The rotor speeds are the same in all windows, since the commands are constant.
    log = replace(log, rotor_speed_command=np.tile(log.rotor_speed_command[50], (200, 1)))
    predictor, noise = predictor_of(scenario, log), noise_of(POSE)
    gains = predictor.gains(values, noise)
    _, states = predictor.errors(np.stack([values, values * [1.0, 1.1]]), gains)
    jacobian = np.stack([0.0 * states[:, 0], (states[:, 1] - states[:, 0]) / (0.1 * values[1])], axis=1)
    before = predictor.initial.state.copy()
    predictor.continue_windows(states[:, 0], jacobian, values, gains)
    after = predictor.initial
    np.testing.assert_array_equal(after.continued, [False, True, False])
    np.testing.assert_array_equal(after.state[:, 1], states[:, 0, 0])
    np.testing.assert_array_equal(after.state[:, [0, 2]], before[:, [0, 2]])
    np.testing.assert_array_equal(after.jacobian[:, :, 1], jacobian[:, :, 0])
    again = predictor.gains(values, noise)
    np.testing.assert_array_equal(again.initial_covariance[1], gains.final_covariance[0])
    np.testing.assert_array_equal(again.initial_covariance[0], gains.initial_covariance[0])
    # The filter continues, so the second window predicts as if both windows were one.
    first_predictor = predictor_of(scenario, log, windows=[LogWindow(0, 30)])
    one_window = Predictor(first_predictor.model, [log], [LogWindow(0, 30)], SIZES._replace(length=40), POSE).gains(
        values, noise
    )
    np.testing.assert_allclose(again.errors[:, :, 1], one_window.errors[20:, :, 0], atol=1e-6)
    # If the parameters change, the initial state of a continued window changes with the final state of the previous
    # window, to first order.
    flight, initial_state = predictor._begin(values[None] * [1.0, 1.1])
    np.testing.assert_allclose(initial_state[:, 0, 1], states[:, 1, 0], atol=1e-9)
    np.testing.assert_allclose(initial_state[:, 0, 0], before[:, 0])
    assert flight.shape == (1, 3)


@pytest.mark.parametrize(("outputs", "tolerance"), [(POSE, 0.01), (IMU, 0.2)], ids=["pose", "imu"])
def test_linearised_errors_approximate_the_errors_of_a_filter_with_changed_noise(
    scenario, log, values, outputs, tolerance
):
    """The difference from the errors of the filter is a small fraction of the change that the noise causes."""
    predictor, noise = predictor_of(scenario, log, outputs), noise_of(outputs)
    gains, chosen = predictor.gains(values, noise), np.array([0, 2])
    others = [noise, noise_of(outputs, white=1.1), noise_of(outputs, push=1.1), noise_of(outputs, memory=0.9)]
    each = [predictor.linearised_errors(gains, [other], chosen) for other in others]
    errors, spreads = (np.concatenate(parts, axis=1) for parts in zip(*each, strict=True))
    assert errors.shape == (20, 4, 2, 6)
    levels = noise.measured

    def relative_errors(filtered):
        whitening = filtered.whitening[10:][:, chosen]
        covariances = np.linalg.inv(whitening.swapaxes(-1, -2) @ whitening)
        return filtered.errors[10:][:, :, chosen].transpose(0, 2, 1) / levels, covariances / np.outer(levels, levels)

    for c, other in enumerate(others):
        result = errors[:, c] / levels, spreads[:, c] / np.outer(levels, levels)
        for actual, initial, expected in zip(
            result, relative_errors(gains), relative_errors(predictor.gains(values, other)), strict=True
        ):
            assert np.linalg.norm(actual - expected) <= tolerance * np.linalg.norm(expected - initial) + 1e-6


@pytest.mark.parametrize("outputs", [POSE, IMU], ids=["pose", "imu"])
@pytest.mark.parametrize("first", [{"white": 1.1}, {"push": 0.8}, {"memory": 1.2}], ids=lambda first: next(iter(first)))
def test_several_sets_of_noise_parameters_are_linearised_together(scenario, log, values, outputs, first):
    """The noise parameters change by 0.1 %. The resulting change differs from that of separate calls by at most 1 %."""
    predictor, noise = predictor_of(scenario, log, outputs), noise_of(outputs)
    gains, chosen = predictor.gains(values, noise), np.array([2, 0])
    changed_noise = [
        noise_of(outputs, **(first | {name: first.get(name, 1.0) * 1.001})) for name in ("white", "push", "memory")
    ]
    together = predictor.linearised_errors(gains, [noise_of(outputs, **first), *changed_noise], chosen)
    for c, other in enumerate(changed_noise, 1):
        for actual, alone in zip(together, predictor.linearised_errors(gains, [other], chosen), strict=True):
            change, expected = actual[:, c] - actual[:, 0], alone[:, 0] - actual[:, 0]
            assert np.linalg.norm(expected) > 1e-9
            assert np.linalg.norm(change - expected) < 0.01 * np.linalg.norm(expected)


@pytest.mark.long
def test_the_maximum_likelihood_noise_is_the_noise_of_the_log(scenario, values):
    """The search starts with noise that is wrong by a factor of two. The log of a few seconds limits the accuracy."""
    random = np.random.default_rng(8)
    true = PredictionNoise(0.7 * noise_of(POSE).measured, np.array([0.5, 0.5, 0.8, 6.0, 6.0, 3.0]), np.full(6, 0.2))
    hover = np.sqrt(scenario.vehicle.mass * scenario.vehicle.gravity / (4.0 * scenario.vehicle.thrust_factor))
    log = FlightRecord(
        "still",
        PERIOD * np.arange(260),
        position=np.zeros((260, 3)),
        attitude=np.zeros((260, 3)),
        rotor_speed_command=np.full((260, 4), hover),
    )
    predictor = predictor_of(
        scenario, log, windows=[LogWindow(0, 55)] * 5, sizes=WindowSizes(length=150, settle=50, warm_up=5)
    )
    flight, state = predictor._begin(values[None])
    forgetting = slice(NUM_BODY, NUM_BODY + 6)
    state[forgetting, 0] = true.disturbance[:, None] * random.normal(size=(6, 5))
    decay, measured = np.exp(-PERIOD / true.correlation_time), []
    for _ in range(200):
        measured.append(predictor._predicted(flight, state)[:, 0])
        flight.step(state)
        process_noise = true.disturbance * np.sqrt(1.0 - decay**2)
        state[forgetting, 0] = decay[:, None] * state[forgetting, 0] + process_noise[:, None] * random.normal(
            size=(6, 5)
        )
    predictor.measured = np.stack(measured) + true.measured[:, None] * random.normal(size=(200, 6, 5))
    result = PredictionNoise(2.0 * true.measured, 0.5 * true.disturbance, true.correlation_time)
    for _ in range(2):
        result = fitting._noise_of(predictor, predictor.gains(values, result))
    np.testing.assert_allclose(result.measured, true.measured, rtol=0.1)
    np.testing.assert_allclose(result.disturbance, true.disturbance, rtol=0.4)


@pytest.mark.slow
def test_a_fit_minimises_the_whitened_errors_of_windows_that_continue_each_other(scenario, log, values):
    """The derivatives with respect to parameters inside their limits are zero.

    All other parameters stay at their limits.
    """
    predictor, noise = predictor_of(scenario, log), noise_of(POSE)
    parameters = [
        Parameter(name, 1.2 * value, value, 0.5 * value, 2.0 * value)
        for name, value in zip(("mass", "linear_drag"), values, strict=True)
    ]
    result = fitting.fit(predictor, parameters, noise)
    assert result.jacobian.shape == (3, 20 * 6, 2)
    assert result.errors.shape == (3, 20 * 6)
    np.testing.assert_array_equal(predictor.initial.continued, [False, True, False])
    np.testing.assert_array_equal(predictor.initial.parameters, result.values)
    inside = (result.values > 0.501 * values) & (result.values < 1.999 * values)
    jacobian = np.einsum("wkp,wk->p", result.jacobian, result.errors) + result.prior * (result.values - 1.2 * values)
    deviations = 1.0 / np.sqrt(np.einsum("wkp,wkp->p", result.jacobian, result.jacobian) + result.prior)
    assert np.abs(jacobian * deviations)[inside].max(initial=0.0) < 0.5
    # The mass is inside its limits, because the thrust in the log determines the weight.
    assert inside[0]
    assert result.values[0] == pytest.approx(values[0], rel=0.2)


def test_a_yaw_that_wraps_is_predicted_like_one_that_does_not(scenario, log, values):
    turned = log.attitude + np.array([0.0, 0.0, np.pi - log.attitude[:, 2].mean()])
    jumping = np.where(turned > np.pi, turned - 2.0 * np.pi, turned)
    assert np.count_nonzero(np.abs(np.diff(jumping[:, 2])) > 6.0) > 20
    noise = PredictionNoise(np.repeat([1e-3, 4e-3], 3), np.full(6, 0.3), np.full(6, 0.5))
    errors = []
    for attitude in (turned, jumping):
        predictor = predictor_of(scenario, replace(log, attitude=attitude))
        gains = predictor.gains(values, noise)
        errors.append([gains.errors, predictor.errors(values[None], gains)[0][:, :, 0]])
    assert np.abs(errors[0][0]).max() < 0.1
    np.testing.assert_allclose(errors[1], errors[0], atol=1e-6)


def test_the_covariance_of_the_noise_is_large_where_the_log_does_not_identify_it(scenario, log, values):
    """White noise is known to 1 / √(2n) of its value from n measurements.

    The correlation time is unknown if the disturbance is zero.
    """
    predictor = predictor_of(scenario, log)
    noise = PredictionNoise(np.repeat([1e-3, 4e-3], 3), np.full(6, 1e-6), np.full(6, 0.5))
    fitted = SimpleNamespace(noise=noise, gains=predictor.gains(values, noise))
    variances = np.diag(fitting.noise_covariance(predictor, fitted))
    num_measurements = 3 * 3 * SIZES.length
    np.testing.assert_allclose(variances[:6], 0.5 / num_measurements, rtol=0.3)
    assert (variances[6:] > 100.0).all()


def test_every_window_has_the_same_weight_in_the_estimate_of_the_noise(scenario, values):
    """One of three windows has three times the noise of the two other windows."""
    random = np.random.default_rng(4)
    hover = np.sqrt(scenario.vehicle.mass * scenario.vehicle.gravity / (4.0 * scenario.vehicle.thrust_factor))
    zeros = np.zeros((130, 3))
    log = FlightRecord(
        "still", PERIOD * np.arange(130), position=zeros, attitude=zeros, rotor_speed_command=np.full((130, 4), hover)
    )
    predictor = predictor_of(
        scenario, log, windows=[LogWindow(0, 30)] * 3, sizes=WindowSizes(length=100, settle=20, warm_up=5)
    )
    white = np.repeat([1e-3, 4e-3], 3)
    predictor.measured = white[:, None] * [1.0, 1.0, 3.0] * random.normal(size=(120, 6, 3))
    initial = PredictionNoise(2.0 * white, np.full(6, 1e-2), np.full(6, 0.5))
    result = fitting._noise_of(predictor, predictor.gains(values, initial))
    np.testing.assert_allclose(result.measured, white * np.sqrt((1.0 + 1.0 + 9.0) / 3.0), rtol=0.1)


def test_limiting_the_correlation_time_of_forces_leaves_other_noise_parameters_free(scenario, log, values):
    """The correlation time of forces along body axes is at most 0.25 s.

    Forces that last longer are errors of the thrust curve.
    """
    model = LogModel(scenario, ["mass"], frame="body")
    predictor = Predictor(model, [log], [LogWindow(0, 30), LogWindow(0, 90)], SIZES, IMU)
    initial = PredictionNoise(noise_of(IMU, white=30.0).measured, np.full(6, 5.0), np.full(6, 0.2))
    result = fitting._noise_of(predictor, predictor.gains(values[:1], initial))
    assert result.correlation_time[:3].max() <= 0.25 * (1.0 + 1e-9)
    # A noise parameter changes by at most a factor of 12.
    assert result.disturbance.min() > 5.0 / 12.2
    assert result.measured[3:].min() > 30.0 * 0.3 / 12.2
