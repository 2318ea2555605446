"""Tests of offboard flights against a stand-in for a vehicle."""

import json
import socket
from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, read_log
from drake_quad.offboard.companion import Companion
from drake_quad.offboard.flight import OffboardFlight
from drake_quad.offboard.limits import Fence, Limits
from drake_quad.offboard.link import OffboardError, VehicleLink

pytest.importorskip("pymavlink", reason="the extra px4 is not installed")
from stand_in import HOP, SimulatedClock, StandInVehicle


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
    before=lambda vehicle: None,
    after_heartbeat=lambda vehicle: None,
    during=None,
    engages=True,
    dry_run=False,
    end_mode="hold",
    **vehicle_options,
):
    """Fly a stand-in, and return the outcome, the vehicle and the reported phases."""
    clock = SimulatedClock()
    vehicle = StandInVehicle(port, clock=clock, **vehicle_options)
    before(vehicle)
    link = None
    try:
        link = VehicleLink(f"udpin:127.0.0.1:{port}", clock=clock)
        after_heartbeat(vehicle)
        companion = Companion(scenario(scenario_name), setpoint, limits)
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
    modes = [message for message in vehicle.commands if message.command == 176]  # MAV_CMD_DO_SET_MODE
    assert len(modes) == 2
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
    assert len(record.time) == outcome.num_ticks == Companion(scenario("onboard"), "attitude", Limits()).num_ticks
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
        vehicle.clock.call_later(delay, lambda: action(vehicle))

    return start


def setter(**values):
    return lambda vehicle: [setattr(vehicle, name, value) for name, value in values.items()]


@pytest.mark.parametrize(
    ("action", "reason", "mode"),
    [
        (setter(mode="POSCTL"), "the vehicle changed to POSCTL", "POSCTL"),
        (setter(armed=False), "the vehicle was disarmed", None),
        (setter(streams=False), "the latest position or attitude is 0.", "LAND"),
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
    assert outcome.reason.endswith("the vehicle changed to LOITER")
    assert vehicle.mode == "LOITER"


def test_the_pilot_can_start_the_flight(port, tmp_path):
    start = at_phase("waiting", later(setter(mode="OFFBOARD"), 2.0))
    outcome, vehicle, _ = fly(port, tmp_path, engages=False, during=start)
    assert outcome.completed
    assert len([message for message in vehicle.commands if message.command == 176]) == 1  # the mode after the flight


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"on_ground": True}, "the autopilot does not report that the vehicle is in the air; take off first"),
        ({"armed": False}, "the autopilot does not report that the vehicle is in the air; take off first"),
    ],
)
def test_a_vehicle_on_the_ground_does_not_fly(port, tmp_path, options, reason):
    outcome, *_ = fly(port, tmp_path, **options)
    assert outcome.reason.startswith(reason)
    assert outcome.num_ticks == 0


def test_a_refused_mode_ends_the_flight(port, tmp_path):
    outcome, vehicle, _ = fly(port, tmp_path, during=at_phase("switching", setter(accepts_modes=False)))
    assert outcome.reason.startswith("PX4 did not switch to OFFBOARD")
    assert vehicle.mode == "POSCTL"


def test_an_interruption_ends_the_flight(port, tmp_path):
    def interrupt(vehicle):
        raise KeyboardInterrupt

    outcome, *_ = fly(port, tmp_path, during=at_phase("following", later(interrupt)))
    assert outcome.reason == "interrupted; the vehicle changed to LOITER"
    assert not outcome.completed


def test_a_slow_computer_ends_the_flight(port, tmp_path):
    outcome, *_ = fly(port, tmp_path, during=at_phase("following", lambda vehicle: vehicle.clock.sleep(3.0)))
    assert outcome.reason.startswith(("a control tick was", "the vehicle changed to LOITER"))


def test_nobody_answers(port):
    with pytest.raises(OffboardError, match="no autopilot sent a heartbeat"):
        VehicleLink(f"udpin:127.0.0.1:{port}", clock=SimulatedClock())
    with pytest.raises(InputError, match="cannot be opened"):
        VehicleLink("/dev/does_not_exist")
    with pytest.raises(InputError, match="cannot be opened"):
        VehicleLink("tcp:127.0.0.1:1")


def test_parameters_of_ardupilot(port):
    clock = SimulatedClock()
    vehicle = StandInVehicle(port, clock=clock, stack="ardupilot")
    link = VehicleLink(f"udpin:127.0.0.1:{port}", clock=clock)
    try:
        assert link.hover_thrust() == pytest.approx(0.35)
        vehicle.parameters["ATC_ANGLE_BOOST"] = 1.0
        link._parameters.clear()
        with pytest.raises(OffboardError, match="set its parameter ATC_ANGLE_BOOST to 0"):
            link.hover_thrust()
        vehicle.parameters["GUID_OPTIONS"] = 0.0
        link._parameters.clear()
        with pytest.raises(OffboardError, match=r"GUID_OPTIONS \(add 8\)"):
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
        Companion(moving, "position")
    with pytest.raises(InputError, match="the route has a speed of"):
        Companion(scenario(), "position", Limits(speed=0.1))
    with pytest.raises(InputError, match="the route needs a tilt of"):
        Companion(scenario(), "position", Limits(tilt=0.01))


def test_a_slow_serial_port_is_refused():
    link = SimpleNamespace(clock=SimulatedClock(), max_byte_rate=5760.0)
    OffboardFlight(link, Companion(scenario(), "position"))
    with pytest.raises(InputError, match="the serial port transmits only 5760"):
        OffboardFlight(link, Companion(scenario("onboard"), "attitude"))


@pytest.mark.parametrize("fast_heartbeats", [True, False])
def test_a_pilot_who_takes_over_keeps_the_vehicle(port, tmp_path, fast_heartbeats):
    """Without fast heartbeats, a limit may be exceeded before the change of the mode is known."""

    def take_over(vehicle):
        vehicle.mode = "POSCTL"
        vehicle.state[0] += 3.0

    outcome, vehicle, _ = fly(
        port,
        tmp_path,
        before=setter(fast_heartbeats=fast_heartbeats),
        during=at_phase("following", later(take_over, 1.55)),
    )
    assert not outcome.completed
    assert vehicle.mode == "POSCTL"
    assert "the vehicle changed to POSCTL" in outcome.reason
    assert len([message for message in vehicle.commands if message.command == 176]) == 1


def test_an_error_of_the_controller_ends_the_flight(port, tmp_path, monkeypatch):
    command, count = Companion.command, []

    def failing(self, state):
        count.append(state)
        if len(count) > 50:
            raise ValueError("no solution")
        return command(self, state)

    monkeypatch.setattr(Companion, "command", failing)
    outcome, vehicle, _ = fly(port, tmp_path, setpoint="attitude", scenario_name="onboard")
    assert outcome.reason == "ValueError: no solution; the vehicle changed to LOITER"
    assert vehicle.mode == "LOITER"


@pytest.mark.parametrize(("accepted", "mode"), [(["OFFBOARD", "LAND"], "LAND"), (["OFFBOARD"], "POSCTL")])
def test_a_vehicle_that_refuses_to_hold_lands_or_holds_until_the_pilot_takes_over(port, tmp_path, accepted, mode):
    outcome, vehicle, reports = fly(
        port,
        tmp_path,
        before=setter(modes_accepted=accepted),
        during=at_phase("the vehicle does not change", later(setter(mode="POSCTL"), 3.0)),
    )
    assert not outcome.completed
    assert vehicle.mode == mode
    assert outcome.reason.startswith("the route is complete; ")
    assert reports[-1].startswith("the vehicle does not change its mode") == (mode == "POSCTL")
    np.testing.assert_allclose(vehicle.state[:3], [4.0, -2.5, -2.0], atol=0.15)


def test_the_default_fence_surrounds_the_route_from_where_the_pilot_switches(port, tmp_path):
    def climb_and_switch(vehicle):
        vehicle.state[2] -= 5.0
        vehicle.clock.call_later(0.3, lambda: setattr(vehicle, "mode", "OFFBOARD"))

    outcome, vehicle, _ = fly(port, tmp_path, engages=False, during=at_phase("waiting", later(climb_and_switch)))
    assert outcome.completed, outcome.reason
    assert vehicle.state[2] == pytest.approx(-7.0, abs=0.1)


def test_a_route_that_leaves_the_fence_where_the_pilot_switches_is_not_flown(port, tmp_path):
    def move_and_switch(vehicle):
        vehicle.state[0] += 3.0
        vehicle.clock.call_later(0.3, lambda: setattr(vehicle, "mode", "OFFBOARD"))

    fence = Fence((0.0, 0.0, 0.0), (6.5, 4.0, 4.0))
    outcome, vehicle, _ = fly(
        port, tmp_path, engages=False, limits=Limits(fence), during=at_phase("waiting", later(move_and_switch))
    )
    assert outcome.num_ticks == 0
    assert "leaves the geofence" in outcome.reason
    assert vehicle.mode == "LOITER"


def test_a_vehicle_that_already_follows_setpoints_must_first_leave_the_mode(port, tmp_path):
    outcome, vehicle, _ = fly(port, tmp_path, before=setter(mode="GUIDED"), stack="ardupilot", engages=False)
    assert outcome.reason.startswith("the vehicle is already in GUIDED")
    assert [message for message in vehicle.commands if message.command == 176] == []


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"has_landed_state": False}, "the autopilot does not report that the vehicle is in the air"),
        ({"streams": False}, None),
    ],
)
def test_a_vehicle_with_incomplete_telemetry_does_not_fly(port, tmp_path, change, reason):
    if reason is None:
        with pytest.raises(OffboardError, match="sent no position and attitude"):
            fly(port, tmp_path, during=None, after_heartbeat=setter(**change))
        return
    outcome, *_ = fly(port, tmp_path, before=setter(**change))
    assert outcome.reason.startswith(reason)


def test_a_state_that_is_not_finite_is_not_sent_back(port, tmp_path):
    def lose_position(vehicle):
        vehicle.state[0] = np.nan

    outcome, vehicle, _ = fly(port, tmp_path, during=at_phase("following", later(lose_position)))
    assert outcome.reason.startswith("the measured state is not finite")
    assert all(np.isfinite(message.x) for _, message in vehicle.received)


def test_one_of_several_vehicles_must_be_chosen(port):
    clock = SimulatedClock()
    vehicles = [StandInVehicle(port, clock=clock, system=system) for system in (3, 8)]
    try:
        with pytest.raises(OffboardError, match="several vehicles send to .*: systems 3, 8"):
            VehicleLink(f"udpin:127.0.0.1:{port}", clock=clock)
        link = VehicleLink(f"udpin:127.0.0.1:{port}", clock=clock, system=8)
        assert link.system == 8
        link.close()
        with pytest.raises(OffboardError, match="system 5 does not send to .*, but only 3, 8"):
            VehicleLink(f"udpin:127.0.0.1:{port}", clock=clock, system=5)
    finally:
        for vehicle in vehicles:
            vehicle.close()


def test_a_closed_tcp_connection_is_noticed(port):
    clock = SimulatedClock()
    with socket.create_server(("127.0.0.1", port)) as server:

        class Peer:
            """Vehicle that accepts the connection, sends heartbeats, and closes it."""

            connection = None

            def update(self, now):
                if self.connection is None:
                    self.connection, _ = server.accept()
                self.connection.sendall(heartbeat)

        mavlink = pytest.importorskip("pymavlink.dialects.v20.common")
        message = mavlink.MAVLink_heartbeat_message(2, 12, 209, 6 << 16, 4, 3)
        heartbeat = message.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1))
        peer = Peer()
        clock.vehicles.append(peer)
        link = VehicleLink(f"tcp:127.0.0.1:{port}", clock=clock)
        link.telemetry()
        clock.vehicles.remove(peer)
        peer.connection.close()
        clock.sleep(1.0)
        with pytest.raises(OffboardError, match="was closed"):
            link.telemetry()
        link.close()


def test_body_rates_are_limited(port, tmp_path):
    outcome, vehicle, _ = fly(
        port, tmp_path, setpoint="rates", scenario_name="onboard", limits=Limits(rate=0.02, error=50.0, tilt=1.3)
    )
    rates = [
        (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        for _, message in vehicle.received
        if message.get_type() == "SET_ATTITUDE_TARGET"
    ]
    assert np.abs(rates).max() == pytest.approx(0.02, rel=1e-5)
    assert outcome.num_limited > 0


@pytest.mark.parametrize("setpoint", ["position", "attitude", "rates"])
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            {"hover": 0.36},
            "hovers with 36% of the largest thrust, but MPC_THR_HOVER is 0.45; set MPC_THR_HOVER to 0.36",
        ),
        ({"has_thrust": False}, "does not send its thrust"),
        ({"hover": 0.49}, None),
    ],
)
def test_the_thrust_in_hover_is_compared_with_its_parameter_before_thrusts_are_commanded(
    port, tmp_path, setpoint, change, reason
):
    def prepare(vehicle):
        for name, value in change.items():
            setattr(vehicle, name, value)

    outcome, vehicle, _ = fly(port, tmp_path, setpoint=setpoint, scenario_name="onboard", before=prepare)
    if setpoint == "position" or reason is None:
        assert outcome.num_ticks > 0
        return
    assert reason in outcome.reason
    assert not outcome.completed
    assert vehicle.mode == "LOITER"
    assert not any(message.get_type() == "SET_ATTITUDE_TARGET" for _, message in vehicle.received)
