"""Tests of the messages to a vehicle: their bytes, and the frames of their fields."""

import math
import socket
import struct

import numpy as np
import pytest
from stand_in import euler, rotation

from drake_quad import InputError
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.offboard.limits import Fence, Limits, tilt_angle, with_limited_tilt
from drake_quad.offboard.link import PX4, VehicleLink
from drake_quad.offboard.setpoints import attitude_fields, measured_state
from drake_quad.signals import AttitudeTarget, BodyRates, Reference, State

# Numbers of the messages in MAVLink's common dialect.
ATTITUDE_NUMBER, POSITION_NUMBER = 82, 84
HOVER = State(*[0.0] * 12)


@pytest.fixture
def connected():
    """Yield a link, and a socket that receives what the link sends."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="the extra px4 is not installed")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        encoder = mavlink.MAVLink(None, srcSystem=5, srcComponent=1)
        heartbeat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 209, 6 << 16, 4, 3
        )
        ground_station = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3
        )
        other = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        vehicle.settimeout(5.0)

        class Clock:
            """Clock whose vehicle sends a heartbeat whenever somebody waits."""

            time = 0.0

            def now(self):
                return self.time

            def sleep(self, duration):
                self.time += duration
                vehicle.sendto(ground_station.pack(other), ("127.0.0.1", port))
                vehicle.sendto(heartbeat.pack(encoder), ("127.0.0.1", port))

        link = VehicleLink(f"udpin:127.0.0.1:{port}", clock=Clock())
        yield link, vehicle
        link.close()


def payload(vehicle, number, size):
    """Return source and payload of the next message with a number, with the zeros at the end that MAVLink 2 omits."""
    while True:
        data = vehicle.recv(300)
        magic, length, incompatible, _, _, system, component = data[:7]
        assert (magic, incompatible) == (0xFD, 0)
        if int.from_bytes(data[7:10], "little") == number:
            return (system, component), data[10 : 10 + length].ljust(size, b"\0")


def test_a_position_setpoint_has_the_published_layout(connected):
    """Fields of MAVLink are ordered by their size: 32 bits, 16 bits, 8 bits."""
    link, vehicle = connected
    assert link.stack is PX4
    link.send_position(Reference(1, 2, 3, 0.1, 0.2, 0.3, 0.01, 0.02, 0.03, math.pi + 0.5, 0.4))
    source, data = payload(vehicle, POSITION_NUMBER, 53)
    assert source == (5, 191)  # a companion computer is a component of the vehicle
    _, *numbers, mask, system, component, frame = struct.unpack("<I11fHBBB", data)
    expected = [1, -2, -3, 0.1, -0.2, -0.3, 0.01, -0.02, -0.03, math.pi - 0.5, -0.4]
    np.testing.assert_allclose(numbers, expected, rtol=1e-6)
    assert (mask, system, component, frame) == (0, 5, 1, 1)


@pytest.mark.parametrize("setpoint", ["attitude", "rates"])
def test_an_attitude_setpoint_has_the_published_layout(connected, setpoint):
    link, vehicle = connected
    target = AttitudeTarget(5.0, 0.3, -0.2, 1.0, 0, 0, 0)
    if setpoint == "attitude":
        link.send_attitude(target, 0.6)
    else:
        link.send_rates(BodyRates(0.1, 0.2, 0.3), 0.6)
    _, data = payload(vehicle, ATTITUDE_NUMBER, 39)
    _, *numbers, system, component, mask = struct.unpack("<I8f3B", data)
    quaternion, rates, thrust = numbers[:4], numbers[4:7], numbers[7]
    assert (system, component) == (5, 1)
    assert thrust == pytest.approx(0.6)
    if setpoint == "attitude":
        assert mask == 0b111  # body rates are ignored
        np.testing.assert_allclose(euler(quaternion), [0.3, 0.2, -1.0], atol=1e-6)
    else:
        assert mask == 0b1000_0000  # the attitude is ignored
        np.testing.assert_allclose(rates, [0.1, -0.2, -0.3], rtol=1e-6)


def test_the_frames_of_measurements_and_setpoints_agree():
    """The thrust axis in both frames is the same direction, and a measured attitude is sent back unchanged."""

    class Position:
        x, y, z, vx, vy, vz = 1.0, 2.0, -3.0, 0.1, 0.2, -0.3

    class Attitude:
        roll, pitch, yaw, rollspeed, pitchspeed, yawspeed = 0.3, -0.2, 1.0, 0.4, 0.5, 0.6

    state = measured_state(Position, Attitude)
    assert state == State(1.0, -2.0, 3.0, 0.3, 0.2, -1.0, 0.1, -0.2, 0.3, 0.4, -0.5, -0.6)
    up = np.array(Quaternion.of(state.roll, state.pitch, state.yaw).axes().z)
    down = rotation(0.3, -0.2, 1.0)[:, 2]
    np.testing.assert_allclose(up, -down * [1.0, -1.0, -1.0], atol=1e-9)
    target = AttitudeTarget(1.0, state.roll, state.pitch, state.yaw, 0, 0, 0)
    np.testing.assert_allclose(euler(attitude_fields(target)), [0.3, -0.2, 1.0], atol=1e-9)


def test_a_reduced_tilt_keeps_its_direction():
    target = AttitudeTarget(5.0, 0.9, -0.6, 1.0, 0, 0, 0)
    limited = with_limited_tilt(target, 0.5)
    assert tilt_angle(limited.roll, limited.pitch) == pytest.approx(0.5, abs=1e-6)
    assert limited.pitch / limited.roll == pytest.approx(-0.6 / 0.9)
    assert with_limited_tilt(target, 1.2) is target


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, None),
        ({"x": 2.1}, "the vehicle left the geofence: x is 2.10 m, outside -2.00 to 2.00 m"),
        ({"z": -0.1}, "the vehicle left the geofence: z is -0.10 m, outside 0.00 to 2.00 m"),
        ({"v_y": -3.1}, "the speed of 3.1 m/s exceeds 3 m/s"),
        ({"roll": 0.4, "pitch": 0.4}, None),
        ({"roll": 0.6, "pitch": 0.4}, "the tilt of 41° exceeds 39°"),
        ({"roll": 3.1}, "the tilt of 178° exceeds 39°"),
        ({"y": 1.5}, "the distance of 1.58 m from the reference exceeds 1 m"),
        ({"yaw": math.nan}, "the measured state is not finite"),
    ],
)
def test_the_first_exceeded_limit_is_named(change, words):
    limits = Limits(Fence((-2.0, -2.0, 0.0), (2.0, 2.0, 2.0)), speed=3.0, tilt=0.5, error=1.0)
    reference = Reference(0.0, 0.0, 0.5, *[0.0] * 8)
    assert limits.violation(HOVER._replace(**change), reference) == words


def test_a_route_outside_the_fence_is_refused():
    route = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    Fence.around(route).check_route(route)
    assert Fence.around(route) == ((-2.0, -2.0, 0.5), (3.0, 2.0, 3.0))
    with pytest.raises(InputError, match=r"leaves the geofence at \(1.00, 0.00, 1.00\) m"):
        Fence((-1.0, -1.0, 0.0), (0.5, 1.0, 2.0)).check_route(route)
