"""Flights with the Crazyflie's firmware, or with a stand-in for its Python bindings if they are not installed."""

import importlib
import importlib.util
import socket
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad import load_scenario, simulate, simulate_samples
from drake_quad.errors import InputError
from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.crazyflie import server

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="firmware flies only on Linux")
STUB = Path(__file__).parent / "stub"


@pytest.fixture(params=["stub", "firmware"])
def bindings(request, monkeypatch):
    """Make the stand-in or, if they are installed, the real bindings importable."""
    if request.param == "stub":
        monkeypatch.syspath_prepend(str(STUB))
    elif importlib.util.find_spec("cffirmware") is None:
        pytest.skip("cffirmware is not installed; docs/how_to/fly_crazyflie_firmware.md says how to build it")
    return request.param


def scenario(mode="angle", overrides=None, **autopilot):
    hover = {"route": {"kind": "hover", "position": [0.0, 0.0, 1.0], "yaw": 0.7}, "duration": 4.0}
    layers = ["vehicles/crazyflie", f"firmware/crazyflie:{mode}"]
    given = {"laboratory": {"autopilot": autopilot}} if autopilot else {}
    return load_scenario("laboratory:nominal", [hover, given, overrides or {}], layers=layers)


@pytest.mark.long
@pytest.mark.usefixtures("bindings")
@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_the_vehicle_hovers_and_flights_repeat(mode):
    flights = [simulate(scenario(mode)) for _ in range(2)]
    assert not flights[0].metrics.crashed
    assert flights[0].metrics.rmse < 0.02
    assert abs(flights[0].record("state").yaw[-1] - 0.7) < 0.02
    np.testing.assert_array_equal(flights[0]["state"], flights[1]["state"])


@pytest.mark.long
@pytest.mark.usefixtures("bindings")
@pytest.mark.parametrize(("controller", "estimator"), [("pid", "kalman"), ("mellinger", "none"), ("lee", "kalman")])
def test_the_vehicle_hovers_with_each_controller_and_the_kalman_filter(controller, estimator):
    flight = simulate(scenario(stabilizer_controller=controller, stabilizer_estimator=estimator))
    assert not flight.metrics.crashed
    assert flight.metrics.rmse < 0.02
    assert abs(flight.record("state").yaw[-1] - 0.7) < 0.02
    with_pid = simulate(scenario())
    assert not np.array_equal(flight["rotor_speed_command"], with_pid["rotor_speed_command"])


def test_only_the_pid_flies_in_acro_mode():
    with pytest.raises(InputError, match="stabilizer_controller is 'lee', but must be pid in the mode acro"):
        scenario("acro", stabilizer_controller="lee")


@pytest.mark.long
@pytest.mark.usefixtures("bindings")
def test_a_bias_of_the_gyroscope_tilts_the_estimate_of_the_kalman_filter():
    """Between poses the filter integrates the biased rate, so that the vehicle drifts in the direction of the bias."""
    sensors = [
        {"kind": "gyroscope", "period": 0.00125, "bias": [0.5, 0.0, 0.0]},
        {"kind": "accelerometer", "period": 0.00125},
    ]
    biased = simulate(scenario(overrides={"laboratory": {"sensors": sensors}}, stabilizer_estimator="kalman"))
    exact = simulate(scenario(stabilizer_estimator="kalman"))
    assert not biased.metrics.crashed
    assert biased.metrics.rmse > 2.0 * exact.metrics.rmse


@pytest.mark.long
@pytest.mark.usefixtures("bindings")
def test_the_vehicle_follows_a_route_from_a_tilted_start():
    eight = {
        "route": {"kind": "figure_eight"},
        "duration": 12.0,
        "initial": {"attitude": [0.4, -0.3, 0.5], "body_rates": [1.0, 1.0, 0.5]},
    }
    flight = simulate(scenario(overrides=eight))
    assert not flight.metrics.crashed
    assert flight.euclidean_error[-100:].max() < 0.6


@pytest.mark.long
def test_each_vehicle_of_a_fleet_has_its_own_firmware(monkeypatch):
    monkeypatch.syspath_prepend(str(STUB))
    alone = simulate(scenario())
    first, second = simulate_samples(scenario(), range(2))
    np.testing.assert_array_equal(first["state"], alone["state"])
    assert not np.array_equal(first["state"], second["state"])


def test_a_plus_is_refused(monkeypatch):
    monkeypatch.syspath_prepend(str(STUB))
    plus = load_scenario("laboratory:nominal", layers=["vehicles/paper", "firmware/crazyflie:angle"])
    with pytest.raises(InputError, match="do not fit nominal.layout; choose a layout of kind x"):
        simulate(plus)


def test_missing_bindings_are_reported(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="^cffirmware is not installed; build it in a checkout"):
        simulate(scenario())


def test_bindings_that_fail_end_the_flight_with_their_last_output(tmp_path, monkeypatch):
    (tmp_path / "cffirmware.py").write_text("raise OSError('wrong architecture')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(FirmwareError, match="firmware ended with status 1; its last output was: OSError: wrong arch"):
        simulate(scenario())


def test_angles_and_rates_reach_the_controller_in_degrees_and_in_its_axes(monkeypatch):
    monkeypatch.syspath_prepend(str(STUB))
    bindings, seen = importlib.import_module("cffirmware"), []

    def controller(control, setpoint, sensors, state, tick):
        attitude, gyro, acc = (vars(each).copy() for each in (state.attitude, sensors.gyro, sensors.acc))
        seen.append((attitude, gyro, acc, vars(setpoint.attitude).copy(), setpoint.attitudeRate.yaw, tick))

    monkeypatch.setattr(bindings, "controllerPid", controller)
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    monkeypatch.setenv("LOCKSTEP_SOCKET", str(there.detach()))
    monkeypatch.setattr(sys, "argv", ["server.py", "pid", "none"])
    program = threading.Thread(target=server.main)
    program.start()
    with here:
        here.settimeout(10.0)
        x, y, z, w = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True).as_quat()
        force, pose, commands = [9.81, 19.62, 29.43], [w, x, y, z, 1.0, 2.0, 3.0], [*np.radians([4, 5, 6]), 0.5]
        numbers = [*np.radians([1, 2, 3]), *force, *pose, *commands]
        here.recv(server.REPLY.size)
        here.send(server.REQUEST.pack(2, False, *numbers))
        here.recv(server.REPLY.size)
    program.join(10.0)
    attitude, gyro, acc, wanted, turn, tick = seen[-1]
    assert attitude == pytest.approx({"roll": 10.0, "pitch": -20.0, "yaw": 30.0})
    assert gyro == pytest.approx({"x": 1.0, "y": 2.0, "z": 3.0})
    assert acc == pytest.approx({"x": 1.0, "y": 2.0, "z": 3.0})
    assert (wanted["roll"], wanted["pitch"], turn) == pytest.approx((4.0, -5.0, 6.0))
    assert tick == len(seen) == 2
