"""Flights with a stand-in for PX4 that speaks MAVLink for simulators."""

import socket

import numpy as np
import pytest
from px4_peer import Peer
from pymavlink.dialects.v20 import common
from scipy.spatial.transform import Rotation

from drake_quad import load_scenario, simulate, simulate_samples
from drake_quad.errors import InputError
from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.px4 import connection as module
from drake_quad.firmware.px4.connection import Px4Connection
from drake_quad.firmware.px4.messages import Px4Messages, magnetic_field
from drake_quad.firmware.px4.system import DEFAULT_PARAMETERS, fields_of
from drake_quad.firmware.remote_control import Motion, parameters_of


@pytest.fixture
def port():
    """Return a free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture
def px4(port):
    """Return a function that starts a stand-in for PX4."""
    peers = []

    def start(offset=0, **options):
        peers.append(Peer(port + offset, **options))
        peers[-1].start()
        return peers[-1]

    yield start
    for peer in peers:
        peer.stopped.set()
        peer.join()


def scenario(port, overrides=None, mode="angle", **autopilot):
    return load_scenario(
        "laboratory:nominal",
        [
            {"route": {"kind": "hover", "position": [1.0, -2.0, 1.5], "yaw": 0.6}, "duration": 3.0},
            {"laboratory": {"autopilot": {"port": port, **autopilot}}},
            overrides or {},
        ],
        layers=["vehicles/racer", f"firmware/px4:{mode}"],
    )


@pytest.mark.long
@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_the_vehicle_hovers(px4, port, mode):
    px4()
    flight = simulate(scenario(port, mode=mode))
    assert not flight.metrics.crashed
    assert flight.metrics.rmse < 0.1
    assert abs(flight.record("state").yaw[-1] - 0.6) < 0.02


@pytest.mark.long
def test_the_vehicle_follows_a_route_and_a_yaw(px4, port):
    px4()
    circle = {"route": {"kind": "circle", "radius": 1.0, "height": 2.0, "top_speed": 1.0}, "duration": 10.0}
    flight = simulate(scenario(port, circle))
    assert not flight.metrics.crashed
    assert flight.metrics.rmse < 0.3


@pytest.mark.long
def test_other_messages_and_a_slow_start_do_not_change_a_flight(px4, port):
    first = px4()
    plain = simulate(scenario(port))
    first.stopped.set()
    first.join()
    px4(talks=True, silent_steps=7)
    np.testing.assert_array_equal(simulate(scenario(port))["state"], plain["state"])


@pytest.mark.long
def test_each_vehicle_of_a_fleet_has_its_own_port(px4, port):
    for vehicle in range(2):
        px4(vehicle)
    flights = simulate_samples(scenario(port), range(2))
    assert not any(flight.metrics.crashed for flight in flights)
    assert not np.array_equal(flights[0]["state"], flights[1]["state"])


@pytest.mark.long
def test_the_firmware_receives_the_motion_of_the_vehicle(px4, port):
    peer = px4()
    flight = simulate(scenario(port))
    state = flight.record("state")
    satellites, sensors = peer.satellites[-1], peer.sensors[-2]
    metre = np.degrees(1.0 / 6_371_000.0)
    assert (satellites.lat * 1e-7 - 47.397742) / metre == pytest.approx(state.x[-1], abs=0.1)
    east = (satellites.lon * 1e-7 - 8.545594) / metre * np.cos(np.radians(47.397742))
    assert east == pytest.approx(-state.y[-1], abs=0.1)
    assert satellites.alt * 1e-3 - 488.0 == pytest.approx(state.z[-1], abs=0.1)
    assert sensors.zacc == pytest.approx(-9.81, abs=0.5)
    # The compass shows the heading, with a declination of 3° to the east.
    heading = np.arctan2(-sensors.ymag, sensors.xmag) + np.radians(3.0)
    assert heading == pytest.approx(-0.6, abs=0.05)
    times = np.array([each.time_usec for each in peer.sensors])
    np.testing.assert_array_equal(np.diff(times), 2500)
    # PX4 considers a sensor whose readings do not change as defective.
    resting = peer.sensors[:1000]
    for name in ("xacc", "ygyro", "zmag", "abs_pressure"):
        assert np.mean(np.diff([getattr(each, name) for each in resting]) != 0.0) > 0.95


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"arms": False}, InputError, r"^PX4 does not arm, .* diagrams/firmware/px4.env$"),
        ({"silent_steps": 10_000}, FirmwareError, "did not command its motors within 10 s; start it with the"),
        ({"max_steps": 13_000}, FirmwareError, r"^the flight ended at .* s: PX4 at port .* has closed the connection$"),
        ({"hangs_after": 13_000}, FirmwareError, r"^the flight ended at .* s: PX4 at port .* did not answer within"),
    ],
)
def test_failures_are_reported(px4, port, monkeypatch, options, error, words):
    monkeypatch.setattr(module, "STEP_TIMEOUT", 0.5)
    monkeypatch.setattr(module, "_STARTING_TIMEOUT", 0.001)
    px4(**options)
    with pytest.raises(error, match=words):
        simulate(scenario(port, {"duration": 100.0}))


def test_a_missing_px4_is_reported_with_the_settings_that_start_it(port, monkeypatch):
    monkeypatch.setattr(module, "START_TIMEOUT", 0.1)
    with pytest.raises(FirmwareError, match="start it with PX4_SIM_MODEL=none_iris and the parameters in diagrams/"):
        Px4Connection(port, seed=0)


def test_a_port_that_is_in_use_is_reported(port):
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as other:
        other.bind(("127.0.0.1", port))
        other.listen()
        with pytest.raises(FirmwareError, match=f"^port {port} of 127.0.0.1 cannot be used: address already in use$"):
            Px4Connection(port, seed=0)


def test_messages_have_the_published_format():
    """The first ten bytes are the header of MAVLink 2: start, length, flags, number, sender, and identifier."""
    motion = Motion((0.1, 0.2, 0.3), (0.0, 0.0, -9.8), (1.0, 2.0, -3.0), (1.0, 0.0, 0.0, 0.0), (4.0, 5.0, 6.0), 1e5)
    messages = Px4Messages(seed=0)
    packed = messages.sensors(2500, motion), messages.satellites(2500, motion), messages.channels(2500, [1500, 1000])
    assert [int.from_bytes(each[7:10], "little") for each in packed] == [107, 113, 65]
    assert {each[0] for each in packed} == {0xFD}
    sensors, satellites, channels = (common.MAVLink(None).parse_buffer(each)[0] for each in packed)
    assert (sensors.time_usec, sensors.id, sensors.fields_updated) == (2500, 0, 0b1101111111111)
    assert sensors.abs_pressure == pytest.approx(1000.0, abs=0.05)
    assert (satellites.fix_type, satellites.alt, satellites.vn, satellites.ve, satellites.vd) == (
        3,
        491_000,
        400,
        500,
        600,
    )
    assert (channels.chancount, channels.chan1_raw, channels.chan2_raw, channels.chan3_raw) == (2, 1500, 1000, 65535)


def test_the_magnetic_field_turns_with_the_vehicle():
    field = np.array(magnetic_field((1.0, 0.0, 0.0, 0.0)))
    assert np.linalg.norm(field) == pytest.approx(0.48, abs=0.001)
    rotation = Rotation.from_euler("ZYX", [0.4, -0.3, 0.2])
    x, y, z, w = rotation.as_quat()
    np.testing.assert_allclose(magnetic_field((w, x, y, z)), rotation.inv().apply(field), atol=1e-12)


def read(*lines):
    return parameters_of(lines, DEFAULT_PARAMETERS, fields_of)


def test_parameters_are_read_in_all_formats():
    assert read() == DEFAULT_PARAMETERS
    for line in (
        "PX4_PARAM_MC_ACRO_R_MAX=200",
        "param set MC_ACRO_R_MAX 200",
        "1\t1\tMC_ACRO_R_MAX\t200.0\t9",
        "MC_ACRO_R_MAX 200 # slow",
    ):
        assert read("# comment", line)["MC_ACRO_R_MAX"] == 200.0
    with pytest.raises(InputError, match="the line 'MC_ACRO_R_MAX' must contain the name and the value of a parameter"):
        read("MC_ACRO_R_MAX")


def test_the_shipped_parameters_are_the_defaults(diagrams):
    lines = [line for line in (diagrams / "firmware" / "px4.env").read_text().splitlines() if not line.startswith("#")]
    assert read(*lines) == DEFAULT_PARAMETERS
    assert DEFAULT_PARAMETERS.keys() <= {fields_of(line)[0] for line in lines}


def test_bytes_that_are_no_message_are_skipped():
    messages, px4 = Px4Messages(seed=0), common.MAVLink(None, srcSystem=1, srcComponent=1)
    controls = px4.hil_actuator_controls_encode(7, [0.25] * 16, 0, 0).pack(px4)
    damaged = controls[:-1] + bytes([controls[-1] ^ 0xFF])
    assert messages.motors(b"\x00garbage" + damaged + controls) == [(7, (0.25,) * 4)]
