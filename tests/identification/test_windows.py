"""Tests of the selection of airborne windows in a record, and of the reduction of its sampling rate."""

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.identification.windows import (
    LogWindow,
    WindowSizes,
    _near,
    airborne_mask,
    common_period,
    downsample,
    held_out_mask,
    segment_numbers,
    split_into_windows,
    steep_pitch_remarks,
    wrapped_angles,
)
from drake_quad.logs.record import FlightRecord

PERIOD = 0.01  # s, sampling period


def record(seconds: float = 20.0, **signals: np.ndarray) -> FlightRecord:
    """Return the log of a vehicle in hover."""
    count = round(seconds / PERIOD)
    command = np.full((count, 4), 0.5)
    return FlightRecord("hover", PERIOD * np.arange(count), **({"motor_command": command} | signals))


def test_a_second_after_take_off_and_before_landing_is_left_out() -> None:
    """The rotors stand still for the first and last 5 s, so the vehicle counts as airborne from 6 s to 14 s."""
    command = np.full((2000, 4), 0.5)
    command[:500] = command[1500:] = 0.0
    flying = np.flatnonzero(airborne_mask(record(motor_command=command)))
    assert flying[0] == pytest.approx(600, abs=5)
    assert flying[-1] == pytest.approx(1400, abs=5)
    assert np.all(np.diff(flying) == 1)


def test_a_quarter_of_a_second_without_throttle_counts_as_flight() -> None:
    """A manoeuvre in the air may need no thrust for a short time."""
    command = np.full((2000, 4), 0.5)
    command[1000:1025] = 0.0
    assert airborne_mask(record(motor_command=command))[900:1100].all()


def test_a_second_around_a_collision_is_left_out() -> None:
    """A lateral specific force of five times the weight is not flight."""
    force = np.tile([0.0, 0.0, 9.81], (2000, 1))
    force[1000, 0] = 50.0
    flying = airborne_mask(record(specific_force=force))
    assert not flying[900:1101].any()
    assert flying[[899, 1101]].all()


def test_windows_are_adjacent_and_do_not_span_a_gap() -> None:
    """A gap of 0.1 s after sample 500 begins another segment. The settling time must fit into each segment."""
    base = record(10.0)
    time = base.time + np.where(np.arange(1000) > 500, 0.1, 0.0)
    broken = FlightRecord("gap", time, motor_command=base.motor_command)
    assert segment_numbers(broken)[[500, 501]].tolist() == [0, 1]
    result = split_into_windows([broken], [np.ones(1000, dtype=bool)], WindowSizes(length=100, settle=50, warm_up=0))
    assert result == [LogWindow(0, start) for start in (50, 150, 250, 350, 551, 651, 751, 851)]


def test_windows_contain_only_airborne_samples() -> None:
    """Sample 130 is not flight, so no window, and no settling time before a window, contains it."""
    usable = np.ones(1000, dtype=bool)
    usable[130] = False
    result = split_into_windows([record(10.0)], [usable], WindowSizes(length=100, settle=20, warm_up=0))
    assert [start for _, start in result][:2] == [20, 151]


def test_the_last_third_of_the_flight_is_held_out() -> None:
    """The last 200 of 600 samples in the air are held out."""
    flying = np.zeros(1000, dtype=bool)
    flying[100:700] = True
    assert np.flatnonzero(held_out_mask(flying, 1.0 / 3.0)).tolist() == list(range(500, 700))


def test_downsampling_averages_angles_across_the_wrap_at_180_degrees() -> None:
    """The vehicle turns at a constant rate. The mean of angles on both sides of ±180° is not 0°."""
    yaw = 0.7 * PERIOD * np.arange(2000.0)
    angles = np.column_stack([np.zeros(2000), np.zeros(2000), np.arctan2(np.sin(yaw), np.cos(yaw))])
    downsampled = downsample(record(attitude=angles), 4)
    assert downsampled.attitude is not None
    turn = np.exp(1j * (downsampled.attitude[:, 2] - 0.7 * downsampled.time))
    np.testing.assert_allclose(turn, 1.0, atol=1e-9)
    assert np.abs(downsampled.attitude).max() <= np.pi


def test_a_second_around_a_pitch_near_90_degrees_is_left_out_and_reported() -> None:
    """Roll and yaw are noise near a pitch of 90°."""
    angles = np.zeros((2000, 3))
    angles[1000:1020, 1] = np.radians(-80.0)
    steep = record(attitude=angles)
    flying = airborne_mask(steep)
    assert not flying[900:1120].any()
    assert flying[[899, 1120]].all()
    (sentence,) = steep_pitch_remarks([record(), steep])
    assert sentence.startswith("the log 'hover' pitches beyond 75 degrees for 0.2 s, which are left out")


def test_downsampling_averages_commands_after_each_sample_and_measurements_around_it() -> None:
    """The mean of a measured ramp around a sample is its value at the sample.

    A command acts in the step that follows the sample, so its mean is over this step.
    """
    ramp = np.arange(2000.0)
    tilted = record(motor_command=np.tile(ramp[:, None], 4), specific_force=np.tile(ramp[:, None], 3))
    for step in (4, 5):
        downsampled = downsample(tilted, step)
        samples = downsampled.time / PERIOD
        assert downsampled.specific_force is not None
        assert downsampled.motor_command is not None
        np.testing.assert_allclose(downsampled.specific_force[:, 0], samples, atol=1e-9)
        np.testing.assert_allclose(downsampled.motor_command[:, 0], samples + 0.5 * (step - 1), atol=1e-9)
        np.testing.assert_allclose(np.diff(samples), step, atol=1e-9)


@pytest.mark.parametrize(
    ("signal", "columns", "airborne_fraction", "ground_fraction"),
    [
        ("motor_command", 4, 0.55, 0.45),
        ("thrust_command", None, 0.55, 0.45),
        ("thrust_fraction", None, 0.55, 0.45),
        # The thrust of a rotor is proportional to the square of its speed.
        ("rotor_speed_command", 4, 0.75, 0.65),
    ],
)
def test_a_vehicle_counts_as_airborne_above_half_of_its_median_thrust(
    signal: str, columns: int | None, airborne_fraction: float, ground_fraction: float
) -> None:
    """The usual thrust is the median while the rotors work, which they do for a third of this log."""
    for fraction, flies in ((airborne_fraction, True), (ground_fraction, False)):
        command = np.zeros(3000)
        command[1000:2000] = 400.0
        command[1200:1500] *= fraction
        values = command if columns is None else np.tile(command[:, None], columns)
        flying = airborne_mask(FlightRecord("log", PERIOD * np.arange(3000), **{signal: values}))
        assert flying[1300:1400].all() == flies
        assert flying[1300:1400].any() == flies
        assert flying[1700:1800].all()
        assert not flying[:1000].any()
        assert not flying[2000:].any()


def test_motor_commands_have_priority_in_detecting_flight() -> None:
    zeros, hover = np.zeros(2000), np.full(2000, 0.5)
    four = np.tile(hover[:, None], 4)
    assert airborne_mask(record(thrust_command=zeros, rotor_speed_command=0.0 * four)).all()
    assert not airborne_mask(record(motor_command=0.0 * four, thrust_command=hover, rotor_speed_command=four)).any()
    speeds = {"motor_command": None, "rotor_speed_command": four, "thrust_command": zeros}
    assert airborne_mask(record(**speeds)).all()
    thrust = {"motor_command": None, "thrust_command": hover, "thrust_fraction": zeros}
    assert airborne_mask(record(**thrust)).all()
    # The whole log counts as flight if no command is logged.
    assert airborne_mask(FlightRecord("log", PERIOD * np.arange(50), position=np.zeros((50, 3)))).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_specific_force_above_twice_the_weight_in_any_direction_is_a_collision(axis: int, sign: float) -> None:
    for size, flies in ((1.98 * 9.81, True), (2.02 * 9.81, False)):
        force = np.zeros((2000, 3))
        force[1000, axis] = sign * size
        assert airborne_mask(record(specific_force=force))[1000] == flies


def test_a_sample_is_excluded_if_its_pitch_exceeds_75_degrees_but_not_for_its_roll_or_yaw() -> None:
    for column, flies in ((0, True), (1, False), (2, True)):
        angles = np.zeros((2000, 3))
        angles[1000, column] = np.radians(76.0)
        assert airborne_mask(record(attitude=angles))[1000] == flies
    angles = np.tile([0.0, np.radians(74.0), 0.0], (2000, 1))
    assert airborne_mask(record(attitude=angles)).all()


def test_the_periods_of_logs_may_differ_by_at_most_a_tenth() -> None:
    def logs(*periods: float) -> list[FlightRecord]:
        return [FlightRecord(f"{each:g}", each * np.arange(50), position=np.zeros((50, 3))) for each in periods]

    assert common_period(logs(0.01, 0.0109, 0.0091, 0.01)) == pytest.approx(0.01)
    for odd in (0.0112, 0.0088):
        with pytest.raises(
            InputError, match=f"the log '{odd:g}' has {1.0 / odd:.0f} samples per second, but another log has 100; "
        ):
            common_period(logs(0.01, 0.01, odd))


def test_wrapping_changes_an_angle_by_a_multiple_of_a_full_turn() -> None:
    angles = np.linspace(-20.0, 20.0, 999)
    result = wrapped_angles(angles)
    assert np.abs(result).max() <= np.pi
    np.testing.assert_allclose(np.exp(1j * result), np.exp(1j * angles), atol=1e-12)


def test_windows_of_several_logs_are_the_windows_of_each_log() -> None:
    """A window ends before the last sample of a log."""
    sizes = WindowSizes(length=100, settle=50, warm_up=30)
    logs = [record(2.52), record(2.5), record(1.51)]
    result = split_into_windows(logs, [np.ones(len(each.time), dtype=bool) for each in logs], sizes)
    assert result == [LogWindow(0, 50), LogWindow(0, 150), LogWindow(1, 50), LogWindow(2, 50)]


def test_gaps_are_steps_of_more_than_three_periods() -> None:
    for step, number in ((2.9, 0), (3.1, 1)):
        time = PERIOD * np.concatenate([np.arange(10), 9.0 + step + np.arange(10)])
        assert (
            segment_numbers(FlightRecord("log", time, position=np.zeros((20, 3)))).tolist() == [0] * 10 + [number] * 10
        )


def test_downsampling_averages_whole_steps_and_does_nothing_if_the_step_is_one_sample() -> None:
    log = record(1.03)
    assert downsample(log, 1) is log
    for step in (2, 3, 4):
        downsampled = downsample(log, step)
        assert len(downsampled.time) == (103 - step) // step
        assert downsampled.time[0] == log.time[step // 2]
    # All weights are equal if a step has an odd number of samples. The outer two are halved if the number is even.
    force = np.zeros((103, 3))
    force[50] = 1.0
    for step, expected in ((2, [0.25, 0.25]), (3, [1.0 / 3.0]), (4, [0.25]), (5, [0.2])):
        downsampled = downsample(record(1.03, specific_force=force), step)
        assert downsampled.specific_force is not None
        values = downsampled.specific_force[:, 0]
        np.testing.assert_allclose(values[values > 0.0], expected)
        assert values.sum() * step == pytest.approx(1.0)


@pytest.mark.parametrize("indices", [[], [0], [3], [11], [0, 11], [2, 3, 9]])
@pytest.mark.parametrize("samples", [1, 2, 5, 20])
def test_a_mask_is_extended_by_a_number_of_samples(indices: list[int], samples: int) -> None:
    actual = np.isin(np.arange(12), indices)
    expected = [any(abs(i - index) <= samples for index in indices) for i in range(12)]
    np.testing.assert_array_equal(_near(actual, samples), expected)
