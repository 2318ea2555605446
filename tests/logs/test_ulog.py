"""Tests that PX4's ULog is converted from NED and FRD to the frames of this library, and to one clock."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import pyulog
from written_logs import DATA, message, quaternion_of, ulog

from drake_quad import InputError
from drake_quad.identification.windows import segment_numbers
from drake_quad.logs.formats.ulog import _dropouts, _intact_start_of
from drake_quad.logs.reading import read_log
from drake_quad.logs.source import LogFile

LOCAL_POSITION_FIELDS = [("float", name) for name in ("x", "y", "z", "vx", "vy", "vz")]
ATTITUDE, XYZ = [("float[4]", "q")], [("uint64_t", "timestamp_sample"), ("float[3]", "xyz")]
MICROSECONDS_PER_SECOND = 1_000_000


@pytest.fixture
def read(tmp_path):
    def read_one(data, *mapping):
        path = tmp_path / "log.ulg"
        path.write_bytes(data)
        return read_log(path, *mapping)

    return read_one


def has_remark(record, words):
    return any(words in remark for remark in record.remarks)


def rows(period, values, *, start=MICROSECONDS_PER_SECOND, duration=MICROSECONDS_PER_SECOND, sampled=None):
    """Return rows at a period (µs). Their values are a function of the time (s)."""
    times = range(start, start + duration + 1, period)
    return [
        (t, *(() if sampled is None else (t - sampled,)), *values((t - MICROSECONDS_PER_SECOND) * 1e-6)) for t in times
    ]


def test_frames_and_rotor_order_of_a_ulog_are_converted(read):
    """North becomes X, east becomes -Y, and down becomes -Z. Roll is unchanged, and pitch and yaw change sign."""
    attitude = quaternion_of(0.1, -0.2, 0.3)
    data = ulog(
        {
            "vehicle_local_position": (LOCAL_POSITION_FIELDS, rows(4000, lambda t: (1.0, 2.0, -3.0, 0.1, 0.2, -0.3))),
            "vehicle_attitude": (ATTITUDE, rows(4000, lambda t: attitude)),
            "vehicle_angular_velocity": (XYZ, rows(4000, lambda t: (0.5, 0.25, -0.125), sampled=0)),
            "vehicle_acceleration": (XYZ, rows(4000, lambda t: (0.5, 0.25, -9.81), sampled=0)),
            "actuator_motors": ([("float[12]", "control")], rows(4000, lambda t: (0.1, 0.2, 0.3, 0.4, *[np.nan] * 8))),
            "vehicle_attitude_setpoint": ([("float[4]", "q_d")], rows(4000, lambda t: attitude)),
            "vehicle_rates_setpoint": (
                [("float", name) for name in ("roll", "pitch", "yaw")],
                rows(4000, lambda t: (1.0, 2.0, 3.0)),
            ),
            "vehicle_thrust_setpoint": ([("float[3]", "xyz")], rows(4000, lambda t: (0.0, 0.0, -0.6))),
            "trajectory_setpoint": (
                [("float[3]", "position"), ("float[3]", "velocity"), ("float[3]", "acceleration"), ("float", "yaw")],
                rows(4000, lambda t: (4.0, 5.0, -6.0, 0.4, 0.5, -0.6, *[np.nan] * 3, 0.7)),
            ),
            "wind": ([("float", "windspeed_north"), ("float", "windspeed_east")], rows(4000, lambda t: (3.0, 4.0))),
            "battery_status": ([("float", "voltage_v")], rows(4000, lambda t: (15.5,))),
        }
    )
    record = read(data)
    last = {name: values[-1] for name, values in record.signals()}
    np.testing.assert_allclose(last["position"], [1.0, -2.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(last["velocity"], [0.1, -0.2, 0.3], atol=1e-6)
    np.testing.assert_allclose(last["attitude"], [0.1, 0.2, -0.3], atol=1e-6)
    np.testing.assert_allclose(last["body_rates"], [0.5, -0.25, 0.125])
    np.testing.assert_allclose(last["specific_force"], [0.5, -0.25, 9.81], atol=1e-6)
    # PX4's rotors are 1 front right, 2 back left, 3 front left, 4 back right.
    np.testing.assert_allclose(last["motor_command"], [0.1, 0.4, 0.2, 0.3], atol=1e-6)
    np.testing.assert_allclose(last["attitude_command"], [0.1, 0.2, -0.3], atol=1e-6)
    np.testing.assert_allclose(last["body_rate_command"], [1.0, -2.0, -3.0])
    np.testing.assert_allclose(last["thrust_fraction"], 0.6, atol=1e-6)
    np.testing.assert_allclose(last["reference_position"], [4.0, -5.0, 6.0])
    np.testing.assert_allclose(last["reference_velocity"], [0.4, -0.5, 0.6], atol=1e-6)
    np.testing.assert_allclose(last["reference_yaw"], -0.7, atol=1e-6)
    np.testing.assert_allclose(last["wind"], [3.0, -4.0, 0.0])
    np.testing.assert_allclose(last["battery_voltage"], 15.5)
    assert "reference_acceleration" not in last  # only NaN
    np.testing.assert_allclose(record.time, 0.004 * np.arange(251), atol=1e-9)


def test_measurements_are_interpolated_and_commands_held_on_the_fastest_clock(read):
    """The time of a measurement is that of its sampling, 2 ms before it is written.

    The time of a command is that of writing.
    """
    data = ulog(
        {
            "vehicle_local_position": (
                LOCAL_POSITION_FIELDS,
                rows(100_000, lambda t: (t, 2.0 * t, 0.0, 1.0, 2.0, 0.0)),
            ),
            "vehicle_angular_velocity": (XYZ, rows(4000, lambda t: (t - 2e-3, 0.0, 0.0), sampled=2000)),
            "actuator_motors": ([("float[4]", "control")], rows(50_000, lambda t: (t / 2.0, 0.0, 0.0, 0.0))),
        },
        start=1_700_000_000_000_000,
    )
    record = read(data)
    start = record.body_rates[0, 0]  # the signal is the time, s
    assert start == pytest.approx(2e-3, abs=1e-6)  # the first sample after the first position
    assert record.period == pytest.approx(0.004)
    np.testing.assert_allclose(record.body_rates[:, 0], record.time + start, atol=1e-6)
    np.testing.assert_allclose(record.position[:, 0], record.time + start, atol=1e-6)
    np.testing.assert_allclose(record.position[:, 1], -2.0 * (record.time + start), atol=1e-6)
    np.testing.assert_allclose(
        record.motor_command[:, 0], np.floor((record.time + start + 1e-9) / 0.05) * 0.025, atol=1e-6
    )
    origins = {each.signal: each for each in record.origins}
    resampled = {name: (each.resampling, round(each.rate)) for name, each in origins.items() if each.resampling}
    assert resampled == {
        "position": ("interpolated", 10),
        "velocity": ("interpolated", 10),
        "motor_command": ("held", 20),
    }


def test_a_dropout_is_a_gap(read):
    lost = {1_400_000 + 4000 * i for i in range(51)}
    samples = [row for row in rows(4000, lambda t: (t, 0.0, 0.0), sampled=0) if row[0] not in lost]
    record = read(ulog({"vehicle_angular_velocity": (XYZ, samples)}, dropouts=[(1_604_000, 204)]))
    assert has_remark(record, "1 dropout of the logger, 0.204 s in total; the longest lasts 0.204 s")
    assert has_remark(record, "1 gap (steps of more than 3 times the median of 0.004 s), 0.208 s in total")
    before, after = (record.subset(segment_numbers(record) == number) for number in range(2))
    assert before.time[-1] == pytest.approx(0.396)
    assert after.time[0] == pytest.approx(0.604)
    np.testing.assert_allclose(after.body_rates[:, 0], after.time, atol=1e-6)


def test_the_command_of_a_stopped_motor_is_zero(read):
    commands = rows(10_000, lambda t: (np.nan,) * 4 if t < 0.5 else (0.5, 0.6, 0.7, 0.8))
    record = read(ulog({"actuator_motors": ([("float[4]", "control")], commands)}))
    assert record.motor_command[0].tolist() == [0.0] * 4
    np.testing.assert_allclose(record.motor_command[-1], [0.5, 0.8, 0.6, 0.7], atol=1e-6)


def test_a_signal_that_is_logged_only_briefly_is_left_out(read):
    data = ulog(
        {
            "vehicle_angular_velocity": (XYZ, rows(4000, lambda t: (t, 0.0, 0.0), sampled=0)),
            "vehicle_attitude": (
                ATTITUDE,
                rows(4000, lambda t: (1.0, 0.0, 0.0, 0.0), start=1_900_000, duration=90_000),
            ),
        }
    )
    record = read(data)
    assert record.names == ("body_rates",)
    assert has_remark(record, "attitude is left out: it is logged for 9% of the time")


def test_force_velocity_and_position_of_a_real_hover_log_are_consistent():
    record = read_log(DATA / "px4/sample_px4_events.ulg.xz")
    flying = record.position[:, 2] > 1.0
    assert flying.sum() > 200
    velocity_change = np.trapezoid(record.specific_force[flying, 2] - 9.81, record.time[flying])
    climb_rate = record.velocity[flying, 2]
    assert velocity_change == pytest.approx(climb_rate[-1] - climb_rate[0], abs=0.2)
    assert abs(record.attitude[flying, :2]).max() < 0.02
    assert 0.4 < record.motor_command[flying].mean() < 0.6
    position_derivative = np.gradient(record.position[:, 2], record.time)
    assert np.corrcoef(position_derivative, record.velocity[:, 2])[0, 1] > 0.9
    assert record.reference_position[flying, 2].mean() == pytest.approx(record.position[flying, 2].mean(), abs=0.2)


VALID_LOG = ulog({"vehicle_angular_velocity": (XYZ, rows(4000, lambda t: (t, 0.0, 0.0), sampled=0))})


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (VALID_LOG[:10], "is a ULog that cannot be read: Invalid file format"),
        (VALID_LOG[:40], "is a ULog without any of the topics"),
        (ulog({"cpuload": ([("float", "load")], [(1, 0.5)])}), "without any of the topics actuator_motors"),
        (VALID_LOG.replace(b"float[3] xyz", b"float[3] abc"), "has no signal"),
        (ulog({"wind": ([("float[65535]", "a"), ("float[65535]", "b")], [])}), "the topic wind has 131,071 fields"),
    ],
)
def test_an_unreadable_log_is_refused_with_one_sentence(read, data, message):
    with pytest.raises(InputError, match=message):
        read(data)


def test_a_mapping_for_a_ulog_needs_no_time(read, tmp_path):
    mapping = tmp_path / "mapping.yaml"
    columns = ", ".join(f"'vehicle_angular_velocity.xyz[{i}]'" for i in range(3))
    mapping.write_text(f"signals: {{body_rates: {{columns: [{columns}], frame: FRD}}}}")
    record = read(VALID_LOG, mapping)
    np.testing.assert_allclose(record.body_rates[:, 0], record.time, atol=1e-6)
    assert len(record.time) == 251


@pytest.mark.parametrize(
    ("topic", "expected_message"),
    [("wind", "the topic wind contains itself"), ("deep", "the topic wind has 25,000,001 fields")],
)
def test_topics_with_too_many_nested_fields_are_refused(read, topic, expected_message):
    formats = {"wind": f"uint64_t timestamp;{topic}[5000] a;", "deep": "float[5000] b;"}
    messages = [message(b"B", bytes(40)), *(message(b"F", f"{name}:{each}".encode()) for name, each in formats.items())]
    with pytest.raises(InputError, match=expected_message):
        read(VALID_LOG[:16] + b"".join(messages))


def test_the_fields_of_topics_are_counted_before_any_data_are_read(read, monkeypatch):
    """PyULog expands a nested topic into its fields when it reads the data, so the count must come first."""
    header_alone = []

    class Watched(pyulog.ULog):
        def __init__(self, *arguments, **options):
            header_alone.append(options.get("parse_header_only", False))
            super().__init__(*arguments, **options)

    monkeypatch.setattr(pyulog, "ULog", Watched)
    read(VALID_LOG)
    assert header_alone == [True, False]
    header_alone.clear()
    with pytest.raises(InputError, match="the topic wind has 131,071 fields"):
        read(ulog({"wind": ([("float[65535]", "a"), ("float[65535]", "b")], [])}))
    assert header_alone == [True]


def test_a_file_that_pyulog_would_read_forever_is_refused(read):
    with pytest.raises(InputError, match="is a ULog that cannot be read"):
        read(VALID_LOG[:16] + b"\xff\xff\0" + b"x" * 20)


def test_the_error_without_pyulog_says_how_to_install_it(read, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(InputError, match=r"pip install 'drake_quad\[ulog\]'"):
        read(VALID_LOG)


def test_rotors_are_sorted_by_the_positions_in_the_parameters(read):
    """PX4's rotor positions are positive forward and to the right.

    Rotors of this library are numbered clockwise from the front right, as seen from above.
    """
    motors = {
        "vehicle_attitude": (ATTITUDE, rows(4000, lambda t: quaternion_of(0.0, 0.0, 0.0))),
        "actuator_motors": ([("float[12]", "control")], rows(4000, lambda t: (0.1, 0.2, 0.3, 0.4, *[np.nan] * 8))),
    }
    assumed = read(ulog(motors))
    np.testing.assert_allclose(assumed.motor_command[0], [0.1, 0.4, 0.2, 0.3], rtol=1e-6)
    assert has_remark(assumed, "PX4's rotors 1 to 4 are rotors 1, 3, 4, 2 of this library, assumed as in PX4's quad-x")
    # Positions of PX4's rotors 1 to 4: front left, back left, back right, front right.
    positions = [(0.2, -0.3), (-0.2, -0.3), (-0.2, 0.3), (0.2, 0.3)]
    parameters = {"CA_ROTOR_COUNT": 4}
    for i, (x, y) in enumerate(positions):
        parameters |= {f"CA_ROTOR{i}_PX": x, f"CA_ROTOR{i}_PY": y}
    known = read(ulog(motors, parameters=parameters))
    np.testing.assert_allclose(known.motor_command[0], [0.4, 0.3, 0.2, 0.1], rtol=1e-6)
    assert has_remark(
        known, "PX4's rotors 1 to 4 are rotors 4, 3, 2, 1 of this library, according to the parameters CA_ROTOR0_PX"
    )
    named = read(ulog(motors, parameters=parameters), "px4")
    np.testing.assert_array_equal(named.motor_command, known.motor_command)
    assert named.remarks == known.remarks
    inconsistent = read(ulog(motors, parameters=parameters | {"CA_ROTOR0_PY": 0.3}))
    assert has_remark(inconsistent, "assumed as in PX4's quad-x")


def test_dropouts_are_reported():
    """A ULog gives the durations of dropouts in milliseconds."""
    logged = SimpleNamespace(dropouts=[SimpleNamespace(duration=each) for each in (20, 500, 30)])
    assert _dropouts(logged) == ["3 dropouts of the logger, 0.55 s in total; the longest lasts 0.5 s"]
    (one,) = _dropouts(SimpleNamespace(dropouts=[SimpleNamespace(duration=40)]))
    assert one.startswith("1 dropout of the logger, 0.04 s")
    assert _dropouts(SimpleNamespace(dropouts=[])) == []


TURNING_VEHICLE = {"vehicle_angular_velocity": (XYZ, rows(4000, lambda t: (t, 0.0, 0.0), sampled=0))}
STATUS_FIELDS = [("uint8_t", "vehicle_type"), ("bool", "is_vtol"), ("uint8_t", "system_type"), ("bool", "failsafe")]


def status(*values):
    return {"vehicle_status": (STATUS_FIELDS, rows(100_000, lambda t: values))}


@pytest.mark.parametrize(
    ("topics", "parameters", "message"),
    [
        ({}, {"MAV_TYPE": 13}, "a hexarotor (the parameter MAV_TYPE is 13)"),
        ({}, {"MAV_TYPE": 22, "CA_ROTOR_COUNT": 4}, "a VTOL (the parameter MAV_TYPE is 22)"),
        ({}, {"MAV_TYPE": 2, "CA_AIRFRAME": 1}, "an aeroplane (the parameter CA_AIRFRAME is 1)"),
        ({}, {"MAV_TYPE": 2, "CA_ROTOR_COUNT": 6}, "a vehicle with 6 rotors (the parameter CA_ROTOR_COUNT is 6)"),
        (status(1, False, 14, False), {}, "an octorotor (vehicle_status.system_type is 14)"),
        (status(2, False, 0, False), {}, "an aeroplane (vehicle_status.vehicle_type is 2)"),
        (status(1, True, 0, False), {}, "a VTOL (vehicle_status.is_vtol is 1)"),
    ],
)
def test_a_log_of_another_vehicle_is_refused_unless_a_mapping_is_given(read, topics, parameters, message):
    data = ulog({**TURNING_VEHICLE, **topics}, parameters=parameters)
    with pytest.raises(
        InputError, match=rf"log.ulg: is a log of {re.escape(message)}, not of a quadrotor; to read it, give a mapping"
    ):
        read(data)
    assert has_remark(read(data, "px4"), f"the log is of {message}")


@pytest.mark.parametrize(
    ("topics", "parameters"),
    [
        ({}, {}),
        ({}, {"MAV_TYPE": 2, "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 4}),
        ({}, {"MAV_TYPE": 0}),
        (status(1, False, 2, False), {"MAV_TYPE": 2}),
    ],
)
def test_a_log_of_a_quadrotor_is_read_without_a_remark(read, topics, parameters):
    assert not has_remark(read(ulog({**TURNING_VEHICLE, **topics}, parameters=parameters)), "the log is of")


PULSE_WIDTHS = ([("float[8]", "output")], rows(10_000, lambda t: (1075.0, 1512.5, 1950.0, 900.0, *[0.0] * 4)))


@pytest.mark.parametrize(
    ("parameters", "fractions", "message"),
    [
        ({}, (0.075, 0.0, 0.5125, 0.95), "1000 to 2000 µs, assumed, since the log contains no such parameter"),
        (
            {"PWM_MIN": 1075, "PWM_MAX": 1950},
            (0.0, 0.0, 0.5, 1.0),
            "1075 to 1950 µs, according to the parameters",
        ),
        ({"PWM_MAIN_MIN": 1075, "PWM_MAIN_MAX": 1950}, (0.0, 0.0, 0.5, 1.0), "1075 to 1950 µs, according to"),
        (
            {"PWM_MIN": 1075, "PWM_MAX": 1950, "PWM_MAIN_MIN3": 1025, "PWM_MAIN_MAX3": -1},
            (0.0, 0.0, 0.5, 1.0),
            "1075 to 1950, 1025 to 1950 µs",
        ),
        (
            # Motor 1 is at output 3, and motor 3 at output 1.
            {**{f"PWM_MAIN_FUNC{i}": 100 + motor for i, motor in ((3, 1), (2, 2), (1, 3), (4, 4))}, "PWM_MIN": 1000},
            (0.95, 0.0, 0.5125, 0.075),
            "motors 1 to 4 are on its outputs 3, 2, 1, 4",
        ),
    ],
)
def test_pulse_widths_are_scaled_by_the_limits_in_the_parameters(read, parameters, fractions, message):
    """A record lists front right, back right, back left and front left motor, which are PX4's motors 1, 4, 2 and 3."""
    record = read(ulog({**TURNING_VEHICLE, "actuator_outputs": PULSE_WIDTHS}, parameters=parameters))
    np.testing.assert_allclose(record.motor_command[-1], fractions, atol=1e-6)
    assert has_remark(record, message)


def test_equal_pulse_limits_are_refused(read):
    log = ulog(
        {**TURNING_VEHICLE, "actuator_outputs": PULSE_WIDTHS}, parameters={"PWM_MAIN_MIN2": 1500, "PWM_MAIN_MAX2": 1500}
    )
    with pytest.raises(InputError, match="set the pulses of motor 2 to 1500 to 1500 µs"):
        read(log)


def test_samples_that_the_log_marks_as_invalid_are_missing(read):
    fields = [
        *LOCAL_POSITION_FIELDS,
        *(("bool", name) for name in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid", "dead_reckoning")),
    ]
    local = rows(
        10_000, lambda t: (*[0.0] * 6, False, True, t > 0.205, True, False) if t < 0.395 else VALID_POSITION_ROW
    )
    record = read(ulog({"vehicle_local_position": (fields, local)}))
    missing = {each.signal: each.missing_fraction for each in record.origins}
    assert (missing["position"], missing["velocity"]) == pytest.approx((40 / 101, 21 / 101))
    np.testing.assert_allclose(record.position[0], [1.0, -2.0, 3.0], atol=1e-6)
    assert has_remark(
        record, "the position comes from dead reckoning in 60.40% of its samples, first at 0.4 s of the log"
    )


# Position (m) and velocity (m/s) in NED, four flags of valid components, and the flag of dead reckoning.
VALID_POSITION_ROW = (1.0, 2.0, -3.0, 0.1, 0.2, -0.3, True, True, True, True, True)


def test_resets_and_faults_of_the_estimator_and_failsafes_are_reported(read):
    local = [
        *LOCAL_POSITION_FIELDS,
        ("uint8_t", "xy_reset_counter"),
        ("float[2]", "delta_xy"),
        ("uint8_t", "vz_reset_counter"),
    ]
    local += [("float", "delta_vz")]

    def moved(t):
        first, second = t > 0.295, t > 0.695
        count = (254 + first + second) % 256
        delta = (0.3, 0.4 * second)
        return t + 0.3 * first + 0.5 * second, 0.0, -2.0, 0.0, 0.0, 0.0, count, *delta, t > 0.5, 1e-4

    turned = [("float[4]", "q"), ("uint8_t", "quat_reset_counter"), ("float[4]", "delta_q_reset")]
    data = ulog(
        {
            "vehicle_local_position": (local, rows(10_000, moved)),
            "vehicle_attitude": (
                turned,
                rows(10_000, lambda t: (1.0, 0.0, 0.0, 0.0, int(t > 0.495), np.cos(0.05), 0.0, 0.0, np.sin(0.05))),
            ),
            "estimator_status": (
                [("uint64_t", "filter_fault_flags"), ("uint64_t", "innovation_check_flags")],
                rows(100_000, lambda t: (int(t > 0.85), 0)),
            ),
            "vehicle_status": (
                [("bool", "failsafe"), ("uint8_t", "arming_state")],
                rows(100_000, lambda t: (0.15 < t < 0.45 or t > 0.95, 2)),
            ),
            "vehicle_land_detected": ([("bool", "landed")], rows(500_000, lambda t: (False,))),
        }
    )
    record = read(data)
    assert has_remark(record, "the estimator resets its position 2 times, by up to 0.5 m, first at 0.3 s of the log")
    assert has_remark(record, "the estimator resets its attitude once, by up to 0.1 rad, first at 0.5 s of the log")
    assert not has_remark(record, "resets its climb")  # the reset is 0.1 mm/s, too small to matter
    assert has_remark(
        record, "estimator_status reports numerical faults in 18.18% of its samples, first at 0.9 s of the log"
    )
    assert not has_remark(record, "rejected")
    assert has_remark(record, "PX4 is in failsafe from 0.2 to 0.4 s, 1 to 1 s of the log")
    assert has_remark(record, "the log ends in flight")
    assert has_remark(record, "position jumps 2 times, by up to 0.5 m at 0.7 s")
    assert not has_remark(record, "vehicle_land_detected")  # it has no signal that could be read


def test_times_in_remarks_count_from_the_first_sample_of_any_signal(read):
    fields = [("float[4]", "q"), ("uint8_t", "quat_reset_counter"), ("float[4]", "delta_q_reset")]
    turned = rows(10_000, lambda t: (1.0, 0.0, 0.0, 0.0, int(t > 0.495), 1.0, 0.1, 0.0, 0.0))
    starting_later = rows(10_000, lambda t: (t, *[0.0] * 5), start=1_200_000, duration=800_000)
    record = read(
        ulog({"vehicle_attitude": (fields, turned), "vehicle_local_position": (LOCAL_POSITION_FIELDS, starting_later)})
    )
    assert has_remark(record, "resets its attitude once, by up to 0.2 rad, first at 0.5 s of the log")


@pytest.mark.parametrize("bytes_left", [1, 7, 20])
def test_a_log_that_is_cut_is_reported(read, bytes_left):
    complete = ulog(TURNING_VEHICLE)
    last = 3 + 2 + 8 + 8 + 12
    assert not has_remark(read(complete), "the log is truncated")
    assert has_remark(
        read(complete[: len(complete) - last + bytes_left]), "no complete message, so the log is truncated"
    )


HEADER_AND_TWO_MESSAGES = b"ULog".ljust(16, b"\1") + message(b"F", b"12345") + message(b"D", b"1234567")
COMPLETE_SIZE = len(HEADER_AND_TWO_MESSAGES)  # bytes; the file is complete up to here


@pytest.mark.parametrize(
    ("rest", "end", "continues", "expected_message"),
    [
        (b"", COMPLETE_SIZE, False, ""),
        *(
            (message(b"D", b"123456789")[:count], COMPLETE_SIZE, False, "no complete message")
            for count in (1, 2, 3, 4, 11)
        ),
        (message(b"D", b"123456789"), COMPLETE_SIZE + 12, False, ""),
        (bytes(3), COMPLETE_SIZE, False, "all zeros"),
        (bytes(40), COMPLETE_SIZE, False, "all zeros"),
        (b"\xff" * 40, COMPLETE_SIZE, False, "all 0xff"),
        # A message that extends into zeros may be incomplete, unless it ends the file.
        (message(b"D", b"12\0\0"), COMPLETE_SIZE + 7, False, ""),
        (message(b"D", b"12\0\0") + bytes(5), COMPLETE_SIZE, False, "no complete message"),
        (message(b"D", b"12\0\x01") + bytes(5), COMPLETE_SIZE + 7, False, "all zeros"),
        # A message of unknown type is damage, after which reading may continue.
        (message(b"Z", b"12345"), COMPLETE_SIZE, True, "damaged from byte 34 on"),
        (
            message(b"Z", b"12345") + message(b"D", b"12345") + bytes(9),
            COMPLETE_SIZE,
            True,
            "damaged from byte 34 on",
        ),
    ],
)
def test_messages_of_a_log_are_contiguous_until_it_is_cut_or_damaged(rest, end, continues, expected_message):
    chain = _intact_start_of(LogFile(Path("log.ulg"), HEADER_AND_TWO_MESSAGES + rest, ()))
    assert (chain.end, chain.may_continue) == (end, continues)
    assert [expected_message in each for each in chain.remarks] == ([True] if expected_message else [])
