"""Tests of offboard flights against a stand-in for a vehicle."""

import _thread
import json
import socket
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, read_log
from drake_quad.offboard.companion import Companion
from drake_quad.offboard.flight import OffboardFlight
from drake_quad.offboard.limits import Fence, Limits
from drake_quad.offboard.link import OffboardError, VehicleLink

pytest.importorskip("pymavlink", reason="the extra px4 is not installed")
from stand_in import FastClock, StandInVehicle

HOP = {
    "kind": "waypoints",
    "waypoints": [{"point": [0, 0, 1]}, {"point": [1, 0.5, 1.5]}],
    "times": [0.0, 3.0],
    "top_speed": None,
    "top_acceleration": None,
}


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def scenario(name="laboratory:nominal", *overrides):
    return load_scenario(name, [f"route={json.dumps(HOP)}", "metrics={start: 0, end: null}", *overrides])


def fly(
    port,
    tmp_path,
    *,
    setpoint="position",
    scenario_name="laboratory:nominal",
    limits=Limits(),
    during=None,
    engages=True,
    dry_run=False,
    end_mode="hold",
    **vehicle_options,
):
    clock = FastClock()
    vehicle = StandInVehicle(port, clock=clock, **vehicle_options)
    link = None
    try:
        link = VehicleLink(f"udpin:127.0.0.1:{port}", clock=clock)
        companion = Companion(scenario(scenario_name), setpoint)
        reports = []

        def report(text):
            reports.append(text)
            if during is not None:
                during(vehicle, text)

        flight = OffboardFlight(
            link, companion, limits=limits, engages=engages, dry_run=dry_run, end_mode=end_mode, report=report
        )
        outcome = flight.run(tmp_path / "log.csv")
    finally:
        if link is not None:
            link.close()
        vehicle.close()
    return outcome, vehicle, reports


@pytest.mark.parametrize(("stack", "end"), [("px4", "LOITER"), ("ardupilot", "BRAKE")])
def test_the_vehicle_follows_the_route_from_where_it_hovers_and_then_holds(port, tmp_path, stack, end):
    outcome, vehicle, _ = fly(port, tmp_path, stack=stack)
    assert outcome.completed, outcome.reason
    assert outcome.rmse < 0.1
    assert vehicle.mode == end
    np.testing.assert_allclose(vehicle.state[:3], [4.0, -2.5, -2.0], atol=0.1)
    assert abs(vehicle.state[8]) < 0.1


@pytest.mark.parametrize("stack", ["px4", "ardupilot"])
@pytest.mark.parametrize("setpoint", ["attitude", "rates"])
def test_the_controller_of_a_scenario_flies_the_vehicle(port, tmp_path, stack, setpoint):
    outcome, vehicle, _ = fly(port, tmp_path, stack=stack, setpoint=setpoint, scenario_name="onboard")
    assert outcome.completed, outcome.reason
    assert outcome.rmse < 0.2
    assert outcome.thrusts[0] < vehicle.hover < outcome.thrusts[1]
    kinds = [message.get_type() for _, message in vehicle.received]
    assert kinds.count("SET_ATTITUDE_TARGET") == outcome.num_ticks
    masks = {message.type_mask for _, message in vehicle.received if message.get_type() == "SET_ATTITUDE_TARGET"}
    assert masks == {7 if setpoint == "attitude" else 128}


def test_the_log_of_a_flight_can_be_read(port, tmp_path):
    outcome, *_ = fly(port, tmp_path, setpoint="attitude", scenario_name="onboard")
    record = read_log(tmp_path / "log.csv")
    assert len(record.time) == outcome.num_ticks
    errors = np.linalg.norm(record.of("position") - record.of("reference_position"), axis=1)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(outcome.rmse, rel=1e-3)
    # The route begins at its own first point in the log.
    np.testing.assert_allclose(record.of("position")[0], [0.0, 0.0, 1.0], atol=0.1)


@pytest.mark.parametrize("setpoint", ["position", "attitude"])
def test_a_dry_run_sends_neither_setpoints_nor_modes(port, tmp_path, setpoint):
    outcome, vehicle, _ = fly(
        port, tmp_path, setpoint=setpoint, scenario_name="onboard", dry_run=True, armed=False, on_ground=True
    )
    assert outcome.completed
    assert outcome.num_ticks > 0
    assert np.isfinite(outcome.thrusts).all() == (setpoint == "attitude")
    assert vehicle.received == []
    assert {message.command for message in vehicle.commands} == {511}  # MAV_CMD_SET_MESSAGE_INTERVAL


def at_phase(begin, action):
    """Return a function for `during` that calls an action on the vehicle when a phase begins."""
    return lambda vehicle, text: action(vehicle) if text.startswith(begin) else None


def later(action, delay=1.0):
    """Return a function that calls an action on the vehicle after a delay on its clock, s."""

    def start(vehicle):
        threading.Timer(delay / vehicle.clock.speed, action, [vehicle]).start()

    return start


def setter(**values):
    return lambda vehicle: [setattr(vehicle, name, value) for name, value in values.items()]


@pytest.mark.parametrize(
    ("action", "reason", "mode"),
    [
        (setter(mode="POSCTL"), "the vehicle has switched to POSCTL", "POSCTL"),
        (setter(armed=False), "the vehicle was disarmed", None),
        (setter(streams=False), "position or attitude are 0.", "LAND"),
        (setter(disturbance=np.array([40.0, 0.0, 0.0])), "the ", "LAND"),
    ],
    ids=["pilot", "disarmed", "no telemetry", "gust"],
)
def test_a_flight_ends_early(port, tmp_path, action, reason, mode):
    """If the pilot takes over, no setpoint and no mode follows; otherwise the vehicle lands."""
    outcome, vehicle, _ = fly(port, tmp_path, during=at_phase("following", later(action)), end_mode="land")
    assert not outcome.completed
    assert outcome.reason.startswith(reason)
    assert 0 < outcome.num_ticks < 300
    modes = [message for message in vehicle.commands if message.command == 176]
    if mode == "LAND":
        assert vehicle.mode == "LAND"
        assert len(modes) >= 2
    else:
        assert len(modes) == 1  # the first commands Offboard
    assert len((tmp_path / "log.csv").read_text().splitlines()) == outcome.num_ticks + 1


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (Limits(Fence((2.0, 0.0, 0.0), (3.5, 4.0, 4.0))), "the route, which begins where the vehicle is, leaves"),
        (Limits(speed=0.1), "the speed of 0.1 m/s exceeds 0.1 m/s"),
        (Limits(error=0.0), "the distance of"),
    ],
)
def test_limits(port, tmp_path, limits, reason):
    if limits.fence is not None:
        with pytest.raises(InputError, match=reason):
            fly(port, tmp_path, limits=limits)
        return
    outcome, vehicle, _ = fly(port, tmp_path, limits=limits)
    assert outcome.reason.startswith(reason)
    assert outcome.reason.endswith("the vehicle is in mode LOITER")
    assert vehicle.mode == "LOITER"


def test_the_pilot_can_start_the_flight(port, tmp_path):
    start = at_phase("switch to OFFBOARD", later(setter(mode="OFFBOARD"), 2.0))
    outcome, vehicle, _ = fly(port, tmp_path, engages=False, during=start)
    assert outcome.completed
    assert len([message for message in vehicle.commands if message.command == 176]) == 1  # the mode after the flight


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"on_ground": True}, "the vehicle is not in the air; take off first"),
        ({"armed": False}, "the vehicle is not in the air; take off first"),
    ],
)
def test_a_vehicle_on_the_ground_does_not_fly(port, tmp_path, options, reason):
    outcome, *_ = fly(port, tmp_path, **options)
    assert outcome.reason.startswith(reason)
    assert outcome.num_ticks == 0


def test_a_refused_mode_ends_the_flight(port, tmp_path):
    outcome, vehicle, _ = fly(port, tmp_path, during=at_phase("switching", setter(accepts_modes=False)))
    assert outcome.reason == "PX4 did not switch to OFFBOARD"
    assert vehicle.mode == "POSCTL"


def test_an_interruption_ends_the_flight(port, tmp_path):
    def interrupt(vehicle):
        _thread.interrupt_main()

    outcome, *_ = fly(port, tmp_path, during=at_phase("following", later(interrupt)))
    assert outcome.reason == "interrupted; the vehicle is in mode LOITER"
    assert not outcome.completed


def test_a_slow_computer_ends_the_flight(port, tmp_path):
    outcome, *_ = fly(port, tmp_path, during=at_phase("following", lambda vehicle: vehicle.clock.sleep(3.0)))
    assert outcome.reason.startswith(("this computer was", "the vehicle has switched to LOITER"))


def test_nobody_answers(port):
    with pytest.raises(OffboardError, match="no autopilot sent a heartbeat"):
        VehicleLink(f"udpin:127.0.0.1:{port}", clock=FastClock(100.0))
    with pytest.raises(InputError, match="cannot be opened"):
        VehicleLink("/dev/does_not_exist")
    with pytest.raises(InputError, match="cannot be opened"):
        VehicleLink("tcp:127.0.0.1:1")


def test_parameters_of_ardupilot(port):
    clock = FastClock()
    vehicle = StandInVehicle(port, clock=clock, stack="ardupilot")
    link = VehicleLink(f"udpin:127.0.0.1:{port}", clock=clock)
    try:
        assert link.hover_thrust() == pytest.approx(0.35)
        vehicle.parameters["GUID_OPTIONS"] = 0.0
        link._parameters.clear()
        with pytest.raises(OffboardError, match="add 8 to its parameter GUID_OPTIONS"):
            link.hover_thrust()
        vehicle.parameters.clear()
        link._parameters.clear()
        with pytest.raises(OffboardError, match="did not send its parameter GUID_OPTIONS"):
            link.hover_thrust()
    finally:
        link.close()
        vehicle.close()


def test_controllers_that_cannot_fly_a_vehicle():
    with pytest.raises(InputError, match="commands thrust and torques"):
        Companion(scenario(), "attitude")
    route = "{kind: lissajous, centre: [0, 0, 1], amplitude: [1, 1, 0], turns: [1, 2, 0], period: 12, laps: 2}"
    moving = load_scenario("laboratory:nominal", [f"route={route}", "metrics={start: 0, end: null}"])
    with pytest.raises(InputError, match="begins with a speed"):
        OffboardFlight(SimpleNamespace(clock=FastClock()), Companion(moving, "position"))
