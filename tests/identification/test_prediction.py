"""Tests of open-loop predictions: errors of the true vehicle, of a wrong one, and of motion at constant rates."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad import InputError, load_scenario, simulate
from drake_quad.identification.evidence import quantile
from drake_quad.identification.identify import identify
from drake_quad.identification.results.vehicle_values import with_throttles, with_vehicle_values
from drake_quad.identification.validation import prediction
from drake_quad.identification.validation.prediction import (
    CONSTANT_ACCELERATION,
    CONSTANT_VELOCITY,
    WITH_DISTURBANCE,
    Predictions,
    concatenate_predictions,
    predict,
)
from drake_quad.logs.reading import read_log
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.files.loading import load_undesigned

PREDICTORS_WITHOUT_MODEL = (CONSTANT_VELOCITY, CONSTANT_ACCELERATION)


@pytest.fixture(scope="module")
def scenario(root):
    overrides = (
        "duration=10",
        "laboratory.wind=[{kind: steady, velocity: [1.0, 0.0, 0.0]}]",
        # With the next three values, commands have a total delay of one camera frame, 10 ms, which the log also has.
        "laboratory.motion_capture.period=0.01",
        "laboratory.command_link.delay_ticks=0",
        "laboratory.command_link.loss_rate=0",
    )
    return load_scenario(root / "diagrams" / "laboratory.yaml:low_wind", overrides)


@pytest.fixture(scope="module")
def record(scenario):
    """Return a log of the noise-free state, delayed by 10 ms, and of the commands."""
    flight = simulate(scenario, compiled=True)
    state = np.array([np.interp(flight.time - 0.01, flight.time, row) for row in flight["state"].T]).T
    command = np.concatenate([flight["rotor_speed_command"][1:], flight["rotor_speed_command"][-1:]])
    rows = dict(zip(("position", "attitude", "velocity", "body_rates"), np.split(state, 4, axis=1), strict=True))
    return FlightRecord("flown", flight.time, **rows, rotor_speed_command=command)


@pytest.fixture(scope="module")
def predictions(record, scenario):
    stronger = with_vehicle_values(scenario, {"thrust_factor": 1.1 * scenario.vehicle.thrust_factor})
    return predict(record, {"stronger": stronger, "right": scenario}, horizons=(0.1, 0.5, 1.0))


@pytest.fixture
def unfitted(monkeypatch):
    """Keep the initial noise of filters, for tests that do not depend on the noise."""
    monkeypatch.setattr(prediction, "fit", lambda predictor, parameters, noise: SimpleNamespace(noise=noise))


def moving(turning, *, acceleration=(0.0, 0.0, 0.0), angular=0.0, seconds=6.0):
    """Return a log of motion with constant accelerations, at 100 Hz.

    Args:
        turning: (3,) initial turn rate, rad/s.
        acceleration: (3,) constant acceleration, m/s².
        angular: angular acceleration divided by the initial turn rate, 1/s.
        seconds: duration, s.
    """
    time = 0.01 * np.arange(round(100 * seconds))
    velocity = np.array([0.5, -0.3, 0.2]) + time[:, None] * np.array(acceleration)
    position = time[:, None] * np.array([0.5, -0.3, 0.2]) + 0.5 * time[:, None] ** 2 * np.array(acceleration)
    turned = Rotation.from_rotvec(np.outer(time + 0.5 * angular * time**2, turning))
    rates = np.outer(1.0 + angular * time, turning)
    attitude = turned.as_euler("ZYX")[:, ::-1]
    commands = np.full((len(time), 4), 200.0)
    return FlightRecord(
        "moving", time, position=position, velocity=velocity, attitude=attitude, body_rates=rates,
        rotor_speed_command=commands,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.usefixtures("unfitted")
@pytest.mark.parametrize("left_out", [(), ("velocity",), ("body_rates",), ("velocity", "body_rates")])
def test_constant_velocity_predicts_a_uniform_motion_exactly(scenario, left_out):
    """Velocities and rates that are not logged follow from positions and attitudes."""
    log = replace(moving([0.02, -0.03, 0.2], seconds=3.0), **dict.fromkeys(left_out))
    result = predict(log, {"vehicle": scenario}, horizons=(0.1, 1.0))
    for quantity in result.errors:
        for horizon in result.horizons:
            for simple in PREDICTORS_WITHOUT_MODEL:
                assert result.rmse(quantity, simple, horizon).value < 1e-6, (quantity, simple)


@pytest.mark.slow
@pytest.mark.usefixtures("unfitted")
@pytest.mark.parametrize("left_out", [(), ("velocity", "body_rates")])
def test_constant_acceleration_predicts_an_accelerated_motion_exactly(scenario, left_out):
    """The errors at constant velocity are the displacement, velocity change and angle that the accelerations cause."""
    acceleration, angular, axis = [0.4, 0.0, -0.3], 0.2, [0.0, 0.0, 0.3]
    log = replace(moving(axis, acceleration=acceleration, angular=angular, seconds=3.0), **dict.fromkeys(left_out))
    actual = predict(log, {"vehicle": scenario}, horizons=(0.1, 1.0))
    expected = {
        "position": lambda h: 0.5 * 0.5 * h**2,
        "velocity": lambda h: 0.5 * h,
        "attitude": lambda h: 0.5 * 0.3 * angular * h**2,
        "body_rates": lambda h: 0.3 * angular * h,
    }
    for quantity in actual.errors:
        for horizon in actual.horizons:
            assert actual.rmse(quantity, CONSTANT_ACCELERATION, horizon).value < 1e-6
            velocity = actual.rmse(quantity, CONSTANT_VELOCITY, horizon).value
            assert velocity == pytest.approx(expected[quantity](horizon), rel=1e-3)


@pytest.mark.long
def test_the_true_vehicle_predicts_a_flight_without_noise(predictions):
    """The remaining error is that of the initial state, which is estimated by a parabola through 50 ms of motion."""
    assert predictions.rmse("position", "right", 0.5).value < 2e-3
    assert predictions.rmse("attitude", "right", 0.5).value < 5e-3
    for quantity in predictions.errors:
        for simple in PREDICTORS_WITHOUT_MODEL:
            assert predictions.error_reduction(quantity, "right", simple, 0.5).low > 0.9
    assert predictions.remark_on_worse_predictions("right") == ""


@pytest.mark.long
def test_a_prediction_with_a_vehicle_starts_from_the_velocity_of_the_kalman_filter(record, scenario):
    """Position noise affects the velocity from the last few samples much more than the velocity of the filter."""
    random = np.random.default_rng(1)
    position = record.position + 2e-3 * random.normal(size=record.position.shape)
    result = predict(replace(record, position=position, velocity=None), {"right": scenario}, horizons=(0.1, 0.5))
    for horizon in result.horizons:
        assert result.error_reduction("position", "right", CONSTANT_VELOCITY, horizon).low > 0.5


@pytest.mark.long
def test_the_estimated_disturbance_compensates_a_wrong_thrust(predictions):
    """The model called `stronger` has 10 % too much thrust, which its filter attributes to a downward force.

    With this estimated disturbance, the position predictions over 0.1 s have at most a fifth of the error.
    """
    assert predictions.vehicles == ("stronger", "right", *PREDICTORS_WITHOUT_MODEL, WITH_DISTURBANCE)
    assert predictions.error_reduction("position", WITH_DISTURBANCE, "stronger", 0.1).low > 0.8


@pytest.mark.long
@pytest.mark.parametrize("horizon", [0.1, 0.5])
def test_ten_percent_more_thrust_accelerates_upwards_by_a_tenth_of_gravity(predictions, horizon):
    """The rotors already follow the commands at the start, so the additional thrust acts at once."""
    expected = 0.5 * 0.1 * 9.81 * horizon**2
    assert predictions.rmse("position", "stronger", horizon).value == pytest.approx(expected, rel=0.1)
    better = predictions.error_reduction("position", "right", "stronger", horizon)
    assert better.low > 0.8
    assert better.value == pytest.approx(
        1.0 - predictions.rmse("position", "right", horizon).value / expected, abs=0.05
    )


@pytest.mark.slow
def test_fewer_predictions_are_evaluated_at_longer_horizons(predictions):
    starts = [predictions.starts(horizon) for horizon in predictions.horizons]
    assert starts[0] > starts[1] > starts[2] > 50


def of_errors(errors, names=("one", "other"), *, horizon=0.5, quantity="position"):
    """Return predictions with errors (v, S) from starts that are one second apart."""
    count = errors.shape[1]
    return Predictions(names, (horizon,), np.array(["a"] * count), np.arange(1.0 * count), {quantity: errors[:, None]})


def test_a_vehicle_that_predicts_significantly_worse_than_a_baseline_is_reported():
    similar_errors = np.array([1.0, 1.1, 0.9, 1.0, 1.05, 0.95])
    errors = np.stack([2.0 * similar_errors, similar_errors, 3.0 * similar_errors])
    names = ("mine", *PREDICTORS_WITHOUT_MODEL)
    result = of_errors(errors, names, quantity="body_rates").remark_on_worse_predictions("mine")
    assert result == "mine predicts worse than constant velocity or constant acceleration: body rates (0.5 s)"
    scattered_errors = np.stack(
        [np.array([1.0, 2.0, 1.0, 2.0, 1.0, 2.1]), np.array([2.0, 1.0, 2.0, 1.0, 2.0, 1.0]), 9.0 * similar_errors]
    )
    assert of_errors(scattered_errors, names).error_reduction("position", "mine", "constant velocity", 0.5).value < 0.0
    assert of_errors(scattered_errors, names).remark_on_worse_predictions("mine") == ""
    assert (
        of_errors(
            np.stack([similar_errors, 2.0 * similar_errors, 2.0 * similar_errors]), names
        ).remark_on_worse_predictions("mine")
        == ""
    )


def test_intervals_of_an_rms_error_follow_from_blocks():
    """If each block contains one start, the interval of the logarithmic mean square is Student's t-interval."""
    errors = np.array([1.0, 2.0, 1.5, 0.5, 1.0, 3.0])
    squares = errors**2
    given = of_errors(np.stack([errors, 2.0 * errors]))
    result = given.rmse("position", "one", 0.5)
    half_width = 2.570582 * np.std(squares, ddof=1) / math.sqrt(6) / (2.0 * np.mean(squares))
    assert result.value == pytest.approx(math.sqrt(np.mean(squares)))
    assert result.high == pytest.approx(result.value * math.exp(half_width), rel=1e-6)
    assert given.error_reduction("position", "one", "other", 0.5) == pytest.approx((0.5, 0.5, 0.5))
    assert concatenate_predictions([given, given]).starts(0.5) == 12
    single = Predictions(
        ("one",), (0.5,), np.array(["a"] * 2), np.array([0.0, 0.1]), {"position": errors[None, None, :2]}
    )
    assert single.rmse("position", "one", 0.5).high == math.inf
    assert single.starts(0.5) == 2


def test_a_model_without_errors_is_better_than_all_others():
    given = of_errors(np.stack([np.zeros(6), np.arange(1.0, 7.0)]), ("exact", "other"))
    assert given.rmse("position", "exact", 0.5) == (0.0, 0.0, 0.0)
    assert given.error_reduction("position", "exact", "other", 0.5) == (1.0, 1.0, 1.0)
    assert np.isnan(given.error_reduction("position", "other", "exact", 0.5)).all()
    assert np.isnan(given.error_reduction("position", "exact", "exact", 0.5)).all()
    # A vehicle whose error is zero in some of the predictions is compared like any other.
    errors = np.stack([np.array([0.0, 1.0, 2.0, 1.0]), np.array([2.0, 2.0, 0.0, 4.0])])
    some = of_errors(errors).error_reduction("position", "one", "other", 0.5)
    assert some.value == pytest.approx(1.0 - math.sqrt(6.0 / 24.0))
    assert some.low < some.value < some.high


def test_concatenated_predictions_contain_the_quantities_that_all_logs_have():
    def part(name, count, *quantities):
        numbers = np.arange(2.0 * 3.0 * count).reshape(2, 3, count)
        return Predictions(
            ("one", "other"),
            (0.1, 0.5, 1.0),
            np.array([name] * count),
            np.arange(1.0 * count),
            dict.fromkeys(quantities, numbers),
        )

    both = concatenate_predictions(
        [part("a", 4, "position", "attitude", "velocity"), part("b", 2, "velocity", "position")]
    )
    assert set(both.errors) == {"position", "velocity"}
    np.testing.assert_array_equal(both.errors["position"][..., 4:], np.arange(12.0).reshape(2, 3, 2))
    assert both.log.tolist() == ["a"] * 4 + ["b"] * 2
    assert both.time.tolist() == [0.0, 1.0, 2.0, 3.0, 0.0, 1.0]
    assert (both.vehicles, both.horizons) == (("one", "other"), (0.1, 0.5, 1.0))
    single = concatenate_predictions([part("a", 4, "attitude", "velocity")])
    assert (single.vehicles, single.horizons) == (both.vehicles, both.horizons)
    assert [*single.errors] == ["attitude", "velocity"]
    with pytest.raises(InputError, match="no log is given; at least one is needed for a prediction"):
        concatenate_predictions([])


def test_blocks_are_as_long_as_the_horizon_and_lie_within_one_log():
    """Errors that are constant over two seconds have the same interval as independent blocks of two seconds."""
    sizes = np.array([1.0, 2.0, 1.5, 0.5, 1.0, 3.0])
    time = np.concatenate([np.arange(0.0, 8.0, 0.1), np.arange(0.0, 4.0, 0.1)])
    log = np.array(["a"] * 80 + ["b"] * 40)
    errors = np.repeat(sizes, 20)[None, None]
    result = Predictions(("one",), (2.0,), log, time, {"position": errors}).rmse("position", "one", 2.0)
    squares = sizes**2
    half_width = quantile(5) * np.std(squares, ddof=1) / math.sqrt(6) / (2.0 * np.mean(squares))
    assert result.high / result.value == pytest.approx(math.exp(half_width), rel=1e-6)
    assert result.low / result.value == pytest.approx(math.exp(-half_width), rel=1e-6)
    empty = Predictions(("one",), (2.0,), log, time, {"position": np.full((1, 1, 120), np.nan)})
    assert np.isnan(empty.rmse("position", "one", 2.0)).all()
    assert np.isnan(empty.error_reduction("position", "one", "one", 2.0)).all()


def test_the_interval_of_a_comparison_of_vehicles_follows_from_paired_differences():
    """The squared errors of each vehicle are divided by their mean before the difference is taken."""
    first, second = np.random.default_rng(4).uniform(1.0, 2.0, (2, 12))
    better = of_errors(np.stack([first, second])).error_reduction("position", "one", "other", 0.5)
    ratio = math.sqrt(np.mean(first**2) / np.mean(second**2))
    differences = first**2 / np.mean(first**2) - second**2 / np.mean(second**2)
    half_width = 0.5 * quantile(11) * math.sqrt(12.0 / 11.0 * np.sum(differences**2)) / 12.0
    assert better == pytest.approx(
        (1.0 - ratio, 1.0 - ratio * math.exp(half_width), 1.0 - ratio * math.exp(-half_width))
    )


@pytest.mark.slow
@pytest.mark.usefixtures("unfitted")
def test_predictions_end_where_the_vehicle_lands_or_the_log_has_a_gap(scenario):
    """No prediction starts in the first 0.4 s of the log, or within 50 ms after a gap."""
    log = moving([0.0, 0.0, 0.1], seconds=12.0)
    landed = np.where((log.time > 5.0) & (log.time < 7.0), 0.0, 200.0)
    outside_gap = (log.time < 9.0) | (log.time > 9.3)
    log = replace(log, rotor_speed_command=np.tile(landed[:, None], 4)).subset(outside_gap)
    result = predict(log, {"vehicle": scenario}, horizons=(0.1, 0.5))
    for i, horizon in enumerate(result.horizons):
        reached = np.isfinite(result.errors["position"][0, i])
        ends = result.time[reached] + horizon
        assert result.time.min() >= 0.4
        for start, end in zip(result.time[reached], ends, strict=True):
            assert end < 9.0 or start > 9.0, "across a gap"
            assert end < 5.0 or start > 7.0, "on the ground"
        after = result.time[result.time > 9.2]
        assert after.min() >= 9.3 + 0.04
    assert np.isfinite(result.errors["position"][0, 0]).sum() > np.isfinite(result.errors["position"][0, 1]).sum() > 20


def test_predictions_start_every_tenth_of_a_second_with_time_for_filter_and_horizon():
    """The filter needs half a second without a gap before the start of a prediction."""
    log = moving([0.0, 0.0, 0.1], seconds=4.0)
    starts = prediction._starts(log, 6, (0.2, 3.0), 1.0)
    assert (starts[0], set(np.diff(starts))) == (50, {10})
    assert starts[-1] + 20 < len(log.time) <= starts[-1] + 20 + 10
    # In a log with two samples per second, a prediction starts at each sample.
    slow = prediction._starts(replace(log, time=50.0 * log.time), 6, (2.0,), 1.0)
    assert (slow[0], set(np.diff(slow))) == (6, {1})
    # The parabola through the last 77 samples needs more time before the start of a prediction than the filter.
    assert prediction._starts(log, 77, (0.2,), 1.0)[0] == 77
    gapped = log.subset((log.time < 2.0) | (log.time > 2.3))
    starts = prediction._starts(gapped, 6, (0.2,), 1.0)
    times = gapped.time[starts]
    assert times[times < 2.0].max() + 0.2 < 2.0
    # The commands that the rotors follow are unknown after a gap.
    assert times[times > 2.0].min() == pytest.approx(2.31 + 0.5, abs=0.1)
    # If the final fraction of the flight is 0.25, predictions start only in the last quarter of the flight.
    in_last_quarter = prediction._starts(log, 6, (0.2,), 0.25)
    np.testing.assert_array_equal(
        in_last_quarter, [start for start in prediction._starts(log, 6, (0.2,), 1.0) if start >= 300]
    )


def test_the_yaw_rate_is_correct_where_the_logged_yaw_wraps():
    time = 0.01 * np.arange(100)
    yaw = 3.0 + 0.5 * time + 0.2 * time**2
    attitude = np.column_stack([0.3 * time, -0.2 * time, (yaw + np.pi) % (2.0 * np.pi) - np.pi])
    starts = np.arange(10, 100)
    log = FlightRecord("turning", time, attitude=attitude)
    motion = prediction._Motion.at(log, ["attitude"], starts, 6)
    # The yaw is unwrapped before parabolas are fitted, so the body rates in rows 9 to 11 of the state stay small.
    np.testing.assert_allclose(motion.state[3:5], attitude[starts, :2].T, atol=1e-9)
    turns = (motion.state[5] - yaw[starts]) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert np.all(np.linalg.norm(motion.state[9:], axis=0) < 2.0)


def test_a_prediction_is_evaluated_only_if_the_flight_has_no_gap_up_to_the_horizon():
    log = moving([0.0, 0.0, 0.1], seconds=10.0)
    landed = np.where((log.time >= 5.0) & (log.time < 9.0), 0.0, 200.0)
    log = replace(log, rotor_speed_command=np.tile(landed[:, None], 4))
    log = log.subset((log.time < 2.0) | (log.time >= 2.2))
    flying = prediction.airborne_mask(log)
    piece = np.cumsum(np.append(0.0, np.diff(log.time)) > 0.05)
    starts = np.arange(0, len(log.time), 7)
    for steps in (1, 20, 100):
        expected = [
            start + steps < len(log.time)
            and piece[start] == piece[start + steps]
            and bool(flying[start : start + steps + 1].all())
            for start in starts
        ]
        np.testing.assert_array_equal(prediction._continues(log, starts, steps), expected)
    assert 0 < np.sum(prediction._continues(log, starts, 20)) < len(starts)


def test_prediction_errors_are_norms_of_differences_and_the_angle_between_attitudes():
    """If no attitudes are logged, only vertical errors are computed, because only the vertical motion is predicted."""
    random = np.random.default_rng(5)
    log = moving([0.3, -0.4, 0.9], seconds=1.0)
    starts, steps = np.array([10, 30, 60]), [5, 20]
    predicted = [random.normal(size=(12, 3)) for _ in steps]
    measured = ("position", "attitude", "velocity", "body_rates")
    actual = prediction._errors(log, measured, predicted, starts, steps, False)
    assert set(actual) == {*measured}
    for h, (step, state) in enumerate(zip(steps, predicted, strict=True)):
        for s, start in enumerate(starts):
            position, attitude, velocity, rates = np.split(state[:, s], 4)
            for name, value in (("position", position), ("velocity", velocity), ("body_rates", rates)):
                expected = np.linalg.norm(value - log.of(name)[start + step])
                assert actual[name][h, s] == pytest.approx(expected)
            turn = Rotation.from_euler("ZYX", attitude[::-1]).inv() * Rotation.from_euler(
                "ZYX", log.attitude[start + step][::-1]
            )
            assert actual["attitude"][h, s] == pytest.approx(np.linalg.norm(turn.as_rotvec()))
    level = prediction._errors(log, ("position", "velocity"), predicted, starts, steps, True)
    assert set(level) == {"height", "climb"}
    np.testing.assert_allclose(level["height"][1], np.abs(predicted[1][2] - log.position[starts + 20, 2]))
    np.testing.assert_allclose(level["climb"][0], np.abs(predicted[0][8] - log.velocity[starts + 5, 2]))


def test_a_log_with_too_few_samples_for_the_horizons_is_refused(scenario):
    slow = replace(moving([0.0, 0.0, 0.1]), time=0.15 * np.arange(600))
    with pytest.raises(
        InputError, match=r"has a sampling period of 0.15 s, which is too long for predictions over 0.1, 0.2, 0.5"
    ):
        predict(slow, {"right": scenario})


@pytest.mark.parametrize(("period", "samples"), [(0.005, 11), (0.01, 6), (0.012, 5), (0.02, 4), (0.05, 4)])
def test_parabolas_are_fitted_to_fifty_milliseconds_and_at_least_four_samples(scenario, monkeypatch, period, samples):
    """The fifty milliseconds include the samples at both ends."""
    given = []

    def starts_of(record, num_past, horizons, fraction):
        given.append((num_past, fraction))
        return np.array([], dtype=int)

    monkeypatch.setattr(prediction, "_starts", starts_of)
    log = moving([0.0, 0.0, 0.1])
    log = replace(log, time=period / 0.01 * log.time)
    with pytest.raises(InputError, match="no airborne stretch of at least 0.7 s"):
        predict(log, {"vehicle": scenario}, horizons=(0.2, 0.5), final_fraction=0.3)
    assert given == [(samples, 0.3)]


def test_the_interval_of_a_mean_follows_from_independent_blocks():
    totals = np.array([1.0, -2.0, 0.5, 3.0])
    expected = quantile(3) * math.sqrt(4.0 / 3.0 * np.sum(totals**2))
    assert len(totals) * prediction._half_width(totals, np.arange(len(totals))) == pytest.approx(float(expected))
    assert prediction._half_width(totals[:1], np.zeros(1, dtype=int)) == math.inf
    assert math.isfinite(prediction._half_width(totals[:2], np.arange(2)))


@pytest.mark.slow
@pytest.mark.usefixtures("unfitted")
def test_only_the_end_of_the_flight_is_predicted_on_request(record, scenario):
    at_end = predict(record, {"right": scenario}, final_fraction=0.25, horizons=(0.1,))
    complete = predict(record, {"right": scenario}, horizons=(0.1,))
    assert at_end.time.min() > 0.7 * record.time[-1]
    assert len(at_end.time) == pytest.approx(0.25 * len(complete.time), abs=3)


@pytest.mark.parametrize(
    ("left_out", "message"),
    [
        (("position", "velocity", "attitude", "body_rates"), "contains no signal that can be predicted"),
        (("rotor_speed_command",), "has no commands for the vehicle"),
    ],
)
def test_a_log_without_predictable_signals_is_refused(record, scenario, left_out, message):
    with pytest.raises(InputError, match=message):
        predict(replace(record, **dict.fromkeys(left_out)), {"right": scenario})


def test_a_short_log_is_refused(record, scenario):
    with pytest.raises(InputError, match="has no airborne stretch of"):
        predict(record.subset(record.time < 0.3), {"right": scenario})


@pytest.mark.long
def test_the_height_of_a_flight_without_attitude_is_predicted(root):
    """The vehicle is fitted to one flight, and predicts another one."""
    base = with_throttles(load_undesigned(root / "diagrams" / "vehicles" / "crazyflie.yaml", ["nominal.mass=0.0287"]))
    folder = root / "tests" / "data" / "crazyflie" / "crazypad"
    first, second = (read_log(folder / f"normal_flight_E8_log0{i}.xz") for i in (0, 1))
    result = identify([first], base, held_out_fraction=0.0)
    vehicles = {"identified": result.vehicle, "data sheet": base}
    predictions = predict(second, vehicles, nominal=base, horizons=(0.5,))
    assert set(predictions.errors) == {"height", "climb"}
    assert predictions.error_reduction("height", "identified", "data sheet", 0.5).low > 0.8
