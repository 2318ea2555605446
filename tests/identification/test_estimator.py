"""Tests of the estimated errors of a logged velocity, with synthetic flights whose velocity error is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from drake_quad.errors import InputError
from drake_quad.identification.validation import estimator
from drake_quad.identification.validation.estimator import estimate_velocity_error, linear_drag
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.files.loading import load_undesigned

PERIOD = 0.004  # s, sampling period
SCALE_ERROR = 0.08  # relative to the velocity
DRIFT = 0.03  # m/s, standard deviation of the correlated velocity error
CORRELATION_TIME = 0.5  # s
GRAVITY = 9.81  # m/s²
MASS = 0.0375  # kg


def synthetic_flight(seconds, *, noise=0.0, drift=DRIFT, speed=0.5):
    """Return a flight along x whose logged velocity has a scale error and an Ornstein-Uhlenbeck error."""
    random = np.random.default_rng(3)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    decay = np.exp(-PERIOD / CORRELATION_TIME)
    steps = drift * np.sqrt(1.0 - decay**2) * random.normal(size=(len(time), 3))
    drift_error = lfilter([1.0], [1.0, -decay], steps, axis=0)
    rate = 2.0
    sine, cosine = (np.outer(each, [speed, 0.0, 0.0]) for each in (np.sin(rate * time), np.cos(rate * time)))
    return FlightRecord(
        "made",
        time,
        position=-cosine / rate + noise * random.normal(size=(len(time), 3)),
        velocity=(1.0 + SCALE_ERROR) * sine + drift_error,
        attitude=np.zeros((len(time), 3)),
        thrust_command=np.full(len(time), MASS * GRAVITY),
    )


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_scale_error_drift_and_correlation_time_are_recovered(noise):
    result = estimate_velocity_error(synthetic_flight(240.0, noise=noise))
    assert abs(result.scale_error[0].value - SCALE_ERROR) < 3.0 * result.scale_error[0].deviation
    assert result.scale_error[0].deviation < 0.02
    assert [fraction.value for fraction in result.scale_error[1:]] == [0.0, 0.0]
    # The drift is the standard deviation of the correlated velocity error, averaged over 0.1 s. The log contains 240
    # independent values, which determine the drift to 5 %.
    ratio = 0.1 / CORRELATION_TIME
    expected_drift = DRIFT * np.sqrt(2.0 * (ratio - 1.0 + np.exp(-ratio))) / ratio
    np.testing.assert_allclose(result.drift, expected_drift, rtol=0.15)
    np.testing.assert_allclose(result.correlation_time, CORRELATION_TIME, rtol=0.2)


def test_position_noise_does_not_count_as_drift():
    """Noise of 1 mm adds 14 mm/s to differences over 0.1 s, of which less than 3 mm/s may remain."""
    result = estimate_velocity_error(synthetic_flight(240.0, noise=1e-3, drift=0.0))
    assert result.drift.max() < 3e-3


@pytest.mark.parametrize(
    ("record", "message"), [(synthetic_flight(20.0, speed=0.0), "hovers"), (synthetic_flight(0.4), "is too short")]
)
def test_a_short_log_or_a_log_without_motion_is_refused(record, message):
    base = load_undesigned("diagrams/vehicles/crazyflie.yaml", [f"nominal.mass={MASS}"])
    with pytest.raises(InputError, match=message):
        estimate_velocity_error(record)
    with pytest.raises(InputError, match=message):
        linear_drag(record, base)


def swinging(amplitude, rate, *, true_amplitude=(0.5, 0.4, 0.0), fraction=(0.1, -0.05, 0.2), seconds=40.0, period=0.01):
    """Return the record of a flight in which the logged velocity has a scale error and a sinusoidal error.

    Args:
        amplitude: (3,) amplitude of the sinusoidal error, m/s.
        rate: angular frequency of the sinusoidal error, rad/s.
        true_amplitude: (3,) amplitude of the true velocity, m/s.
        fraction: (3,) scale error, relative to the true velocity.
        seconds: duration, s.
        period: sampling period, s.
    """
    time = 3.0 + period * np.arange(round(seconds / period))
    speed = np.stack(
        [size * np.cos(each * time) for size, each in zip(true_amplitude, (2.0, 3.1, 1.0), strict=True)], axis=1
    )
    position = np.stack(
        [size / each * np.sin(each * time) for size, each in zip(true_amplitude, (2.0, 3.1, 1.0), strict=True)], axis=1
    )
    swing = np.outer(np.sin(rate * time), amplitude)
    return FlightRecord("swings", time, position=position, velocity=(1.0 + np.array(fraction)) * speed + swing)


def test_a_sinusoidal_error_is_estimated_with_its_amplitude_and_correlation_time():
    """Averaging over 0.1 s scales the amplitude by sin(0.05 ω) / (0.05 ω).

    The autocorrelation is 1/e after arccos(1/e) / ω.
    """
    rate = 7.0
    amplitude = np.array([0.03, 0.05, 0.02])
    result = estimate_velocity_error(swinging(amplitude, rate))
    np.testing.assert_allclose([fraction.value for fraction in result.scale_error], [0.1, -0.05, 0.0], atol=2e-3)
    expected_drift = amplitude / np.sqrt(2.0) * np.sin(0.05 * rate) / (0.05 * rate)
    np.testing.assert_allclose(result.drift, expected_drift, rtol=0.02)
    assert result.correlation_time == pytest.approx(np.arccos(1.0 / np.e) / rate, abs=0.011)
    # The vehicle does not move along z. The scale error of z is therefore zero, and its standard deviation is the mean
    # of those of x and y.
    deviations = [fraction.deviation for fraction in result.scale_error[:2]]
    assert result.scale_error[2].deviation == pytest.approx(np.mean(deviations))
    # The scale errors are exact if there is no sinusoidal error.
    exact = estimate_velocity_error(swinging(np.zeros(3), rate))
    np.testing.assert_allclose([fraction.value for fraction in exact.scale_error], [0.1, -0.05, 0.0], atol=2e-3)
    assert exact.drift.max() < 1e-3


def test_the_standard_deviation_of_a_scale_error_follows_from_the_scatter_between_blocks():
    random = np.random.default_rng(8)
    true, error = random.normal(size=(2, 300))
    blocks = np.repeat(np.arange(60), 5)
    fraction = estimator._slope(true[:, None], error, blocks, "1")
    slope = np.linalg.lstsq(true[:, None], error, rcond=None)[0][0]
    assert fraction.value == pytest.approx(slope)
    scores = (true * (error - slope * true)).reshape(60, 5).sum(axis=1)
    assert fraction.deviation == pytest.approx(np.sqrt(60.0 / 59.0 * np.sum(scores**2)) / np.sum(true**2))


def test_the_drift_of_a_swinging_vehicle_does_not_contain_position_noise():
    """Position noise of 1 mm adds 14 mm/s to velocities over 0.1 s."""
    random = np.random.default_rng(9)
    record = swinging(np.array([0.03, 0.03, 0.03]), 7.0)
    noisy = FlightRecord(
        "noisy", record.time, position=record.position + 1e-3 * random.normal(size=(4000, 3)), velocity=record.velocity
    )
    drift, noisy_drift = (estimate_velocity_error(each).drift for each in (record, noisy))
    np.testing.assert_allclose(noisy_drift, drift, rtol=0.06)


def test_the_first_half_second_of_a_log_is_left_out():
    """An estimator may still be settling in the first half second."""
    record = swinging(np.array([0.03, 0.03, 0.03]), 7.0)
    velocity = record.velocity + np.where(record.time < 3.4, 0.5, 0.0)[:, None]
    position = record.position + np.where(record.time < 3.2, 0.1, 0.0)[:, None]
    expected = estimate_velocity_error(record)
    for signals in (
        {"position": record.position, "velocity": velocity},
        {"position": position, "velocity": record.velocity},
    ):
        settled = estimate_velocity_error(FlightRecord("settles", record.time, **signals))
        np.testing.assert_allclose(settled.drift, expected.drift, rtol=1e-6)
        np.testing.assert_allclose(
            [s.value for s in settled.scale_error], [s.value for s in expected.scale_error], rtol=1e-9
        )


def test_a_scale_error_is_the_slope_of_the_velocity_error_over_the_velocity():
    """The expected estimate follows from means over 0.1 s, and its standard deviation from blocks of 0.5 s."""
    log = synthetic_flight(12.0, speed=0.7)
    # The speed is below the minimum of 0.15 m/s RMS along y, and above it along z.
    amplitude = np.sqrt(2.0) * np.array([0.0, 0.13, 0.17])
    position, speed = (np.outer(each, amplitude) for each in (-np.cos(log.time), np.sin(log.time)))
    log = FlightRecord("made", log.time, position=log.position + position, velocity=log.velocity + 0.98 * speed)
    result = estimate_velocity_error(log)
    chosen = log.time[(log.time > 0.5) & (log.time < log.time[-1] - 0.1)]
    # A sample on the boundary of two blocks belongs to the later one.
    blocks = np.floor(chosen / 0.5)
    for axis, fraction in ((0, result.scale_error[0]), (2, result.scale_error[2])):
        integral = np.concatenate(
            [[0.0], np.cumsum(0.5 * (log.velocity[1:, axis] + log.velocity[:-1, axis]) * np.diff(log.time))]
        )
        true, logged = (
            (np.interp(chosen + 0.05, log.time, each) - np.interp(chosen - 0.05, log.time, each)) / 0.1
            for each in (log.position[:, axis], integral)
        )
        slope = np.sum(true * (logged - true)) / np.sum(true**2)
        assert fraction.value == pytest.approx(slope)
        scores = true * (logged - true - slope * true)
        sums = np.array([scores[blocks == block].sum() for block in np.unique(blocks)])
        count = len(sums)
        assert fraction.deviation == pytest.approx(np.sqrt(count / (count - 1) * np.sum(sums**2)) / np.sum(true**2))
        # The drift is the standard deviation of the residuals if there is no position noise.
        assert result.drift[axis] == pytest.approx(np.std(logged - true - slope * true), rel=0.02)
    assert result.scale_error[1].value == 0.0
    assert result.scale_error[1].deviation == pytest.approx(
        0.5 * (result.scale_error[0].deviation + result.scale_error[2].deviation)
    )


def test_the_noise_of_mean_velocities_follows_from_white_position_noise():
    """Interpolation at a fraction s of a step multiplies the variance of white noise by (1 - s)² + s²."""
    random = np.random.default_rng(9)
    time = 0.01 * np.arange(200_000)
    log = FlightRecord("log", time, position=np.zeros((len(time), 3)))
    noise = 2e-3 * random.normal(size=len(time))
    for fraction, factor in ((0.0, 1.0), (0.5, 0.5), (0.25, 0.625)):
        ends = tuple(np.arange(10.0, 20.0, 0.01) + 0.01 * fraction + offset for offset in (0.1, 0.0))
        result = estimator._noise(noise, log, ends)
        assert result == pytest.approx(2.0 * factor * (2e-3 / 0.1) ** 2, rel=0.02)
    # A signal that rises at a constant rate contains no noise.
    assert estimator._noise(3.0 * time, log, ends) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("noise", [0.0, 0.3, 2.0])
def test_the_correlation_time_is_the_lag_at_which_the_noise_free_autocorrelation_falls_to_1_over_e(noise):
    random = np.random.default_rng(10)
    values = lfilter([1.0], [1.0, -0.95], random.normal(size=3000)) + 5.0
    deviations = values - values.mean()
    sums = np.array([deviations[: len(deviations) - lag] @ deviations[lag:] for lag in range(len(deviations))])
    noise_free_variance = sums[0] - noise * len(deviations)
    assert estimator._correlation_time(values, noise) == np.flatnonzero(sums < noise_free_variance / np.e)[0]
    # White noise is correlated for one sample only, and a constant for all samples.
    assert estimator._correlation_time(random.normal(size=500), 0.0) == 1
    assert estimator._correlation_time(np.ones(50), 0.0) == 50


@pytest.mark.parametrize(("yaw", "slowness"), [(0.0, 1.0), (0.5 * np.pi, 1.0), (0.0, 60.0)])
def test_drag_is_estimated_separately_along_body_x_and_body_y(yaw, slowness):
    """The wind is chosen so that its drag equals the force that accelerates a level vehicle.

    Force and air speed are averaged over 0.1 s, or over one sample of a slow log.
    """
    base = load_undesigned("diagrams/vehicles/crazyflie.yaml", [f"nominal.mass={MASS}"])
    time = slowness * PERIOD * np.arange(2500)
    drag = np.array([0.03, 0.05, 1.0])
    rates = np.array([2.0, 3.1, 0.0]) / slowness
    velocity, acceleration = slowness * np.sin(np.outer(time, rates)), slowness * rates * np.cos(np.outer(time, rates))
    attitude = np.tile([0.0, 0.0, yaw], (2500, 1))
    log = FlightRecord("made", time, velocity=velocity, attitude=attitude, wind=velocity + MASS * acceleration / drag)
    result = [each.value for each in linear_drag(log, base)]
    assert result == pytest.approx([0.03, 0.05] if yaw == 0.0 else [0.05, 0.03], rel=2e-3)


def test_drag_is_the_derivative_of_the_force_with_respect_to_the_air_speed():
    """Along y, where the vehicle does not move, the drag is set to the value along x.

    The standard deviation follows from the scatter of half-second blocks of the log.
    """
    base = load_undesigned("diagrams/vehicles/crazyflie.yaml", [f"nominal.mass={MASS}"])
    time = PERIOD * np.arange(2500)
    drag, speed = 0.03, np.sin(2.0 * time)
    # The vehicle is level. The wind is chosen so that air speed v and acceleration a satisfy m a = -drag v.
    velocity = np.column_stack([speed, 0.0 * time, 0.0 * time])
    acceleration = 2.0 * np.cos(2.0 * time)
    wind = velocity + np.column_stack([MASS * acceleration / drag, 0.0 * time, 0.0 * time])
    log = FlightRecord("made", time, velocity=velocity, attitude=np.zeros((2500, 3)), wind=wind)
    along, across = linear_drag(log, base)
    assert along.value == pytest.approx(drag, rel=1e-3)
    assert across == along
    noisy = replace(log, velocity=velocity + 0.002 * np.random.default_rng(1).normal(size=velocity.shape))
    result = linear_drag(noisy, base)[0]
    assert abs(result.value - drag) < 4.0 * result.deviation
    assert result.degrees_of_freedom == pytest.approx(20, abs=2)


def test_drag_is_estimated_from_means_over_a_tenth_of_a_second_without_the_ends_of_the_log():
    """The expected estimate is computed from means over 25 samples, without the first and the last 50 samples."""
    base = load_undesigned("diagrams/vehicles/crazyflie.yaml", [f"nominal.mass={MASS}"])
    random = np.random.default_rng(11)
    time = PERIOD * np.arange(2500)
    velocity = np.sin(np.outer(time, [2.0, 3.1, 0.0])) + 0.05 * random.normal(size=(2500, 3))
    wind = 0.7 * np.cos(np.outer(time, [1.3, 0.9, 1.1]))
    log = FlightRecord("log", time, velocity=velocity, attitude=np.zeros((2500, 3)), wind=wind)
    result = linear_drag(log, base)
    force, speed = MASS * np.gradient(velocity, PERIOD, axis=0), wind - velocity
    for axis, spread in enumerate(result):
        airspeed, mean_force = (
            np.array([each[i - 12 : i + 13, axis].mean() for i in range(50, 2450)]) for each in (speed, force)
        )
        slope, intercept = np.polyfit(airspeed, mean_force, 1)
        assert spread.value == pytest.approx(slope)
        blocks = np.floor(time[50:2450] / 0.5 + 1e-9).astype(int)
        weights = (airspeed - airspeed.mean()) / np.sum((airspeed - airspeed.mean()) ** 2)
        sums = np.bincount(blocks, weights=weights * (mean_force - slope * airspeed - intercept))
        assert spread.deviation == pytest.approx(np.sqrt(20.0 / 19.0 * np.sum(sums**2)), rel=1e-3)


@pytest.mark.parametrize(("period", "steps"), [(0.002, 10), (0.005, 4), (0.01, 2), (0.03, 1), (0.1, 1)])
def test_noise_is_estimated_from_steps_of_at_most_twenty_milliseconds(period, steps):
    assert estimator._noise_steps(FlightRecord("log", period * np.arange(10.0))) == steps


def test_the_standard_deviation_of_a_slope_follows_from_the_scatter_between_blocks():
    """The regression line has an intercept. The number of degrees of freedom is the number of blocks minus one."""
    random = np.random.default_rng(8)
    air, force = random.normal(size=(2, 40)) + np.array([[0.3], [2.0]])
    blocks = np.repeat(np.arange(8), 5)
    result = estimator._slope(np.column_stack([air, np.ones_like(air)]), force, blocks, "N s/m")
    slope, intercept = np.polyfit(air, force, 1)
    assert result.value == pytest.approx(slope)
    # The slope is the sum of the forces, each with the weight (v - mean v) / Σ (v - mean v)² for the air speed v.
    weights = (air - air.mean()) / np.sum((air - air.mean()) ** 2)
    sums = (weights * (force - slope * air - intercept)).reshape(8, 5).sum(axis=1)
    assert result.deviation == pytest.approx(np.sqrt(8.0 / 7.0 * np.sum(sums**2)))
    assert (result.unit, result.degrees_of_freedom) == ("N s/m", 7.0)
