"""Tests of missing commands between samples, of drifting clocks, and of estimates that missing commands distort."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad.identification import sampling
from drake_quad.identification.evidence import Uncertainty
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.prediction_errors import PredictionNoise
from drake_quad.identification.sampling import (
    distorted_parameters,
    fast_command_fraction,
    fast_command_remarks,
    logs_without_fast_commands,
    synchronise,
    with_averaging_error,
)
from drake_quad.logs.consistency import ClockShifts, clock_shifts
from drake_quad.logs.record import FlightRecord

PERIOD = 0.01  # s, sampling period
TIME = PERIOD * np.arange(4000)  # s
# Time shift in each part of two seconds, s.
CLOCK_SHIFTS = 0.015 * np.where(np.arange(20) % 4 < 2, 1.0, -1.0)


def rolling(shifts, *, lost=()):
    """Return a log of roll and pitch motion. The delay of the attitude is different in each two-second part of the log.

    Args:
        shifts: (20,) delay of the attitude in each part, s.
        lost: signals that are not logged.
    """
    shift = np.repeat(shifts, len(TIME) // 20)

    def angles(time):
        return np.stack([0.3 * np.sin(7.0 * time), 0.2 * np.sin(5.0 * time + 1.0), 0.1 * np.sin(time)], axis=1)

    step = 1e-4
    before, after = (Rotation.from_euler("ZYX", angles(TIME + side * step)[:, ::-1]) for side in (-0.5, 0.5))
    signals = {
        "position": np.zeros((len(TIME), 3)),
        "attitude": angles(TIME - shift),
        "body_rates": (before.inv() * after).as_rotvec() / step,
        "specific_force": np.tile([0.0, 0.0, 9.81], (len(TIME), 1)),
        "motor_command": np.full((len(TIME), 4), 0.5),
    }
    return FlightRecord("rolling", TIME, **{name: each for name, each in signals.items() if name not in lost})


def exact_shifts(lags):
    return ClockShifts(np.array(lags), np.zeros(len(lags)))


def shifts_of(record):
    return clock_shifts(dict(record.signals()), record.time).lags


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_a_constant_time_shift_is_found_in_all_parts_of_a_log(shift):
    """The shift is positive if the body rates lag the attitude. In this log, the attitude lags the body rates."""
    result = shifts_of(rolling(np.full(20, shift)))
    assert len(result) >= 18
    np.testing.assert_allclose(result, -shift, atol=1e-3)


def test_no_time_shift_is_found_in_short_logs_or_between_unrelated_signals():
    """At least fifty windows of 0.1 s are required. Parts without a common motion are left out."""
    record = rolling(np.zeros(20))
    for count in (10, 40, 58, 220):
        assert len(shifts_of(record.subset(slice(count)))) == 0
    random = np.random.default_rng(1)
    noise = replace(record, body_rates=random.normal(size=(len(TIME), 3)))
    assert len(shifts_of(noise)) == 0
    half = replace(record, body_rates=np.where(TIME[:, None] < 20.0, record.body_rates, noise.body_rates))
    assert 8 <= len(shifts_of(half)) <= 10


def test_only_on_board_sensors_are_used_if_clocks_drift():
    drifting = rolling(CLOCK_SHIFTS)
    np.testing.assert_allclose(np.std(shifts_of(drifting)), np.std(CLOCK_SHIFTS), rtol=0.2)
    (result,), is_estimated, (remark,) = synchronise([drifting])
    assert {*result.names} == {"body_rates", "specific_force", "motor_command"}
    assert result.period == pytest.approx(0.03)
    assert not is_estimated
    assert "not synchronised; position, velocity and attitude are left out" in remark


def test_a_constant_time_shift_is_not_taken_for_a_clock_drift():
    """The body rates lag the attitude by a constant time, as if they were derived from the attitude."""
    record = rolling(np.full(20, -0.03))
    assert synchronise([record]) == ([record], False, [])


def test_an_attitude_that_lags_the_gyroscope_counts_as_estimated():
    record = rolling(np.full(20, 0.007))
    (result,), is_estimated, (remark,) = synchronise([record])
    assert result is record
    assert is_estimated
    assert remark.startswith("the attitude lags the body rates by 7 ms")
    # An attitude that lags is still used if no other signals are logged.
    without_position = rolling(np.full(20, 0.007), lost=("position", "specific_force"))
    assert synchronise([without_position]) == ([without_position], False, [])


def test_a_clock_drift_causes_only_a_remark_in_logs_without_an_accelerometer():
    record = rolling(CLOCK_SHIFTS, lost=("specific_force",))
    results, is_estimated, (remark,) = synchronise([record])
    assert results == [record]
    assert not is_estimated
    assert remark.endswith("their clocks are not synchronised")


@pytest.mark.parametrize(
    ("shifts", "drifts"),
    [
        # A clock drift is found in at least four parts of a log, if their shifts have a standard deviation of at least
        # 8 ms.
        ([[0.01, -0.01, 0.01]], False),
        ([[0.01, -0.01, 0.01, -0.01]], True),
        ([[0.0078, -0.0078] * 4], False),
        ([[0.0082, -0.0082] * 4], True),
        # The mean time shift of each log is subtracted. The scatter is then computed from the parts of all logs.
        ([[0.05, 0.05], [-0.05, -0.05]], False),
        ([[0.05, 0.03], [0.01, -0.01]], True),
        ([[], [0.01, -0.01, 0.01, -0.01]], True),
        ([[], []], False),
    ],
)
def test_a_clock_drift_is_recognised_by_the_scatter_of_shifts_within_logs(monkeypatch, shifts, drifts):
    records = [replace(rolling(np.zeros(20)), name=f"{i}") for i in range(len(shifts))]
    parts = iter(shifts)
    monkeypatch.setattr(sampling, "clock_shifts", lambda signals, time: exact_shifts(next(parts)))
    results, is_estimated, remarks = synchronise(records)
    assert not is_estimated
    if drifts:
        assert [record.attitude for record in results] == [None] * len(records)
        deviations = np.concatenate([np.array(each) - np.mean(each) for each in shifts if each])
        assert f"by {1e3 * np.std(deviations):.0f} ms (standard deviation over parts of two seconds)" in remarks[0]
        assert "the rest is averaged over 30 ms" in remarks[0]
    else:
        assert (results, remarks) == (records, [])


def test_clocks_are_compared_where_both_sensors_are_logged(monkeypatch):
    """If the clocks differ, logs are averaged to a period of 0.03 s.

    A log with a longer period keeps its period. If one log has no gyroscope, all records are unchanged.
    """
    compared = []

    def shifts_of_part(signals, time):
        compared.append(len(time))
        return exact_shifts([0.02, -0.02] * 3)

    monkeypatch.setattr(sampling, "clock_shifts", shifts_of_part)
    fast = rolling(np.zeros(20))
    slow = FlightRecord("slow", 4.0 * TIME, **dict(fast.signals()))
    results, _, _ = synchronise([fast, slow])
    assert [record.period for record in results] == pytest.approx([0.03, 0.04])
    for lost in ("attitude", "body_rates"):
        one, _, (remark,) = synchronise([fast, rolling(np.zeros(20), lost=(lost,)).subset(slice(1000))])
        assert remark.endswith("not synchronised") == (lost == "body_rates")
        assert (one[0] is fast) == (lost == "body_rates")
    assert compared == [4000] * 4


def noise_with(disturbance) -> PredictionNoise:
    return PredictionNoise(np.full(6, 1e-3), np.array(disturbance), np.full(6, 0.1))


def test_a_log_of_fewer_than_256_samples_in_flight_has_no_spectrum():
    random = np.random.default_rng(3)
    log = rolling(np.zeros(20))
    white = replace(log, motor_command=0.5 + 0.1 * random.normal(size=(len(TIME), 4)))
    assert fast_command_fraction(white.subset(slice(255))) == 0.0
    assert fast_command_fraction(white.subset(slice(256))) > 0.3
    # Constant commands contain no fast components. Rotor speed commands are treated like throttles.
    assert fast_command_fraction(log) == 0.0
    speeds = replace(white, motor_command=None, rotor_speed_command=400.0 * white.motor_command)
    assert fast_command_fraction(speeds) == pytest.approx(fast_command_fraction(white))
    # Commands on the ground are ignored, and a slow drift of the commands is removed.
    landed = np.where((TIME > 20.0)[:, None], 0.0, white.motor_command)
    assert fast_command_fraction(replace(white, motor_command=landed)) == pytest.approx(0.5, abs=0.05)
    drifting = white.motor_command + np.outer(TIME, [0.1, -0.1, 0.05, -0.05])
    assert fast_command_fraction(replace(white, motor_command=drifting)) == pytest.approx(0.5, abs=0.05)


def test_the_fraction_of_fast_commands_is_large_for_white_and_small_for_smooth_commands():
    random = np.random.default_rng(2)
    log = rolling(np.zeros(20))
    white = replace(log, motor_command=0.5 + 0.1 * random.normal(size=(len(TIME), 4)))
    smooth = replace(log, motor_command=0.5 + 0.1 * np.sin(np.outer(TIME, [3.0, 4.0, 5.0, 6.0])))
    assert fast_command_fraction(white) == pytest.approx(0.5, abs=0.03)
    assert fast_command_fraction(smooth) < 0.01
    # Equal commands of all rotors produce no torque.
    common = replace(smooth, motor_command=smooth.motor_command + 0.1 * random.normal(size=(len(TIME), 1)))
    assert fast_command_fraction(common) < 0.01
    assert fast_command_fraction(replace(log, motor_command=None)) == 0.0
    torque = noise_with(disturbance=[1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 0.2])
    parameters = [
        Parameter(name, 1.0, 1.0)
        for name in ("thrust_factor", "inertia[0]", "rotor_time_constant", "rotor_time_constant_down", "delay")
    ]
    distorted = distorted_parameters([smooth, white], parameters, torque)
    assert [*distorted] == ["inertia[0]", "rotor_time_constant", "rotor_time_constant_down"]
    assert "(rolling)" in distorted["inertia[0]"]
    assert distorted_parameters([smooth, common], parameters, torque) == {}
    # Missing commands cause a disturbing torque. A disturbing force alone does not indicate missing commands.
    assert (
        distorted_parameters([smooth, white], parameters, noise_with(disturbance=[0.2, 0.2, 0.2, 1e-3, 1e-3, 1e-3]))
        == {}
    )
    (remark,) = fast_command_remarks([smooth, white])
    assert remark.startswith(("rolling: 50% of the power", "rolling: 49% of the power"))


def test_the_variance_of_the_rotor_time_constant_includes_the_error_of_averaged_commands():
    """The expected error is the error of the lag if a ramp command is averaged over periods and held.

    The error increases the variances of the rotor time constants. All correlations and all other variances are
    unchanged.
    """
    lag, period = 0.05, 0.02
    decay, response = np.exp(-period / lag), 0.0
    for sample in range(400):
        response = decay * response + (1.0 - decay) * (sample + 0.5) * period
    error = 400 * period - response - lag
    initial_covariance = np.array([[4e-6, 1e-6, 0.0], [1e-6, 9e-6, 0.0], [0.0, 0.0, 1e-6]])
    names, values = (
        ["thrust_factor", "rotor_time_constant", "rotor_time_constant_down"],
        np.array([1.0, lag, 2.0 * lag]),
    )
    uncertainty = Uncertainty(initial_covariance, np.full(3, np.inf), initial_covariance)
    covariance = with_averaging_error(uncertainty, names, values, period).covariance
    np.testing.assert_allclose(np.diag(covariance), [4e-6, 9e-6 + error**2, 1e-6 + 0.25 * error**2], rtol=1e-2)
    assert covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]) == pytest.approx(1.0 / 6.0)
    np.testing.assert_array_equal(with_averaging_error(uncertainty, names, values, 0.0).covariance, initial_covariance)


def test_scatter_that_noise_explains_is_no_difference_of_clocks(monkeypatch):
    lags = np.array([0.011, -0.011] * 3)
    for deviation, drifts in ((0.01, False), (0.005, True)):
        shifts = ClockShifts(lags, np.full(6, deviation))
        monkeypatch.setattr(sampling, "clock_shifts", lambda signals, time, found=shifts: found)
        assert bool(synchronise([rolling(np.zeros(20))]).remarks) == drifts


def test_the_error_of_a_lag_is_that_of_repeated_measurements():
    clean, random = rolling(np.zeros(20)), np.random.default_rng(2)
    size = np.sqrt(np.mean(clean.body_rates**2))
    found = [
        clock_shifts({**dict(clean.signals()), "body_rates": clean.body_rates + size * noise}, TIME)
        for noise in random.normal(size=(8, *clean.body_rates.shape))
    ]
    lags, deviations = (np.array([getattr(each, name) for each in found]) for name in ("lags", "deviations"))
    assert np.sqrt(np.mean(deviations**2)) == pytest.approx(np.std(lags, axis=0).mean(), rel=0.3)


def test_a_log_that_is_slower_than_the_loop_on_board_lacks_commands():
    noise = noise_with([0.2] * 6)
    record = FlightRecord("slow", TIME, rotor_speed_command=np.tile(100.0 + TIME[:, None], (1, 4)))
    for loop_period, names in ((None, []), (0.7 * record.period, ["slow"]), (record.period, [])):
        assert logs_without_fast_commands([record], noise, loop_period) == names
    assert logs_without_fast_commands([record], noise_with([1e-4] * 6), 0.5 * record.period) == []
