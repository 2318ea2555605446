"""Tests of commands that design gains, plan routes and read logs, and of interruptions of commands.

Stubs replace the computations of the commands.
"""

import importlib
import math
import multiprocessing
import re
import signal
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ruamel.yaml import YAML
from test_passed_arguments import replaced  # noqa: F401 - a fixture

from drake_quad import load_scenario, simulate
from drake_quad.command_line import identify, interruption, running
from drake_quad.command_line.design import design_remarks
from drake_quad.design.cascade import CascadeDesign
from drake_quad.design.gains import SLOWER_POLE
from drake_quad.design.lqg import LqgLimits
from drake_quad.errors import InputWarning
from drake_quad.flight.mission import plan_route
from drake_quad.logs.record import FlightRecord
from drake_quad.space.distance import nearest_approach
from drake_quad.space.shapes import Ball
from drake_quad.space.space import Obstacle, Space


@pytest.fixture
def designed(replaced):  # noqa: F811
    """Replace the computations of the command `design` by stubs with constant gains, and return the recorded calls."""

    def design(scenario, *_, on_board, integral):
        rows = {"k_p": [1.0, 2.0, 3.0], "k_d": [4.0, 5.0, 6.0]}
        integrals = {} if integral is None else {"k_i": [7.0, 8.0, 9.0]}
        return SimpleNamespace(
            gains=lambda: (
                {"position": rows | integrals} | ({} if scenario.cascade.attitude is None else {"attitude": rows})
            ),
            autopilot_gains=lambda: {"k_attitude": [11.0, 12.0, 13.0], "k_rate": [21.0, 22.0, 23.0]},
            loops={},
            on_board={"roll": None} if on_board else {},
        )

    return replaced(
        "design", design_cascade=design, closed_loop="a loop", plot_steps="steps", DESIGN_PLOTS=None, print_design=None,
        print_modes=None, save_figures=[], joint_disk_margin=None, print_joint_disk_margin=None,
    )  # fmt: skip


def test_gains_are_designed_for_the_scenario_and_written(run, designed, monkeypatch, tmp_path):
    monkeypatch.setattr("drake_quad.command_line.design.DESIGN_PLOTS", {"bode": lambda _: "bode"})
    result = run("design", "hover", "--vector", "svg", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    (((scenario, options), named),) = designed["design_cascade"]
    assert scenario.name == "hover"
    assert {"roll", "pitch", "yaw", "x", "y", "z"} == options.keys()
    assert named == {"on_board": False, "integral": None}
    gains = tmp_path / "gains.yaml"
    written = YAML(typ="safe").load(gains.read_text(encoding="utf-8"))
    assert written["gains"]["control"]["kind"] == "cascade"
    assert written["gains"]["control"]["position"]["k_d"] == [4.0, 5.0, 6.0]
    assert gains.read_text(encoding="utf-8").startswith("# drake-quad design hover --vector svg")
    for saved in (load_scenario(tmp_path / "scenario.yaml"), load_scenario("hover", layers=[f"{gains}:gains"])):
        position = saved.control.position
        assert (position.kind, position.k_p, position.k_d) == ("pd", (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    # The plotted loop has the new gains.
    (((simulated,), _),) = designed["closed_loop"]
    assert simulated.control.position.k_p == (1.0, 2.0, 3.0)
    assert designed["save_figures"] == [(({"bode": "bode", "steps": "steps"}, tmp_path), {"vector": "svg"})]
    lines = result.stdout.splitlines()
    assert lines[1] == (
        f"to use the gains in a scenario, write `extends: [FILE:NAME, {gains}]`; to fly the designed scenario:"
    )
    assert lines[2:] == [
        f"  drake-quad fly {tmp_path / 'scenario.yaml'}",
        "wrote",
        f"  {gains}",
        f"  {tmp_path / 'scenario.yaml'}",
    ]


def test_the_designed_gains_are_certified_on_request(run, designed, monkeypatch, tmp_path):
    monkeypatch.setattr("drake_quad.command_line.design.DESIGN_PLOTS", {})
    actual = SimpleNamespace(
        ranges=["mass"], stable_scale=1.234, unstable=SimpleNamespace(values={"mass": 1.0}, scale=1.3),
        without_equilibrium=SimpleNamespace(values={}, scale=float("inf")), gap=0.05, num_cells=7,
    )  # fmt: skip
    certified = []
    monkeypatch.setattr(
        "drake_quad.command_line.design.certify_hover", lambda scenario: certified.append(scenario) or actual
    )
    drawn = "vehicle.mass={uniform: {min: 0.6, max: 0.7}}"
    result = run("design", "hover", "--set", drawn, "--certify", "--output", tmp_path)
    assert result.returncode == 0
    assert certified[0].control.position.k_p == (1.0, 2.0, 3.0)
    assert "stable up to scale       1.23" in result.stdout
    assert "unstable at scale        1.3" in result.stdout
    refused = run("design", "hover", "--certify", "--output", tmp_path)
    assert (refused.returncode, len(certified)) == (2, 1)
    assert "--certify: hover contains no distribution, so there is nothing to certify" in refused.stderr
    assert run("design", "hover", "--set", drawn, "--output", tmp_path).returncode == 0
    assert len(certified) == 1


def test_the_integral_gains_of_a_pid_are_designed(run, designed, monkeypatch, tmp_path):
    monkeypatch.setattr("drake_quad.command_line.design.DESIGN_PLOTS", {})
    pid = "control.position={kind: pid, k_p: [1, 1, 1], k_d: [1, 1, 1], k_i: [1, 1, 1]}"
    for number, (options, integral) in enumerate(
        ((["--integral", 0.25], 0.25), (["--set", pid], 0.15), (["--set", pid, "--integral", 0.5], 0.5))
    ):
        assert run("design", "hover", *options, "--output", tmp_path).returncode == 0
        (scenario, _), named = designed["design_cascade"][number]
        assert (scenario.control.position.kind, named["integral"]) == ("pid", integral)
        saved = load_scenario(tmp_path / "scenario.yaml").control.position
        assert (saved.kind, saved.k_i) == ("pid", (7.0, 8.0, 9.0))


ATTITUDE_LOOPS = "laboratory.autopilot={kind: attitude, k_attitude: [6, 6, 3], k_rate: [14, 14, 8]}"
INTEGRAL_ON_BOARD = "laboratory.autopilot.rate_terms={k_i: [9, 9, 9]}"
POSITION_PID = "control.position={kind: pid, k_p: [1, 1, 1], k_d: [2, 2, 2], k_i: [0.1, 0.1, 0.1]}"


@pytest.mark.parametrize(
    ("overrides", "on_board", "is_remarked"),
    [
        ([], True, True),
        ([], False, False),
        ([INTEGRAL_ON_BOARD], True, False),
        ([POSITION_PID], True, False),
        (["vehicle.centre_of_mass=[0, 0]"], True, False),
    ],
)
def test_a_remark_states_the_hover_offset_if_a_design_has_no_integral(overrides, on_board, is_remarked):
    designed = load_scenario(
        "onboard", [ATTITUDE_LOOPS, "vehicle.centre_of_mass=[0.002, 0]", "control.attitude=null", *overrides]
    )
    remarks = design_remarks(CascadeDesign({}, {"roll": None} if on_board else {}), designed)
    words = r"will hover \d+ cm from its reference, because .*; --integral adds one to the position loops"
    assert [bool(re.search(words, sentence)) for sentence in remarks] == [True] * is_remarked


@pytest.mark.parametrize("scenario", ["onboard", "hover"])
def test_a_remark_suggests_lqr_if_a_slow_pole_on_board_limits_a_loop(scenario):
    limits = {"z": ("phase margin",), "x": (SLOWER_POLE,), "y": (SLOWER_POLE,)}
    design = CascadeDesign({axis: SimpleNamespace(limits=axis_limits) for axis, axis_limits in limits.items()})
    remarks = design_remarks(design, load_scenario(scenario))
    assert [sentence.partition(", rather than")[0] for sentence in remarks] == (
        ["a slow pole of the loops on board limits x, y"] if scenario == "onboard" else []
    )
    assert all("--method lqr" in sentence for sentence in remarks)


@pytest.mark.slow
def test_gains_are_designed_for_the_median_vehicle_and_for_its_autopilot(run, designed, monkeypatch, tmp_path):
    monkeypatch.setattr("drake_quad.command_line.design.DESIGN_PLOTS", {})
    drawn = "vehicle.mass={choice: [0.6, 0.7, 0.8]}"
    result = run("design", "onboard", "--set", drawn, "--on-board", "--output", tmp_path)
    assert result.returncode == 0
    assert result.stderr == "remark: the gains are designed for the median of each distribution\n"
    assert f"  drake-quad study {tmp_path / 'scenario.yaml'} --samples 32\n" in result.stdout
    (scenario, options), named = designed["design_cascade"][0]
    assert (scenario.vehicle.mass, named["on_board"]) == (0.7, True)
    assert "roll rate" in options
    saved = load_scenario(tmp_path / "scenario.yaml")
    assert saved.laboratory.autopilot.k_rate == (21.0, 22.0, 23.0)
    written = YAML(typ="safe").load((tmp_path / "gains.yaml").read_text(encoding="utf-8"))
    assert written["gains"]["laboratory"]["autopilot"]["k_attitude"] == [11.0, 12.0, 13.0]
    for field in ("attitude.bandwidth", "attitude.damping", "yaw.damping"):
        refused = run("design", "onboard", "--loop", f"{field}=0.5", "--output", tmp_path)
        assert refused.returncode == 2
        assert f"--loop {field} belongs to attitude control on the ground" in refused.stderr


def test_a_regulator_is_designed_within_the_requested_limits(run, replaced, tmp_path):  # noqa: F811
    control = load_scenario("laboratory:low_wind", layers=["controllers/designed/laboratory:lqg"]).control
    actual = SimpleNamespace(control=control, plants=[], lateral=[], vertical=[])
    calls = replaced("design_lqg", design_lqg=actual, link_margins="margins", print_margins=None)
    limits = ["--sensitivity", 2.5, "--delay-margin", 0.04, "--snap", 30, "--acceleration", 2]
    result = run("design-lqg", "laboratory:low_wind", *limits, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    (((scenario, allowed), _),) = calls["design_lqg"]
    assert (scenario.name, allowed) == ("low_wind", LqgLimits(2.5, 0.04, 30.0, 2.0))
    assert calls["print_margins"] == [(("margins",), {})]
    (((simulated,), _),) = calls["link_margins"]
    assert simulated.control == load_scenario(tmp_path / "scenario.yaml").control == control
    files = [str(tmp_path / name) for name in ("lqg.yaml", "scenario.yaml")]
    assert f"`extends: [FILE:NAME, {files[0]}]`" in result.stdout
    assert f"\n  drake-quad study {files[1]} --samples 32\n" in result.stdout
    assert [line.strip() for line in result.stdout.split("wrote\n")[1].splitlines()] == files
    assert run("design-lqg", "laboratory:low_wind", "--output", tmp_path).returncode == 0
    assert calls["design_lqg"][1][0][1] == LqgLimits()


@pytest.mark.slow
def test_a_plan_names_the_nearest_obstacle(run, replaced, tmp_path):  # noqa: F811
    simulated = plan_route(load_scenario("figure_eight"))
    space = Space((Obstacle("ball", Ball((3.0, 0.0, 1.0), radius=0.2)), Obstacle("far", Ball((9.0, 9.0, 1.0)))), 0.1)
    problem = SimpleNamespace(waypoints=[*range(len(simulated.path.times) + 2)], corridors=())
    planned = [simulated, problem, None, space]
    calls = replaced(
        "plan",
        plan_route_with_problem=lambda _: planned,
        plot_plan="figure",
        save_plan=["pieces"],
        save_figures=["plan"],
    )
    result = run("plan", "figure_eight", "--vector", "pdf", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    rows = [line.split() for line in result.stdout.splitlines()]
    approach = nearest_approach(simulated.path, space)
    assert [
        "smallest",
        "distance",
        f"{approach.distance:.3f}",
        "m",
        "from",
        "ball,",
        "at",
        f"{approach.time:.2f}",
        "s",
    ] in rows
    assert rows[1][:2] == ["repeated", "2"]
    (clearance,) = (row for row in rows if row[0] == "clearance")
    assert clearance[1] == f"{space.clearance:.3f}"
    assert any(row[:2] == ["active", "limits:"] for row in rows)
    assert rows[-3:] == [["wrote"], ["pieces"], ["plan"]]
    ((plan, _), named) = calls["plot_plan"][0]
    assert plan is simulated
    assert (named["regions"], named["space"], named["waypoints"]) == (problem.waypoints, space, None)
    assert calls["save_plan"] == [((simulated, tmp_path), {"name": "figure_eight"})]
    assert calls["save_figures"] == [(({"plan": "figure"}, tmp_path), {"vector": "pdf"})]
    # The plan around obstacles has additional corners, which are not drawn as waypoints.
    planned[2] = [0, 2]
    run("plan", "figure_eight", "--output", tmp_path)
    assert calls["plot_plan"][1][1]["regions"] == [0, 2]
    planned[1:] = None, None, None
    without = run("plan", "figure_eight", "--output", tmp_path)
    assert "smallest distance" not in without.stdout
    assert "repeats" not in without.stdout
    assert (calls["plot_plan"][2][1]["regions"], calls["plot_plan"][2][1]["corridors"]) == ((), ())


def test_a_log_is_compared_from_the_requested_time(run, replaced, tmp_path):  # noqa: F811
    record = FlightRecord("log7", np.arange(3.0), remarks=("it has a gap",))
    calls = replaced(
        "compare_log", read_log=record, compare_with_log="comparison", print_comparison=None, save_comparison=["file"]
    )
    command_line = ["compare-log", "log.csv", "hover", "--output", tmp_path]
    result = run(*command_line, "--mapping", "mine.yaml", "--samples", 7, "--rest", 2, "--start", 3.5)
    assert (result.returncode, result.stderr) == (0, "remark: it has a gap\n")
    assert calls["read_log"] == [((Path("log.csv"), "mine.yaml"), {})]
    ((log, scenario), named) = calls["compare_with_log"][0]
    assert (log, scenario.name) == (record, "hover")
    assert (named["samples"], named["rest"], named["start"]) == (7, 2.0, 3.5)
    assert calls["save_comparison"][0][0][:2] == ("comparison", tmp_path)
    assert run(*command_line).returncode == 0
    named = calls["compare_with_log"][1][1]
    assert (named["samples"], named["rest"], named["start"]) == (1000, 8.0, None)
    for option, value, status in (
        ("--samples", 0, 2), ("--samples", 10_000, 0), ("--samples", 10_001, 2), ("--rest", 0, 0), ("--rest", 60, 0),
        ("--rest", 61, 2),
    ):  # fmt: skip
        assert run(*command_line, option, value).returncode == status


def test_a_log_provides_the_route_of_a_scenario_without_one(run, replaced, tmp_path):  # noqa: F811
    record = FlightRecord("log7", np.arange(3.0))
    calls = replaced(
        "compare_log", read_log=record, compare_with_log="comparison", print_comparison=None, save_comparison=["file"]
    )
    gains = "{k_p: [10.0, 10.0, 10.0], k_d: [7.0, 7.0, 7.0], k_i: [5.0, 5.0, 8.0]}"
    (tmp_path / "mine.yaml").write_text(
        f"mine:\n  extends: {Path('diagrams/controllers/lee.yaml').resolve()}\n"
        f"  control: {{position: {gains}, attitude: {gains}}}\n"
    )
    result = run("compare-log", "log.csv", tmp_path / "mine.yaml", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert calls["compare_with_log"][0][0][1].name == "mine"


@pytest.mark.parametrize(
    ("nominal", "commands", "is_remarked"),
    [(2e-8, {}, True), (3e-8, {}, False), (2e-8, {"rotor_speed_command": np.ones((3, 4))}, False)],
)
def test_a_prediction_prints_a_remark_if_nominal_values_differ_from_those_of_the_firmware(
    run,
    replaced,  # noqa: F811
    tmp_path,
    nominal,
    commands,
    is_remarked,
):
    """The command converts the logged thrust to rotor commands with `nominal`.

    After `identify --nominal`, this field contains estimates, which differ from the values in the firmware.
    """
    record = FlightRecord("log7", np.arange(3.0), thrust_command=np.ones(3), **commands)
    replaced("compare_log", read_log=record, predict=None, print_predictions=None)
    vehicle = "vehicle: {thrust_factor: {normal: {mean: 2e-8, standard_deviation: 1e-10, min: 1e-9}}}"
    (tmp_path / "mine.yaml").write_text(
        f"mine:\n  extends: vehicles/crazyflie\n  nominal: {{thrust_factor: {nominal}}}\n  {vehicle}\n"
    )
    result = run("compare-log", "log.csv", tmp_path / "mine.yaml", "--output", tmp_path)
    assert result.returncode == 0
    words = "`nominal` of mine, which has identified values (thrust_factor)"
    assert (words in result.stderr) == is_remarked


def test_a_vehicle_is_identified_with_the_given_options(run, replaced, tmp_path):  # noqa: F811
    time = np.arange(3.0)
    records = {
        "a.csv": FlightRecord("a", time, motor_command=np.full((3, 4), 0.5), vehicle="vehicles/hummingbird"),
        "b.csv": FlightRecord("b", time, vehicle="vehicles/hummingbird"),
    }
    motors = SimpleNamespace(take_throttles=True, voltage=11.1)
    vehicle = SimpleNamespace(vehicle=SimpleNamespace(motors=motors))
    actual = SimpleNamespace(estimates="estimates", vehicle=vehicle, training_vehicle="from the rest")
    predictions = SimpleNamespace(remark_on_worse_predictions=lambda vehicle: f"{vehicle} loses")
    prints = dict.fromkeys(
        ("print_logs", "print_estimates", "print_flights", "print_score", "print_hover", "print_predictions")
    )
    calls = replaced(
        "identify", read_log=lambda log, mapping: records[log.name], identify=actual, predict="prediction",
        concatenate_predictions=predictions, write_vehicle=None,
        save_figures=lambda figures, folder, vector: [*figures], **prints,
    )  # fmt: skip
    for name in ("fit", "residuals", "correlations", "predictions"):
        calls |= replaced("identify.plots", **{f"plot_{name}": name})
    calls |= replaced("identify.plots", plot_thrust=None)
    vehicle_file = tmp_path / "mine.yaml"
    options = ["--mapping", "map.yaml", "--mass", 0.55, "--set", "vehicle.linear_drag=0.1", "--output", vehicle_file]
    result = run("identify", "a.csv", "b.csv", "--wind", "1,0,0", *options)
    assert (result.returncode, result.stderr) == (0, "remark: identified loses\n")
    ((logs, base), named) = calls["identify"][0]
    assert [log.name for log in logs] == ["a", "b"]
    assert all((log.wind == [1.0, 0.0, 0.0]).all() for log in logs)
    assert (base.nominal.mass, base.vehicle.linear_drag) == (0.55, 0.1)
    assert named == {"held_out_fraction": pytest.approx(1.0 / 3.0)}
    assert [
        (log.name, [*vehicles.values()], keywords["final_fraction"]) for (log, vehicles), keywords in calls["predict"]
    ] == [(name, ["from the rest", base], pytest.approx(1.0 / 3.0)) for name in "ab"]
    assert all(keywords["nominal"] is base for _, keywords in calls["predict"])
    ((path, name, estimates), named) = calls["write_vehicle"][0]
    assert (path, name, estimates, named["base"]) == (vehicle_file, "mine", "estimates", "vehicles/hummingbird")
    assert named["nominal"] is False
    assert named["overrides"] == ["vehicle.linear_drag=0.1", "nominal.mass=0.55"]
    # The thrust curve refers to this voltage of the battery.
    assert named["voltage"] == 11.1
    # The weight that `print_hover` receives follows from the mass of the option --mass.
    (((_, weight), _),) = calls["print_hover"]
    assert weight == pytest.approx(0.55 * base.nominal.gravity)
    assert calls["print_predictions"] == [((predictions,), {})]
    assert "the initial vehicle is vehicles/hummingbird\n" in result.stdout
    written = [line.strip() for line in result.stdout.split("wrote\n")[1].splitlines()]
    # A thrust curve that was not identified is not plotted.
    assert written == [str(vehicle_file), "fit", "residuals", "correlations", "predictions"]
    (((_, commands), _),) = calls["plot_thrust"]
    assert commands.tolist() == [0.5] * 12
    # If the logs contain no throttles, the identified vehicle has motors of the same type as before.
    run("identify", "b.csv", *options, "--nominal")
    assert calls["write_vehicle"][1][1]["nominal"] is True
    assert calls["identify"][1][0][1].vehicle.motors.kind == "speed"


def test_an_initial_vehicle_with_a_distribution_is_refused():
    assert identify.load_initial_vehicle("hover", []).name == "hover"
    with pytest.raises(identify.InputError, match="robustness: .* is a distribution"):
        identify.load_initial_vehicle("robustness", [])


def test_input_warnings_are_printed_as_remarks_and_others_as_warnings(capsys, monkeypatch):
    shown_warnings = []
    monkeypatch.setattr(warnings, "showwarning", lambda *arguments: shown_warnings.append(arguments))

    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def command():
        # From here on, Ctrl-C raises KeyboardInterrupt, as usual in Python.
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        warnings.showwarning(InputWarning("rock.obj: is large"), InputWarning, "file.py", 3)
        warnings.showwarning(RuntimeWarning("of another kind"), RuntimeWarning, "file.py", 4)

    running.run(command)
    assert capsys.readouterr().err == "remark: rock.obj: is large\n"
    ((message, category, *where),) = shown_warnings
    assert (str(message), category, where) == ("of another kind", RuntimeWarning, ["file.py", 4])


def test_ctrl_c_during_imports_ends_a_command_with_one_sentence(capsys, monkeypatch):
    ended = []
    monkeypatch.setattr(interruption.os, "_exit", ended.append)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # In a worker process, the module installs no handler, because the parent process ends its workers.
    monkeypatch.setattr(multiprocessing, "current_process", lambda: SimpleNamespace(name="ForkProcess-1"))
    importlib.reload(interruption)
    assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL
    monkeypatch.setattr(multiprocessing, "current_process", lambda: SimpleNamespace(name="MainProcess"))
    importlib.reload(interruption)
    signal.raise_signal(signal.SIGINT)
    assert ended == [1]
    assert capsys.readouterr() == ("", "interrupted: no file was written\n")
    interruption.raise_interruptions()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_a_crash_is_printed_before_the_sensitivities(run, replaced, tmp_path):  # noqa: F811
    actual = SimpleNamespace(
        fields=("a",), values=np.ones(1), crash_time=1.25, metrics={"rmse": 0.5}, gradients={"rmse": np.ones(1)}
    )
    replaced("sensitivities", flight_sensitivities=actual, plot_sensitivities=None, save_figures=["b.png"])
    result = run("sensitivities", "hover", "--output", tmp_path)
    assert result.stdout.startswith("crashed at 1.25 s; metrics and derivatives refer to the flight until then\n")
    assert result.stdout.endswith(f"wrote\n  {tmp_path / 'sensitivities.csv'}\n  b.png\n")
    actual.crash_time = math.inf
    assert "crashed" not in run("sensitivities", "hover", "--output", tmp_path).stdout


def test_each_diagram_is_drawn_into_a_file_named_after_its_path(run, replaced, tmp_path):  # noqa: F811
    calls = replaced("draw", drawings={"": "a", "control/position": "b"}, svg=lambda text: f"<svg>{text}</svg>")
    result = run("draw", "robustness", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    files = [tmp_path / "loop.svg", tmp_path / "control_position.svg"]
    assert result.stdout.splitlines() == ["wrote", *(f"  {file}" for file in files)]
    assert [file.read_text() for file in files] == ["<svg>a</svg>", "<svg>b</svg>"]
    assert len(calls["drawings"]) == 1


@pytest.mark.slow
def test_a_controller_is_identified_from_a_log_and_written_as_a_layer(run, tmp_path):
    flown = load_scenario("onboard", ["duration=12"])
    simulate(flown, compiled=True).save(tmp_path)
    output = tmp_path / "controller.yaml"
    result = run("identify-controller", tmp_path / "flight.csv", "--vehicle", "onboard", "--output", output)
    assert result.returncode == 0
    assert result.stderr == "remark: the thrust is divided by the nominal mass, 0.68 kg\n"
    assert "z: the law explains 100.00 % of the variance of the command" in result.stdout
    position = load_scenario("onboard", layers=[f"{output}:controller"]).control.position
    assert position.k_p == pytest.approx(flown.control.position.k_p, rel=1e-6)
    options = "--vehicle", "onboard", "--mass", "0.9", "--output", output
    assert "nominal mass, 0.9 kg" in run("identify-controller", tmp_path / "flight.csv", *options).stderr
