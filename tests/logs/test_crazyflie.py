"""Tests of Crazyflie logs: conversion to SI units and the frames of this library, and consistency of real flights."""

import lzma
import math

import numpy as np
import pytest
from written_logs import DATA, crazyflie_log, quaternion_of

from drake_quad import InputError
from drake_quad.logs.reading import read_log

SHIPPED_LOGS = sorted((DATA / "crazyflie").glob("*/*.xz"))
ACC, GYRO, MOTORS = (
    [(f"{group}.{name}", letter) for name in names]
    for group, letter, names in (("acc", "f", "xyz"), ("gyro", "f", "xyz"), ("motor", "I", ("m1", "m2", "m3", "m4")))
)


@pytest.fixture
def written(tmp_path):
    def write(data, name="log"):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write


def has_remark(record, words):
    return any(words in remark for remark in record.remarks)


def test_inertial_sensors_and_motors_are_converted_to_si_units(written):
    values = (0.5, -0.25, 1.0, 90.0, -45.0, 180.0, 0, 65535, 13107, 32768)
    data = crazyflie_log(
        [(0xFFFF, "fixedFrequency", ACC + GYRO + MOTORS)], [(0xFFFF, 5_000_000 + 1000 * i, values) for i in range(4)]
    )
    record = read_log(written(data))
    np.testing.assert_allclose(record.time, [0.0, 0.001, 0.002, 0.003], atol=1e-9)
    np.testing.assert_allclose(record.specific_force[2], [4.905, -2.4525, 9.81])
    np.testing.assert_allclose(record.body_rates[3], np.radians([90.0, -45.0, 180.0]))
    np.testing.assert_allclose(record.motor_command[0], [0.0, 1.0, 0.2, 32768 / 65535])
    assert record.names == ("body_rates", "specific_force", "motor_command")


def test_times_in_version_1_of_the_format_are_milliseconds(written):
    data = crazyflie_log([(0, "imu", ACC)], [(0, 100 + 10 * i, (0.0, 0.0, 1.0)) for i in range(5)], version=1)
    np.testing.assert_allclose(read_log(written(data)).time, [0.0, 0.01, 0.02, 0.03, 0.04], atol=1e-12)


@pytest.mark.parametrize(("name", "begin"), [("imu", "imu: 1 sample"), ("fixedFrequency", "1 sample")])
def test_a_remark_on_a_repeated_time_names_the_event_unless_all_events_share_a_clock(written, name, begin):
    times = [0, 10_000, 10_000, 20_000, 30_000]
    data = crazyflie_log([(0, name, ACC)], [(0, time, (0.0, 0.0, 1.0)) for time in times])
    assert any(remark.startswith(f"{begin} left out") for remark in read_log(written(data)).remarks)


def test_a_logged_pitch_angle_changes_its_sign_and_a_logged_quaternion_does_not(written):
    roll, pitch, yaw = 0.3, -0.2, 1.1
    old = [(f"stateEstimate.{name}", "f") for name in ("roll", "pitch", "yaw")]
    new = [(f"stateEstimate.q{name}", "d") for name in "wxyz"]
    angles = (math.degrees(roll), -math.degrees(pitch), math.degrees(yaw))
    for variables, values in ((old, angles), (new, quaternion_of(roll, pitch, yaw))):
        data = crazyflie_log([(7, "fixedFrequency", variables)], [(7, i * 10_000, values) for i in range(3)])
        np.testing.assert_allclose(read_log(written(data)).attitude, [[roll, pitch, yaw]] * 3, atol=1e-6)


def packed(quaternion):
    """Return a quaternion (w, x, y, z) as the firmware packs it: two bits, then three times a sign and nine bits."""
    parts = [quaternion[1], quaternion[2], quaternion[3], quaternion[0]]
    largest = max(range(4), key=lambda i: abs(parts[i]))
    result = largest
    for i in range(4):
        if i != largest:
            negative = (parts[i] < 0.0) != (parts[largest] < 0.0)
            result = result << 10 | negative << 9 | int(511 * abs(parts[i]) * math.sqrt(2.0) + 0.5)
    return result


def test_a_packed_attitude_is_unpacked(written):
    angles = np.array([[0.3, -0.2, 1.1], [-0.4, 0.5, 3.0], [1.0, 0.1, -2.9], [0.05, -1.2, 0.4], [3.0, 0.3, 0.2]])
    variables = [("stateEstimateZ.quat", "I"), ("stateEstimateZ.ratePitch", "h")]
    records = [(1, i * 4000, (packed(quaternion_of(*each)), 100)) for i, each in enumerate(angles)]
    record = read_log(written(crazyflie_log([(1, "fixedFrequency", variables)], records)))
    np.testing.assert_allclose(record.attitude, angles, atol=8e-3)
    assert has_remark(record, "body_rates is left out: stateEstimateZ.rateRoll, stateEstimateZ.rateYaw are not logged")


def test_the_largest_component_of_a_packed_attitude_is_exact(written):
    """The largest encoded component, 1/√2, sets all nine bits."""
    angles = np.array([[0.5 * np.pi, 0.0, 0.0], [-0.5 * np.pi, 0.0, 0.0], [0.0, 0.0, 0.5 * np.pi], [0.0, 0.0, 0.0]])
    records = [(1, i * 4000, (packed(quaternion_of(*each)),)) for i, each in enumerate(angles)]
    record = read_log(written(crazyflie_log([(1, "fixedFrequency", [("stateEstimateZ.quat", "I")])], records)))
    np.testing.assert_allclose(record.attitude, angles, atol=1e-7)


def test_interleaved_events_are_resampled_at_the_times_of_the_fastest_event(written):
    """The measurements are linear in time, so linear interpolation is exact. Commands are held."""
    event_types = [(3, "fast", GYRO), (9, "slow", [(f"stateEstimate.{a}", "d") for a in "xyz"]), (4, "never", ACC)]
    event_types += [(5, "commands", MOTORS)]
    records = [(3, 1000 * i, (i, 0.0, 0.0)) for i in range(101)]
    records += [(9, 7000 * i + 500, (7e-3 * i + 5e-4, 1.0, 2.0)) for i in range(-1, 16) if i >= 0]
    records += [(5, 20_000 * i, (6553 * i, 0, 0, 0)) for i in range(6)]
    record = read_log(written(crazyflie_log(event_types, sorted(records, key=lambda each: each[1]))))
    start = 1e-3  # s, first sample with a known position
    np.testing.assert_allclose(record.time, 1e-3 * np.arange(100), atol=1e-9)
    np.testing.assert_allclose(record.position[:, 0], record.time + start, atol=1e-9)
    np.testing.assert_allclose(np.degrees(record.body_rates[:, 0]), 1e3 * (record.time + start), atol=1e-6)
    np.testing.assert_allclose(record.motor_command[:, 0], np.floor((record.time + start + 1e-9) / 0.02) * 6553 / 65535)
    origins = {each.signal: each for each in record.origins}
    assert (origins["position"].resampling, origins["motor_command"].resampling) == ("interpolated", "held")
    assert origins["position"].rate == pytest.approx(1.0 / 7e-3)
    assert origins["motor_command"].rate == pytest.approx(50.0)


def test_logged_columns_that_no_signal_reads_are_reported(written):
    variables = [*ACC, ("foo.bar", "f"), ("baro.asl", "f"), ("baro.temp", "f")]
    data = crazyflie_log([(0, "fixedFrequency", variables)], [(0, 1000 * i, (0.0,) * 6) for i in range(3)])
    assert has_remark(read_log(written(data)), "not read: baro, foo.bar")


def test_a_user_defined_mapping_is_applied(written, tmp_path):
    data = crazyflie_log([(0, "e", [("my.v", "h"), ("my.w", "h")])], [(0, 1000 * i, (-i, 4000)) for i in range(3)])
    mapping = tmp_path / "mine.yaml"
    mapping.write_text("signals: {velocity: {columns: [my.v, 0.5, my.w], unit: mm/s, frame: NED}}")
    record = read_log(written(data), mapping)
    np.testing.assert_allclose(record.velocity, [[0.0, -0.5e-3, -4.0], [-1e-3, -0.5e-3, -4.0], [-2e-3, -0.5e-3, -4.0]])


VALID_LOG = crazyflie_log([(0, "imu", GYRO)], [(0, 1000 * i, (i, 2.0, 3.0)) for i in range(50)])  # log of 50 records
HEADER_SIZE = len(VALID_LOG) - 4 - 50 * 22  # bytes, without the checksum (4) and the records (22 each)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (VALID_LOG[:1] + b"\3\0" + VALID_LOG[3:], "version 3; versions 1 and 2 can be read"),
        (VALID_LOG[:3], "is truncated: the header"),
        (VALID_LOG[: HEADER_SIZE - 4], "is truncated: the header"),
        (VALID_LOG[:HEADER_SIZE], "contains no complete record of imu"),
        (VALID_LOG[: HEADER_SIZE + 21], "contains no complete record of imu"),
        (VALID_LOG[:HEADER_SIZE] + b"\7\0" + VALID_LOG[HEADER_SIZE + 2 :], "no event type has the id 7"),
        (VALID_LOG.replace(b"(f)", b"(z)"), r"gyro.x' in its header has the unknown type 'z'"),
        (VALID_LOG.replace(b"gyro.x(f)", b"gyro.x[f)"), "unknown type"),
        (crazyflie_log([], []), "without event types"),
        (crazyflie_log([(1, "a", GYRO), (1, "b", ACC)], []), "two event types in its header have the id 1"),
        (b"\xbc\2\0\1\0\0\0name" + b"x" * 500, "a name in its header has no end"),
        (b"\xbc\2\0\1\0\0\0\xff\xfe\0\0\0", "is not a name"),
        (b"\xbc\2\0\1\0\0\0a\0\xff\xff" + b"a.b(f)\0" * 65535, "over 5,000 variables"),
        (crazyflie_log([(0, "e", [("foo.bar", "f")])], [(0, i, (1.0,)) for i in range(5)]), "has no signal"),
        (crazyflie_log([(0, "imu", GYRO)], [(0, 1, (1.0,) * 3)]), "has no signal with two samples"),
    ],
)
def test_an_invalid_log_is_refused_with_one_sentence(written, data, message):
    with pytest.raises(InputError, match=message) as caught:
        read_log(written(data))
    assert str(caught.value).count("\n") == 0


def test_the_complete_records_of_a_truncated_log_are_read_and_the_loss_is_reported(written):
    record = read_log(written(VALID_LOG[: HEADER_SIZE + 10 * 22 + 13]))
    np.testing.assert_allclose(np.degrees(record.body_rates[:, 0]), np.arange(10.0), atol=1e-9)
    assert has_remark(record, "the checksum is wrong")
    assert has_remark(record, "the last 13 bytes are not read: no complete record")
    assert not has_remark(read_log(written(VALID_LOG)), "checksum")


def test_reading_stops_at_a_record_of_an_unknown_event(written):
    position = HEADER_SIZE + 30 * 22
    record = read_log(written(VALID_LOG[:position] + b"\5\0" + VALID_LOG[position + 2 :]))
    assert len(record.time) == 30
    assert has_remark(record, "the last 444 bytes are not read: no event type has the id 5")


@pytest.mark.parametrize("path", SHIPPED_LOGS, ids=lambda path: path.stem)
def test_shipped_logs_are_read_completely(path):
    record = read_log(path)
    assert not has_remark(record, "checksum")
    assert not has_remark(record, "left out: the")
    assert not has_remark(record, "complete record")
    size = len(lzma.decompress(path.read_bytes()))
    assert len(record.time) * {"arpl": 50, "crazypad": 82, "crazyswarm2": 98}[path.parent.name] < size


def smooth(values, width=15):
    kernel = np.ones(width) / width
    return np.column_stack([np.convolve(column, kernel, "valid") for column in values.T])


@pytest.mark.parametrize("name", ["log08", "log100", "log145", "log180"])
def test_signs_of_a_real_flight_agree_with_each_other(name):
    """A vehicle accelerates in the direction of its tilt, and its angles change with its body rates."""
    record = read_log(DATA / f"crazyflie/crazyswarm2/{name}.xz")
    after = record.subset(record.time > 1.5)  # after the gap
    acceleration = smooth(np.gradient(after.velocity, after.time, axis=0))
    expected_acceleration = 9.81 * smooth(np.column_stack([after.attitude[:, 1], -after.attitude[:, 0]]))
    turning = smooth(np.gradient(after.attitude, after.time, axis=0))
    moving = smooth(np.gradient(after.position, after.time, axis=0))
    for derived, logged in (
        *zip(acceleration[:, :2].T, expected_acceleration.T, strict=True),
        *zip(turning[:, :2].T, smooth(after.body_rates)[:, :2].T, strict=True),
        *zip(moving[:, :2].T, smooth(after.velocity)[:, :2].T, strict=True),
    ):
        if np.std(logged) > 0.15:  # most flights hardly move along the other axis
            slope = float(derived @ logged / (logged @ logged))
            assert slope == pytest.approx(1.0, abs=0.15)
    np.testing.assert_allclose(after.reference_position, after.position, atol=0.25)


def test_the_specific_force_of_a_crazyflie_at_rest_is_its_weight():
    record = read_log(DATA / "crazyflie/arpl/log16.xz")
    at_rest = record.time < 10.0
    assert np.linalg.norm(record.specific_force[at_rest].mean(axis=0)) == pytest.approx(9.81, abs=0.01)
    assert abs(record.body_rates[at_rest].mean(axis=0)).max() < 0.01
    assert record.motor_command[at_rest].max() == 0.0


def test_motor_torques_have_the_signs_of_the_x_layout():
    """Rotors 1 and 2 (right) roll to the left, 2 and 3 (rear) pitch the nose down, and 2 and 4 yaw to the left."""
    record = read_log(DATA / "crazyflie/arpl/log15.xz")
    lag = 40
    m = record.motor_command.T
    torques = np.column_stack([m[2] + m[3] - m[0] - m[1], m[1] + m[2] - m[0] - m[3], m[1] + m[3] - m[0] - m[2]])
    turning = smooth(np.gradient(record.body_rates, record.time, axis=0), 31)
    driven = smooth(torques, 31)
    for axis, min_correlation in ((0, 0.7), (1, 0.7), (2, 0.05)):
        assert np.corrcoef(turning[lag:, axis], driven[:-lag, axis])[0, 1] > min_correlation
