"""Tests of the noise, trim and delay that are estimated from a log, with synthetic data."""

import numpy as np
import pytest

from drake_quad.identification import hover
from drake_quad.identification.hover import delay_by_correlation, hover_means, white_noise
from drake_quad.logs.record import FlightRecord

RNG = np.random.default_rng(8)
TIME = np.arange(3000) * 0.01  # s
WEIGHT = 0.3  # N
IS_FLYING = (TIME > 8.0) & (TIME < 25.0)  # mask of the samples in flight


@pytest.fixture(scope="module")
def record():
    def drawn(size):
        return RNG.normal(scale=size, size=(3000, 3))

    moving = np.where(IS_FLYING & (TIME > 15.0), np.sin(TIME - 15.0), 0.0)[:, None]
    attitude = drawn(0.004) + np.array([0.02, -0.01, 0.5])
    attitude[:, 1] += 0.1 * moving[:, 0]
    command = np.roll(0.1 * moving, -12, axis=0) * [0.0, 1.0, 0.0]
    noise = np.where(IS_FLYING[:, None], drawn(0.002), drawn(0.001))
    return FlightRecord(
        "made",
        TIME,
        position=moving * [1.0, 0.0, 0.0] + noise,
        velocity=moving * [1.0, 0.0, 0.0],
        attitude=attitude,
        body_rates=drawn(0.01),
        attitude_command=command,
        thrust_command=np.where(IS_FLYING, 0.3, 0.0),
        torque_command=np.tile([1e-5, -2e-5, 0.0], (3000, 1)) + drawn(1e-6),
    )


def test_white_noise_is_estimated_at_rest_and_in_flight(record):
    noise = {each.signal: each for each in white_noise(record)}
    assert set(noise) == {"position", "attitude", "body_rates"}
    np.testing.assert_allclose(noise["position"].at_rest, 0.001, rtol=0.15)
    np.testing.assert_allclose(noise["position"].in_flight, 0.002, rtol=0.1)
    np.testing.assert_allclose(noise["attitude"].in_flight, 0.004, rtol=0.1)
    assert noise["attitude"].unit == "rad"


def test_a_log_that_begins_in_the_air_gives_no_noise_at_rest(record):
    noise = white_noise(record.subset(slice(1000, 2300)))[0]
    assert np.isfinite(noise.in_flight).all()


def test_trim_is_the_mean_over_samples_in_hover(record):
    result = hover_means(record, WEIGHT)
    assert result["mean roll"].value == pytest.approx(0.02, abs=4.0 * result["mean roll"].deviation)
    assert result["mean pitch"].value == pytest.approx(-0.01, abs=1e-3)
    assert result["mean torque about y"].value == pytest.approx(-2e-5, rel=0.02)
    assert result["mean thrust"].value == pytest.approx(0.3)
    assert result["mean roll"].deviation < 5e-4
    moving = (TIME > 15.5) & (TIME < 17.0)
    assert hover_means(record.subset(moving), WEIGHT) == {}


def test_the_delay_between_attitude_command_and_attitude_is_found(record):
    assert delay_by_correlation(record) == pytest.approx(0.12, abs=0.03)
    without_command = FlightRecord("bare", TIME, attitude=record.attitude)
    assert delay_by_correlation(without_command) is None


def hovering(seconds=20.0, **signals):
    """Return a log at 100 Hz that hovers throughout."""
    time = 0.01 * np.arange(round(100.0 * seconds))
    nothing = np.zeros((len(time), 3))
    usual = {"velocity": nothing, "attitude": nothing, "body_rates": nothing, "thrust_command": np.ones(len(time))}
    return FlightRecord("hovering", time, **(usual | signals))


def test_noise_is_estimated_only_far_from_take_off_and_landing():
    """Samples within 2 s of a flight are not used to estimate the noise at rest."""
    random = np.random.default_rng(2)
    time = 0.01 * np.arange(3000)
    commanded = np.where((time > 8.0) & (time < 20.0), 0.5, 0.0)
    logged = FlightRecord("log", time, thrust_command=commanded, position=np.zeros((3000, 3)))
    (noise,) = white_noise(logged)
    np.testing.assert_array_equal([noise.at_rest, noise.in_flight], np.zeros((2, 3)))
    # The noise in flight is estimated between 9 s and 19 s. Samples near take-off and landing are not used.
    deviation = np.where(((time > 7.2) & (time < 8.8)) | ((time > 19.2) & (time < 20.8)), 1.0, 1e-3)
    position = deviation[:, None] * random.normal(size=(3000, 3)) * [1.0, 2.0, 3.0]
    (noise,) = white_noise(FlightRecord("log", time, thrust_command=commanded, position=position))
    np.testing.assert_allclose(noise.at_rest, [1e-3, 2e-3, 3e-3], rtol=0.1)
    np.testing.assert_allclose(noise.in_flight, [1e-3, 2e-3, 3e-3], rtol=0.1)


def test_noise_is_the_magnitude_of_third_differences_divided_by_the_norm_of_their_coefficients():
    """The third differences of an alternating signal are eight times its amplitude."""
    values = 1e-3 * np.outer(np.where(np.arange(400) % 2, 1.0, -1.0), [1.0, 2.0, 3.0])
    (noise,) = white_noise(FlightRecord("log", 0.01 * np.arange(400), position=values))
    np.testing.assert_allclose(noise.in_flight, 8e-3 / np.sqrt(1 + 9 + 9 + 1) * np.array([1.0, 2.0, 3.0]))


def test_noise_is_not_estimated_across_a_gap_or_from_few_samples():
    """Third differences need four successive samples."""
    random = np.random.default_rng(3)
    log = hovering(position=1e-3 * random.normal(size=(2000, 3)))
    jumping = log.position + np.where(log.time > 10.0, 5.0, 0.0)[:, None]
    time_with_gap = log.time + np.where(log.time > 10.0, 0.02, 0.0)
    (noise,) = (
        each for each in white_noise(FlightRecord("gap", time_with_gap, position=jumping)) if each.signal == "position"
    )
    np.testing.assert_allclose(noise.in_flight, 1e-3, rtol=0.1)
    # 30 differences are enough: 33 samples have 30 of them, and 32 samples have 29.
    for count, is_estimated in ((33, True), (32, False)):
        (noise,) = white_noise(FlightRecord("short", log.time[:count], position=log.position[:count]))
        assert np.isfinite(noise.in_flight).all() == is_estimated
        assert np.isnan(noise.at_rest).all()


def test_jumps_of_an_angle_from_pi_to_minus_pi_do_not_count_as_noise():
    yaw = 0.7 * 0.01 * np.arange(2000.0)
    wrapped = np.column_stack([0.0 * yaw, 0.0 * yaw, np.arctan2(np.sin(yaw), np.cos(yaw))])
    noise = {each.signal: each for each in white_noise(hovering(attitude=wrapped))}
    np.testing.assert_allclose(noise["attitude"].in_flight, 0.0, atol=1e-12)


@pytest.mark.parametrize(("signal", "limit"), [("velocity", 0.15), ("body_rates", 0.5)], ids=["speed", "turning"])
def test_trim_is_the_mean_over_samples_below_the_limits_of_speed_and_rates(signal, limit):
    """The vehicle leans while it moves. Motion faster than the limit of the speed or of the body rates is not hover."""
    moving = np.arange(2000) >= 1200
    roll = np.where(moving, 0.3, 0.1)
    attitude = np.column_stack([roll, 0.0 * roll, 0.0 * roll])
    # Unit vector, so that `speed` is the magnitude of the velocity or of the body rates.
    direction = np.array([2.0, 1.0, 2.0]) / 3.0
    for speed, expected in ((1.01 * limit, 0.1), (0.99 * limit, 0.1 + 0.4 * 0.2)):
        logged = hovering(**{signal: np.where(moving, speed, 0.0)[:, None] * direction, "attitude": attitude})
        assert hover_means(logged, WEIGHT)["mean roll"].value == pytest.approx(expected)


def test_the_standard_deviation_of_trim_follows_from_half_second_blocks():
    random = np.random.default_rng(4)
    torque = random.normal(size=(2000, 3))
    logged = hovering(torque_command=torque)
    result = hover_means(logged, WEIGHT)
    means = torque.reshape(40, 50, 3).mean(axis=1)
    for i, axis in enumerate("xyz"):
        spread = result[f"mean torque about {axis}"]
        assert spread.value == pytest.approx(torque[:, i].mean())
        assert spread.deviation == pytest.approx(np.std(means[:, i], ddof=1) / np.sqrt(40))
        assert (spread.unit, spread.degrees_of_freedom) == ("N m", 39.0)
    assert (result["mean roll"].unit, result["mean thrust"].unit) == ("rad", "N")
    assert {*result} == {"mean roll", "mean pitch", "mean thrust", *(f"mean torque about {axis}" for axis in "xyz")}
    # If a command is not logged, the result contains no trim for it.
    without_thrust = hovering(thrust_command=None)
    assert {*hover_means(without_thrust, WEIGHT)} == {"mean roll", "mean pitch"}
    # At least one second of hover is required.
    assert hover_means(hovering(1.0), WEIGHT)
    assert not hover_means(hovering(0.99), WEIGHT)
    assert hover_means(hovering(velocity=None), WEIGHT) == {}


@pytest.mark.parametrize("lag", [0, 7, 29])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_delay_is_that_of_the_angle_with_the_best_correlation(lag, axis):
    """Delays of roll or pitch up to 0.3 s are found in the longest piece of the log."""
    random = np.random.default_rng(5)
    command = np.zeros((2000, 3))
    command[:, axis] = np.cumsum(random.normal(size=2000))
    attitude = np.zeros_like(command)
    attitude[lag:, axis] = command[: 2000 - lag, axis]
    time = 0.01 * np.arange(2000) + np.where(np.arange(2000) > 500, 1.0, 0.0)
    # The shorter part of the log, before the gap, has another delay, which is ignored.
    attitude[:500] = np.roll(command[:500], 3, axis=0)
    logged = FlightRecord("log", time, attitude=attitude, attitude_command=command)
    assert delay_by_correlation(logged) == pytest.approx(0.01 * lag)
    without_attitude = FlightRecord("bare", time, attitude_command=command)
    assert delay_by_correlation(without_attitude) is None


def test_a_response_after_0_3_s_is_not_taken_as_a_delay():
    command = np.random.default_rng(6).normal(size=(2000, 3)).cumsum(axis=0)
    attitude = np.zeros_like(command)
    attitude[10:] = 0.5 * command[:-10]
    attitude[30:] += command[:-30]
    logged = FlightRecord("log", 0.01 * np.arange(2000), attitude=attitude, attitude_command=command)
    assert delay_by_correlation(logged) == pytest.approx(0.1)


def test_the_delay_from_a_log_with_one_sample_per_second_is_zero():
    command = np.random.default_rng(6).normal(size=(50, 3)).cumsum(axis=0)
    assert (
        delay_by_correlation(FlightRecord("slow", np.arange(50.0), attitude=command, attitude_command=command)) == 0.0
    )


def test_a_mean_over_a_single_block_has_no_standard_deviation():
    mean = hover._mean(np.array([3.0, 5.0]), np.array([7, 7]), "N")
    assert (mean.value, mean.unit, mean.degrees_of_freedom) == (4.0, "N", 1.0)
    assert np.isnan(mean.deviation)


def test_throttles_in_hover_give_the_thrust_of_a_motor_and_show_a_weak_propeller():
    """A motor with 0.8 times the thrust factor K in T = K u² needs 1 / sqrt(0.8) times the throttle u."""
    level, weak = 0.9, np.array([1.0, 1.0, 0.8, 1.0])
    throttles = np.sqrt(0.25 * WEIGHT / (level * weak))
    actual = hover_means(hovering(motor_command=np.tile(throttles, (2000, 1))), WEIGHT)
    ratio = actual["mean throttle of motor 3"].value / actual["mean throttle of motor 1"].value
    assert ratio == pytest.approx(1.0 / np.sqrt(0.8))
    # All motors have the same thrust K u², so the squared throttle u² is proportional to 1 / K, which is averaged.
    expected = level / np.mean(1.0 / weak)
    assert actual["thrust of a motor over the square of its throttle"].value == pytest.approx(expected)


def test_hover_without_attitude_is_detected_from_velocity():
    assert {*hover_means(hovering(attitude=None, body_rates=None), WEIGHT)} == {"mean thrust"}
