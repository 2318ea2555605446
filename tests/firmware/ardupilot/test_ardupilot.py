"""Flights with a stand-in for ArduPilot that speaks its JSON interface."""

import socket

import numpy as np
import pytest
from ardupilot_peer import Peer

from drake_quad import load_scenario, simulate, simulate_samples
from drake_quad.errors import InputError
from drake_quad.firmware.ardupilot import connection as module
from drake_quad.firmware.ardupilot.connection import ArduPilotConnection
from drake_quad.firmware.ardupilot.messages import Servos, motion_message
from drake_quad.firmware.ardupilot.system import DEFAULT_PARAMETERS, fields_of
from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.remote_control import Motion, parameters_of


@pytest.fixture
def port():
    """Return a free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture
def ardupilot(port):
    """Return a function that starts a stand-in for ArduPilot."""
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
            {"laboratory": {"autopilot": {"port": port, "period": 0.0025, **autopilot}}},
            overrides or {},
        ],
        layers=["vehicles/racer", f"firmware/ardupilot:{mode}"],
    )


@pytest.mark.long
@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_the_vehicle_hovers(ardupilot, port, mode):
    peer = ardupilot()
    flight = simulate(scenario(port, mode=mode))
    assert peer.messages[-2]["rc"]["rc_5"] == (1000 if mode == "angle" else 2000)
    assert not flight.metrics.crashed
    assert flight.metrics.rmse < 0.05
    assert abs(flight.record("state").yaw[-1] - 0.6) < 0.02


@pytest.mark.long
def test_the_vehicle_follows_a_route_and_a_yaw(ardupilot, port):
    ardupilot()
    circle = {"route": {"kind": "circle", "radius": 1.0, "height": 2.0, "top_speed": 1.0}, "duration": 10.0}
    flight = simulate(scenario(port, circle))
    assert not flight.metrics.crashed
    assert flight.metrics.rmse < 0.3


@pytest.mark.long
def test_repeated_and_foreign_datagrams_do_not_change_a_flight(ardupilot, port):
    first = ardupilot()
    plain = simulate(scenario(port))
    first.stopped.set()
    first.join()
    ardupilot(repeats=True, num_servos=32)
    np.testing.assert_array_equal(simulate(scenario(port))["state"], plain["state"])


@pytest.mark.long
def test_each_vehicle_of_a_fleet_has_its_own_port(ardupilot, port):
    for vehicle in range(2):
        ardupilot(10 * vehicle)
    flights = simulate_samples(scenario(port), range(2))
    assert not any(flight.metrics.crashed for flight in flights)
    assert not np.array_equal(flights[0]["state"], flights[1]["state"])


@pytest.mark.long
def test_the_firmware_receives_the_motion_in_its_axes(ardupilot, port):
    """The vehicle flies forward (north), to the left (west) and up, with a yaw to the left."""
    peer = ardupilot()
    flight = simulate(scenario(port))
    message = peer.messages[-2]
    state = flight.record("state")
    assert message["position"] == pytest.approx([state.x[-1], -state.y[-1], -state.z[-1]], abs=0.02)
    w, x, y, z = message["quaternion"]
    assert np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)) == pytest.approx(-0.6, abs=0.03)
    assert message["imu"]["accel_body"][2] == pytest.approx(-9.81, abs=0.5)
    times = [each["timestamp"] for each in peer.messages]
    np.testing.assert_allclose(np.diff(times), 0.0025, rtol=1e-6)


@pytest.mark.long
def test_a_vehicle_that_does_not_arm_is_refused(ardupilot, port):
    ardupilot(arms=False)
    with pytest.raises(InputError, match=r"^ArduPilot does not arm, .* diagrams/firmware/ardupilot.param$"):
        simulate(scenario(port))


@pytest.mark.long
def test_an_ardupilot_that_ends_in_flight_is_reported(ardupilot, port, monkeypatch):
    monkeypatch.setattr(module, "STEP_TIMEOUT", 0.5)
    ardupilot(max_steps=13_000)
    with pytest.raises(FirmwareError, match=rf"^the flight ended at .* s: ArduPilot at port {port} .* did not answer"):
        simulate(scenario(port, {"duration": 100.0}))


def test_an_ardupilot_that_has_flown_is_refused(ardupilot, port):
    ardupilot(first_frame=70)
    with pytest.raises(FirmwareError, match="has already flown; start it again"):
        ArduPilotConnection(port)


def test_a_missing_ardupilot_is_reported_with_the_command_that_starts_it(port, monkeypatch):
    monkeypatch.setattr(module, "START_TIMEOUT", 0.1)
    with pytest.raises(FirmwareError, match="start it by: sim_vehicle.py -v ArduCopter --model JSON:127.0.0.1"):
        ArduPilotConnection(port)


def test_a_port_that_is_in_use_is_reported(port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", port))
        with pytest.raises(FirmwareError, match=f"^port {port} of 127.0.0.1 cannot be used: address already in use$"):
            ArduPilotConnection(port)


def test_messages_have_the_published_format():
    motion = Motion(
        (0.1, 0.2, 0.3), (0.0, 0.0, -9.8), (1.0, 2.0, -3.0), (1.0, 0.0, 0.0, 0.0), (4.0, 5.0, 6.0), 101_325.0
    )
    assert motion_message(2.5, motion, [1500, 1000]) == (
        b'\n{"timestamp": 2.5, "imu": {"gyro": [0.1, 0.2, 0.3], "accel_body": [0.0, 0.0, -9.8]}, "position":'
        b' [1.0, 2.0, -3.0], "quaternion": [1.0, 0.0, 0.0, 0.0], "velocity": [4.0, 5.0, 6.0], "rc": {"rc_1": 1500,'
        b' "rc_2": 1000}}\n'
    )
    datagram = bytes.fromhex("1a48 2003 07000000") + b"".join(n.to_bytes(2, "little") for n in range(1001, 1017))
    assert Servos.of(datagram) == (7, (1001, 1002, 1003, 1004))
    assert Servos.of(datagram[:-1]) is None
    assert Servos.of(b"") is None


def read(*lines):
    return parameters_of(lines, DEFAULT_PARAMETERS, fields_of)


def test_parameters_are_read_in_both_formats():
    parameters = read("# comment", "ANGLE_MAX,3000", "ACRO_RP_RATE 180.5 # slow", "ATC_RAT_RLL_P 0.1", "")
    assert (parameters["ANGLE_MAX"], parameters["ACRO_RP_RATE"], parameters["FRAME_TYPE"]) == (3000.0, 180.5, 1.0)
    for line in ("ANGLE_MAX", "ANGLE_MAX fast", "ANGLE_MAX 1 2"):
        with pytest.raises(InputError, match=f"the line '{line}' must contain the name and the value of a parameter"):
            read(line)


def test_the_shipped_parameters_are_the_defaults(diagrams):
    lines = (diagrams / "firmware" / "ardupilot.param").read_text().splitlines()
    assert read(*lines) == DEFAULT_PARAMETERS
    named = {line.split()[0] for line in lines if line and not line.startswith("#")}
    assert DEFAULT_PARAMETERS.keys() <= named
