"""Tests of the PX4 table, which is read back as a PX4 log."""

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.flight.formats.flight_format import FORMATS
from drake_quad.flight.formats.px4_table import px4_columns, save_px4_table
from drake_quad.logs.reading import read_log


@pytest.fixture(scope="module")
def flight(diagrams):
    """Return a flight with noise, wind and turns, whose autopilot takes attitude and rate commands."""
    overrides = {
        "duration": 3.0,
        "route": {"heading": "along_path", "yaw": 0.4},
        "laboratory.motion_capture.position_noise": 0.01,
        "laboratory.wind": [{"kind": "steady", "velocity": [1.0, -2.0, 0.0]}],
    }
    return simulate(load_scenario(diagrams / "onboard.yaml", overrides), compiled=True)


@pytest.fixture(scope="module")
def record(flight, tmp_path_factory):
    return read_log(save_px4_table(flight, tmp_path_factory.mktemp("px4") / "flight.csv"))


@pytest.mark.slow
def test_signals_of_a_px4_table_are_read_back_unchanged(flight, record):
    measured, reference = flight["measurement"], flight["reference"]
    np.testing.assert_allclose(record.time, flight.time, rtol=0.0, atol=1e-12)
    for name, expected in {
        "position": measured[:, :3],
        "attitude": measured[:, 3:6],
        "velocity": measured[:, 6:9],
        "body_rates": measured[:, 9:],
        "rotor_speed": flight["rotor_speed"],
        "attitude_command": flight["attitude_command"],
        "body_rate_command": flight["attitude_target"][:, 4:],
        "reference_position": reference[:, :3],
        "reference_velocity": reference[:, 3:6],
        "reference_acceleration": reference[:, 6:9],
        "reference_yaw": reference[:, 9],
        "wind": flight["wind"],
    }.items():
        difference = record.of(name) - expected
        angles = ("attitude", "attitude_command", "reference_yaw")
        turns = 2.0 * np.pi * np.round(difference / (2.0 * np.pi)) if name in angles else 0.0
        np.testing.assert_allclose(difference - turns, 0.0, atol=1e-12, err_msg=name)
        assert np.abs(expected).max() > 1e-3, name
    assert any("the mapping is px4" in remark for remark in record.remarks)


def test_column_names_and_axes_follow_px4(flight):
    """Down and yaw to the right are positive in PX4's axes. Times are whole microseconds."""
    columns, state = px4_columns(flight), flight.record("state")
    assert columns["timestamp"].dtype == np.int64
    np.testing.assert_array_equal(columns["timestamp"][:3], [0, 20_000, 40_000])
    np.testing.assert_array_equal(columns["vehicle_local_position_groundtruth.z"], -state.z)
    np.testing.assert_array_equal(columns["vehicle_local_position_groundtruth.vy"], -state.v_y)
    np.testing.assert_array_equal(columns["vehicle_local_position_groundtruth.x"], state.x)
    w, _, _, z = (columns[f"vehicle_attitude_groundtruth.q[{i}]"] for i in range(4))
    assert np.abs(state.yaw).max() > 0.1
    np.testing.assert_allclose(np.cos(2.0 * np.arctan2(z, w) + state.yaw), 1.0, atol=1e-3)
    turning, yaw = columns["trajectory_setpoint.yawspeed"], columns["trajectory_setpoint.yaw"]
    assert np.abs(yaw).max() <= np.pi < np.abs(flight.record("reference").yaw).max()
    np.testing.assert_allclose(np.gradient(np.unwrap(yaw), flight.time), turning, atol=0.05)
    assert np.abs(turning).max() > 0.1
    rpm = columns["esc_status.esc[1].esc_rpm"] * 2.0 * np.pi / 60.0
    np.testing.assert_allclose(rpm, flight.record("rotor_speed").rotor_3, rtol=1e-12)


@pytest.mark.slow
def test_throttles_are_written_if_the_motors_take_throttle_commands(diagrams, flight, tmp_path):
    assert not any(name.startswith("actuator_motors") for name in px4_columns(flight))
    flight_with_throttles = simulate(
        load_scenario(diagrams / "neural_fly.yaml:still", {"duration": 0.5, "metrics.start": 0}), compiled=True
    )
    record = read_log(save_px4_table(flight_with_throttles, tmp_path / "throttles.csv"))
    np.testing.assert_allclose(
        record.motor_command, np.clip(flight_with_throttles["throttle_command"], 0.0, 1.0), atol=1e-12
    )


def test_the_format_is_registered_with_its_option():
    assert {(each.option, each.file_name) for each in FORMATS} >= {("px4", "px4.csv")}
