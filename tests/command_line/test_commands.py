"""Tests of commands and development scripts, which run as if a user had started them."""

import csv
import importlib.util
import multiprocessing
import os
import re
import shutil
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from drake_quad import load_scenario
from drake_quad.command_line import tune
from drake_quad.command_line.identify import with_winds
from drake_quad.design.tuning import Budget
from drake_quad.identification import synthetic_flights
from drake_quad.logs.record import FlightRecord

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture
def without_figures(monkeypatch):
    """Make commands draw no figures, for tests of their printed output and their other files."""
    monkeypatch.setattr("drake_quad.visualization.plots.save_plots", lambda flight, folder, vector: [])
    monkeypatch.setattr("drake_quad.visualization.replay.page.save_replay", lambda flights, file: file)
    monkeypatch.setattr("drake_quad.command_line.study.save_plots", lambda studies, folder, arguments: [])
    monkeypatch.setattr("drake_quad.command_line.design.plot_steps", lambda loop: Figure())


@pytest.mark.long
def test_fly_prints_a_table_and_the_files_that_it_wrote(run, tmp_path):
    result = run("fly", "diagrams/figure_eight.yaml", "--set", "duration=2", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert re.search(r"^RMSE +\d+\.\d\d cm$", result.stdout, re.MULTILINE)
    written = [Path(line.strip()) for line in result.stdout.split("wrote\n")[1].splitlines()]
    assert len(written) == 9
    assert all(path.stat().st_size > 200 for path in written)


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_fly_simulates_an_x_layout(run, tmp_path):
    """An X layout flies as well as a plus layout with equal arms. The saved scenario equals the flown scenario."""
    short = ["diagrams/figure_eight.yaml", "--set", "duration=2", "--output"]
    plus = run("fly", *short, tmp_path / "plus")
    result = run("fly", *short, tmp_path / "x", "--set", "nominal.layout={kind: x}")
    assert (result.returncode, result.stderr) == (0, "")
    rmse = [float(re.search(r"^RMSE +(\S+) cm$", each.stdout, re.MULTILINE).group(1)) for each in (plus, result)]
    assert rmse[1] == pytest.approx(rmse[0], abs=0.05)
    saved = load_scenario(tmp_path / "x" / "scenario.yaml")
    assert (saved.nominal.layout.kind, saved.vehicle.layout.kind, saved.vehicle.arm_length) == ("x", "x", 0.17)


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        ("{kind: y}", "nominal.layout.kind is 'y', but must be"),
        ("{kind: x, length: 0.2}", "but must have width and length"),
        ("{kind: h, length: 0.2, width: -0.3}", "nominal.layout.width is -0.3, but must be"),
        ("{kind: x, length: 0.2, width: 0.000001}", "must produce thrust and all torques, but cannot produce"),
    ],
)
def test_fly_refuses_an_invalid_layout_in_one_sentence(run, tmp_path, layout, message):
    result = run("fly", "--set", f"nominal.layout={layout}", "--output", tmp_path / "out")
    assert (result.returncode, result.stdout) == (2, "")
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_fly_saves_the_learned_weights_of_a_network_for_another_flight(run, tmp_path):
    file, short = tmp_path / "learned.yaml", ["--set", "duration=1", "--set", "metrics.start=0", "--output", tmp_path]
    study = ["diagrams/paper.yaml:no_wind_pd_t2fnn", "--sample", 0, *short]
    result = run("fly", *study, "--save-network", file)
    assert (result.returncode, result.stderr) == (0, "")
    assert str(file) in result.stdout
    assert run("fly", *study, "--set", f"control.network.learned={file}").returncode == 0
    refused = run("fly", "diagrams/figure_eight.yaml", *short, "--save-network", file)
    assert refused.returncode == 2
    assert "--save-network requires a scenario with a network" in refused.stderr


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_fly_simulates_one_sample_of_a_study_in_the_wind(run, tmp_path):
    study = ["diagrams/laboratory.yaml:low_wind", "--set", "vehicle.mass={choice: [0.6, 0.7]}", "--set", "duration=2"]
    result = run("fly", *study, "--seed", 5, "--sample", 3, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert re.search(r"^sample +3 \(seed 5\)$", result.stdout, re.MULTILINE)
    assert (tmp_path / "wind.png").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_a_crash_is_reported_but_is_not_a_failure(run, tmp_path):
    result = run("fly", "--set", "control.position.k_p=[20,20,20]", "--output", tmp_path)
    assert result.returncode == 0
    assert re.search(r"^flight time +crashed at \d+\.\d\d s$", result.stdout, re.MULTILINE)
    assert "nan" not in result.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["diagrams/nothing.yaml"], "diagrams/nothing.yaml: cannot be read"),
        (["--set", "vehicle.mass=-1"], "error: --set vehicle.mass=-1: vehicle.mass is -1, but must be larger than 0"),
        (["--set", "route.top_acceleration=50", "--set", "route.top_speed=50"], "the rotors cannot fly this route"),
        (["--seed", "-1"], "error: --seed -1: seed is -1, but must be"),
        (["x" * 5000 + ".yaml"], ".yaml: cannot be read: file name too long"),
        (["--set", "vehicle.mass=" + "[" * 5000], "is nested too deeply"),
        (["--set", "vehicle.mass={choice: [0.6, 0.7]}"], "vehicle.mass is a distribution"),
        (["--sample", "-2"], "sample is -2, but must be at least 0"),
        (["diagrams/laboratory.yaml"], "error: diagrams/laboratory.yaml contains several scenarios; choose one as"),
        (
            ["--set", "vehicle.time_step=0.02"],
            "is 0.02, but must not be longer than the shortest period",
        ),
        (["--set", "vehicle.linear_drag=200"], "vehicle.time_step is 0.01 s, too long for drag with a time constant"),
        (
            ["--set", "vehicle.body_drag={linear: [0, 0, 200]}"],
            "vehicle.time_step is 0.01 s, too long for drag with a time constant",
        ),
        (
            ["--set", "vehicle.motors={kind: throttle, curve: [0, 1, 2]}"],
            "vehicle.motors.kind is 'throttle', but must be",
        ),
        (["--set", "control.position.k_p=1"], "control.position.k_p is 1, but must be a list"),
    ],
)
def test_invalid_input_is_reported_in_one_sentence_with_status_2(run, tmp_path, arguments, message):
    output = tmp_path / "out"
    result = run("fly", *arguments, "--output", output)
    assert result.returncode == 2
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert result.stdout == ""
    assert not output.exists() or not any(path.is_file() for path in output.rglob("*"))


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_plan_prints_the_active_limits_and_writes_a_trajectory_that_can_be_flown(run, tmp_path):
    waypoint_file = tmp_path / "course.csv"
    waypoint_file.write_text("x,y,z\n0,0,1\n1,1,1\n1,1,1\n2,0,1.5\n0,0,1\n", encoding="utf-8")
    result = run("plan", waypoint_file, "--output", tmp_path, "--vector", "svg")
    assert (result.returncode, result.stderr) == (0, "")
    assert re.search(r"^repeated +1 ", result.stdout, re.MULTILINE)
    assert re.search(r"^top acceleration +0\.700 m/s² of 0\.7$", result.stdout, re.MULTILINE)
    assert re.search(r"^active limits: acceleration on segments? \d", result.stdout, re.MULTILINE)
    written = [Path(line.strip()) for line in result.stdout.split("wrote\n")[1].splitlines()]
    assert [path.name for path in written] == [
        "trajectory.csv",
        "trajectory.yaml",
        "pieces.csv",
        "plan.png",
        "plan.svg",
    ]
    assert all(path.stat().st_size > 50 for path in written)
    loop = tmp_path / "loop.yaml"
    for route in ("trajectory.yaml", "pieces.csv"):
        loop.write_text(f"loop:\n  extends: [{ROOT / 'diagrams' / 'figure_eight.yaml'}, {route}]\n")
        result = run("fly", loop, "--set", "duration=1", "--output", tmp_path)
        assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["course.csv"], "course.csv: cannot be read"),
        (["diagrams/slalom.yaml", "--set", "route.top_speed=0"], "route.top_speed is 0, but must be larger than 0"),
        (["--set", "route.space={min: [1, -2, 0], max: [9, 3, 3]}"], "waypoint 0, .* lies outside the corridor"),
        (
            ["--set", "route.times=[0, 1, 2, 3, 4, 5, 6]"],
            "feasible if all durations are multiplied by|satisfies the derivatives given",
        ),
        (["diagrams/figure_eight.yaml", "--set", "rout=1"], "rout is unknown"),
        (["--set", "vehicle.mass=1.4"], "a plan does not depend on vehicle, only on name, route, nominal"),
        (["--set", "nominal.mass=3"], "the rotors cannot fly this route"),
    ],
)
def test_a_route_that_cannot_be_planned_is_reported_in_one_sentence_with_status_2(run, tmp_path, arguments, message):
    output = tmp_path / "out"
    result = run("plan", *arguments, "--output", output)
    assert result.returncode == 2
    assert re.search(message, result.stderr)
    assert len(result.stderr.splitlines()) == 1
    assert not any(path.is_file() for path in output.rglob("*"))


def test_an_unwritable_output_folder_is_refused_before_the_flight(run, tmp_path):
    (tmp_path / "file").write_text("in the way")
    result = run("fly", "--output", tmp_path / "file")
    assert result.returncode == 2
    assert "cannot write to the output folder" in result.stderr


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_design_prints_margins_and_writes_gains_that_a_scenario_can_extend(run, tmp_path):
    result = run("design", "--loop", "position.bandwidth=0.5", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    for axis in ("roll", "pitch", "yaw", "x", "y", "z"):
        assert re.search(rf"^{axis} .* \d\d\.\d° .* dB .* ms .* rad/s ", result.stdout, re.MULTILINE)
    assert re.search(r"^\d\.\d\d rad/s +0\.80 .* yaw", result.stdout, re.MULTILINE)
    for plot in ("bode", "nyquist", "root_locus", "steps"):
        assert (tmp_path / f"{plot}.png").exists()
    gains = (tmp_path / "gains.yaml").read_text(encoding="utf-8")
    assert gains.startswith("# drake-quad design --loop position.bandwidth=0.5")
    scenario_file = tmp_path / "mine.yaml"
    scenario_file.write_text(f"mine:\n  extends: [{ROOT}/diagrams/hover.yaml, gains.yaml]\n", encoding="utf-8")
    position = load_scenario(scenario_file).control.position
    assert (position.kind, position.k_p[0]) == ("pd", pytest.approx(0.15, abs=0.05))


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_design_writes_a_pid_that_a_scenario_can_extend(run, tmp_path):
    result = run("design", "--integral", "0.2", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    scenario_file = tmp_path / "mine.yaml"
    scenario_file.write_text(f"mine:\n  extends: [{ROOT}/diagrams/hover.yaml, gains.yaml]\n", encoding="utf-8")
    position = load_scenario(scenario_file).control.position
    assert (position.kind, position.feed_forward) == ("pid", "snap")
    assert re.search(rf"^z .* {position.k_i[2]:g} .* \d\d\.\d° ", result.stdout, re.MULTILINE)


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_design_includes_the_integral_of_an_existing_pid(run, tmp_path):
    pid = "control.position={kind: pid, k_p: [1, 1, 1], k_d: [1, 1, 1], k_i: [0, 0, 0]}"
    result = run("design", "--set", pid, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert "k_i: [0.0" in (tmp_path / "gains.yaml").read_text(encoding="utf-8")


ONBOARD = str(ROOT / "diagrams" / "onboard.yaml")
ATTITUDE_RESPONSE = [
    *("--set", "laboratory.autopilot={kind: response, natural_frequency: [6.8, 6.1, 3.0], damping: [0.5, 0.5, 0.7]}"),
    *("--set", "control.position.feed_forward=acceleration"),
]


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_design_lqg_prints_margins_and_writes_a_controller_that_a_scenario_can_extend(run, tmp_path, monkeypatch):
    monkeypatch.setattr("drake_quad.design.lqg._MAX_EVALUATIONS", 20)
    result = run("design-lqg", ONBOARD, "--sensitivity", "2.5", "--output", tmp_path)
    assert result.returncode == 0, result.stderr
    rows = {line.split()[0]: line.split() for line in result.stdout.splitlines() if line}
    assert {"thrust", "roll", "pitch"} <= rows.keys()
    assert "yaw" not in rows
    written = (tmp_path / "lqg.yaml").read_text()
    assert written.startswith("# drake-quad design-lqg ")
    scenario_file = tmp_path / "mine.yaml"
    scenario_file.write_text(f"mine: {{extends: [{ROOT / ONBOARD}, lqg.yaml]}}\n")
    assert load_scenario(scenario_file).control == load_scenario(tmp_path / "scenario.yaml").control
    assert load_scenario(scenario_file).control.kind == "lqg"


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_tune_reduces_the_error_and_prints_the_remaining_margins(run, tmp_path, monkeypatch):
    monkeypatch.setattr(tune, "Budget", partial(Budget, candidates=32, limit_evaluations=2, local_search_steps=4))
    soft = ["diagrams/laboratory.yaml:low_wind", "--controller", "diagrams/gains/laboratory.yaml"]
    soft += ["--set", "duration=3", "--rounds", "1", "--samples", "1"]
    loose = ["--sensitivity", "20", "--delay-margin", "0.002", "--output", tmp_path]
    result = run("tune", *soft, *loose)
    assert (result.returncode, result.stderr) == (0, "")
    before, after = re.search(
        r"^RMSE on 32 held-out samples +(\S+) cm +(\S+) cm$", result.stdout, re.MULTILINE
    ).groups()
    assert float(after) < 0.7 * float(before)
    assert re.search(r"^tau_y +\d+\.\d\d +\d+ ms", result.stdout, re.MULTILINE)
    gains = load_scenario(tmp_path / "scenario.yaml").control.position
    assert gains.k_p[0] == gains.k_p[1] != gains.k_p[2]
    assert gains.k_d[0] == gains.k_d[1] != gains.k_d[2]


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_judge_flies_the_designs_and_writes_a_report(run, tmp_path):
    two_controllers = ["--family", "laboratory", "--only", "pd", "--only", "pd_t2fnn"]
    result = run("judge", "--quick", *two_controllers, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert re.search(r"^PD( +\d+\.\d+){3}$", result.stdout, re.MULTILINE)
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "adding a type-2 network to PD reduces the error" in report
    assert (tmp_path / "figures" / "errors.png").exists()
    rows = csv.DictReader((tmp_path / "summary.csv").read_text(encoding="utf-8").splitlines())
    assert {row["controller"] for row in rows} == {"pd", "pd_t2fnn"}


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_design_includes_the_loops_on_board_and_the_position_loop(run, tmp_path):
    result = run("design", ONBOARD, "--on-board", "--phase-margin", "65", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    rows = re.findall(r"^(\w+(?: rate)?) .* (\d\d\.\d)° .* dB .* ms .* rad/s ", result.stdout, re.MULTILINE)
    on_board = [name for angle in ("roll", "pitch", "yaw") for name in (f"{angle} rate", angle)]
    assert [name for name, _ in rows] == [*on_board, "z", "x", "y"]
    assert min(float(phase) for _, phase in rows) >= 65.0
    for plot in ("bode", "nyquist", "root_locus", "steps"):
        assert (tmp_path / f"{plot}.png").exists()
    scenario_file = tmp_path / "mine.yaml"
    scenario_file.write_text(f"mine:\n  extends: [{ONBOARD}, gains.yaml]\n", encoding="utf-8")
    before, after = load_scenario(ONBOARD), load_scenario(scenario_file)
    assert after.laboratory.autopilot.k_rate[0] < before.laboratory.autopilot.k_rate[0]
    assert after.control.position.k_p[0] != before.control.position.k_p[0]
    assert after.control.attitude is None


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_only_position_gains_are_designed_for_an_attitude_response(run, tmp_path):
    result = run("design", ONBOARD, *ATTITUDE_RESPONSE, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert re.findall(r"^(\w+) .* \d\d\.\d° ", result.stdout, re.MULTILINE) == ["z", "x", "y"]
    assert "attitude:" not in (tmp_path / "gains.yaml").read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_a_vehicle_without_a_controller_flies_with_gains_that_are_designed_for_it(run, tmp_path):
    vehicle = (
        "{nominal: {mass: 0.5, inertia: [0.003, 0.0032, 0.006], thrust_factor: 3.0e-5, drag_factor: 8.5e-7,"
        " arm_length: 0.17, rotor_inertia: 6.5e-5, min_rotor_speed: 60.0, max_rotor_speed: 300.0},"
        " vehicle: {battery_sag: {uniform: {min: 0.0, max: 0.02}}}}"
    )
    (tmp_path / "vehicle.yaml").write_text(f"small: {vehicle}\n", encoding="utf-8")
    result = run("design", tmp_path / "vehicle.yaml", "--output", tmp_path / "gains")
    assert (result.returncode, result.stderr) == (
        0,
        "remark: the gains are designed for the median of each distribution\n",
    )
    command = re.search(r"drake-quad study (\S+) --samples 32", result.stdout)
    assert run("fly", command[1], "--sample", 3, "--output", tmp_path / "flight").returncode == 0
    with (tmp_path / "flight" / "metrics.csv").open() as file:
        (metrics,) = csv.DictReader(file)
    assert float(metrics["rmse"]) < 0.1
    scenario = load_scenario(command[1])
    assert (scenario.vehicle.mass, scenario.route.kind) == (0.5, "figure_eight")
    assert scenario.vehicle.battery_sag.uniform.max == 0.02


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_map_prints_the_fraction_of_stable_gains_and_draws_a_figure(run, tmp_path):
    result = run("map", "--quick", "--loop", "attitude", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert re.search(r"^nominal: \d+ % of the gains are stable, \d+ % do not crash", result.stdout, re.MULTILINE)
    assert len((tmp_path / "attitude_map.csv").read_text(encoding="utf-8").splitlines()) == 1 + 12 * 12
    assert (tmp_path / "attitude_map.png").exists()


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_map_varies_the_gains_on_board_if_an_autopilot_controls_the_attitude(run, tmp_path):
    result = run(
        *("map", ONBOARD, "--loop", "attitude", "--size", "3", "--set", "duration=1"),
        *("--k-attitude", "4", "40", "--k-rate", "5", "15", "--output", tmp_path),
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert re.search(r"^nominal: 33 % of the gains .* at k_attitude = 4, k_rate = \d+$", result.stdout, re.MULTILINE)
    header, *rows = (tmp_path / "attitude_map.csv").read_text(encoding="utf-8").splitlines()
    assert header.startswith("k_attitude (1/s),k_rate (1/s),nominal: stable,")
    assert [row.split(",")[:3] for row in rows[2:4]] == [["4", "15", "1"], ["22", "5", "0"]]


@pytest.mark.long
@pytest.mark.usefixtures("unrendered_figures")
def test_a_map_may_contain_gains_and_errors_of_zero(run, tmp_path):
    """A warning about the logarithm of zero would fail the test."""
    result = run(
        *("map", "diagrams/hover.yaml", "--size", "3", "--set", "duration=0.2"),
        *("--k-p", "0", "1", "--k-d", "0", "1", "--output", tmp_path),
    )
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.long
@pytest.mark.usefixtures("unrendered_figures")
@pytest.mark.parametrize(
    ("wind", "remark"),
    [
        ("[{kind: dryden}]", ""),
        (
            "[{kind: steady, velocity: [0, 0, 0]}]",
            "remark: laboratory.wind.0 has no effect, since laboratory.wind.0.velocity is [0, 0, 0]\n",
        ),
    ],
)
def test_wind_with_a_mean_of_zero_is_plotted(run, tmp_path, wind, remark):
    changes = ("duration=0.5", "vehicle.linear_drag=0.1", f"laboratory.wind={wind}")
    arguments = ["diagrams/hover.yaml", *(part for change in changes for part in ("--set", change))]
    result = run("fly", *arguments, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, remark)


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_a_zero_metric_has_no_sensitivities(run, tmp_path):
    result = run(
        "sensitivities", "diagrams/hover.yaml", "--field", "vehicle.mass", "--set", "duration=0.5", "--output", tmp_path
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert "rmse has no derivative, because it is zero in this flight" in result.stdout


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_compare_prints_a_line_for_each_scenario_and_controller(run, tmp_path):
    controllers = ROOT / "diagrams" / "controllers" / "paper.yaml"
    pair = ["--controller", f"{controllers}:pd", "--controller", f"{controllers}:pd_t2fnn"]
    result = run("compare", "--quick", "--scenario", "diagrams/hover.yaml", *pair, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    result = run(
        *("compare", "--scenario", "diagrams/laboratory.yaml:low_wind", *pair, "--samples", "3"),
        *("--set", "duration=6", "--output", tmp_path),
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert re.search(r"^low_wind +pd +\d+\.\d+ ± \d\.\d+ cm .* 100 %$", result.stdout, re.MULTILINE)
    assert re.search(r"^low_wind +pd_t2fnn .* \d\d\.\d+ % \[\d+\.\d+, \d+\.\d+\]$", result.stdout, re.MULTILINE)
    assert len((tmp_path / "comparison.csv").read_text(encoding="utf-8").splitlines()) == 1 + 2 * 3
    assert (tmp_path / "comparison.png").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_the_learning_of_a_network_is_plotted(run, tmp_path):
    scenario_file = tmp_path / "mine.yaml"
    bases = f"[{ROOT}/diagrams/laboratory.yaml:nominal, {ROOT}/diagrams/controllers/paper.yaml:pd_t2fnn]"
    scenario_file.write_text(f"mine:\n  extends: {bases}\n  duration: 3\n", encoding="utf-8")
    result = run("fly", scenario_file, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    for name in ("learning", "surfaces", "secant_gains"):
        assert (tmp_path / f"{name}.png").exists()
    header = (tmp_path / "flight.csv").read_text(encoding="utf-8").splitlines()[0]
    columns = header.split(",")
    assert columns[0] == "time (s)"
    assert {"state.roll (rad)", "rotor_speed.rotor_4 (rad/s)", "wrench.tau_z (N m)"} <= set(columns)
    assert {"weights.18 (m/s²)", "covariance_trace.2 (1/s)"} <= set(columns)


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_sensitivities_are_sorted_by_effect(run, tmp_path):
    fields = ["--field", "vehicle.arm_length", "--field", "vehicle.mass", "--set", "duration=2"]
    result = run("sensitivities", *fields, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    names = re.findall(r"^(vehicle\.\w+) .* % *$", result.stdout, re.MULTILINE)
    assert names == ["vehicle.mass", "vehicle.arm_length"]
    assert (tmp_path / "sensitivities.png").exists()


@pytest.mark.parametrize(
    ("script", "arguments", "message"),
    [
        ("tune", ["--rounds", "0"], "--rounds is 0, but must be between 1 and 200"),
        (
            "tune",
            ["--tune", "vehicle.mass"],
            "--tune vehicle.mass must name a field of `control` whose value is a number above 0",
        ),
        ("tune", ["--tune", "control.position.kind"], "must name a field of `control` whose value is a number above 0"),
        ("tune", ["--tune", "control.position.k_q"], "the scenario has no field control.position.k_q"),
        (
            "tune",
            ["--tune", "control.position.k_p.0=3:1"],
            "the range 3:1, but LOW must be above 0 and HIGH above LOW",
        ),
        ("tune", ["--tune", "control.position.k_p.0=3"], "the range 3; write it as LOW:HIGH with two numbers"),
        ("judge", ["--samples", "1"], "--samples is 1, but must be between 2 and 10000"),
        ("judge", ["--tune", "outdoor", "--only", "lqg"], "there is no tunable controller lqg"),
        ("design-lqg", ["--sensitivity", "1"], "--sensitivity is 1, but must be between 1.2 and 10"),
        ("design-lqg", ["--delay-margin", "-1"], "--delay-margin is -1, but must be between 0 and 10"),
        ("design-lqg", ["--snap", "0"], "--snap is 0, but must be between 0.1 and 10000"),
        ("design-lqg", ["--acceleration", "0"], "--acceleration is 0, but must be between 0.01 and 1000"),
        (
            "design",
            ["--phase-margin", "85"],
            "no gains of this family meet the requirements for roll; closest result: phase",
        ),
        ("design", ["--loop", "attitude.bandwidth=5"], "roll cannot have a bandwidth of 5 rad/s: phase margin"),
        ("design", ["--method", "lqr", "--loop", "yaw.bandwidth=1"], "--loop yaw.bandwidth requires --method poles"),
        ("design", ["--on-board"], "laboratory.autopilot is of kind none, which has no gains; use kind attitude"),
        (
            "design",
            [ONBOARD, "--loop", "yaw.bandwidth=1"],
            "--loop yaw.bandwidth belongs to attitude control on the ground",
        ),
        ("design", [ONBOARD, "--delay-margin", "2"], "--delay-margin belongs to attitude control on the ground"),
        (
            "map",
            [ONBOARD, *ATTITUDE_RESPONSE, "--quick", "--loop", "attitude"],
            "cannot map the attitude: laboratory.autopilot is of kind response, which has no gains",
        ),
        ("map", ["--size", "1"], "--size is 1, but must be between 2 and 200"),
        ("map", ["--quick", "--worst", "control.position.k_p.0=3"], "must change a field of vehicle or lab"),
        (
            "map",
            ["--quick", "--worst", "vehicle.mas=1"],
            "--worst vehicle.mas=1: vehicle.mas is unknown",
        ),
        ("map", ["--quick", "--worst", "vehicle.mass=5"], "the rotors cannot hold figure_eight in hover"),
        ("compare", ["--samples", "0"], "--samples is 0, but must be between 1 and 10000"),
        ("compare", ["--controller", "diagrams/none.yaml:pd"], "diagrams/none.yaml: cannot be read"),
        ("sensitivities", ["--field", "vehicle.wings"], "the scenario has no field vehicle.wings"),
        ("sensitivities", ["--field", "vehicle"], "vehicle is a mapping or list, but must be a real number"),
    ],
)
def test_analyses_refuse_wrong_input_in_one_sentence(run, tmp_path, script, arguments, message):
    result = run(script, *arguments, "--output", tmp_path / "out")
    assert result.returncode == 2
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert result.stdout == ""
    assert not list(tmp_path.rglob("*.*"))


def monte_carlo(run, folder, *arguments):
    short = ("--set", "duration=0.4", "--samples", 6, "--workers", 1, "--output", folder)
    return run("study", "diagrams/robustness.yaml", *short, *arguments)


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_study_prints_the_statistics_of_its_samples(run, tmp_path):
    result = monte_carlo(run, tmp_path, "--seed", 3)
    assert (result.returncode, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert lines[0].startswith(
        "robustness: 6 samples of seed 3, 0.40 s each, diagrams compiled; 0 crashed, 0 % [0, 46]"
    )
    assert re.fullmatch(r"simulation speed: [\d,]+ vehicle-seconds per second", lines[-1])
    files = {path.name for path in tmp_path.iterdir()}
    assert {"results.csv", "scenario.yaml", "study.yaml", "distribution.png", "influences.png"} <= files
    again = monte_carlo(run, tmp_path, "--seed", 3, "--resume")
    assert again.stdout.splitlines()[-1] == "all samples had already been flown"


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_study_names_correlated_random_parameters(run, tmp_path):
    shared = "vehicle.{}={{normal: {{mean: {}, standard_deviation: {}, min: 0.0001, shared: {{a: {}}}}}}}"
    mass, drag = shared.format("mass", 0.68, 0.02, 0.9), shared.format("linear_drag", 0.2, 0.05, -0.5)
    result = monte_carlo(run, tmp_path, "--set", mass, "--set", drag)
    assert (result.returncode, result.stderr) == (0, "")
    words = "random parameters are correlated (vehicle.mass and vehicle.linear_drag: -0.45), so the influence of a"
    assert words in result.stdout
    assert "are correlated" not in monte_carlo(run, tmp_path / "none").stdout


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_the_printed_fly_command_repeats_the_flight_of_a_worst_sample(run, tmp_path):
    """The metrics of the repeated flight agree with the results of the study to 1e-9."""
    result = monte_carlo(run, tmp_path, "--seed", 3)
    command = re.search(r"drake-quad (fly) (\S+) --sample (\d+)", result.stdout)
    again = run(command[1], command[2], "--sample", command[3], "--output", tmp_path)
    assert again.returncode == 2
    assert "scenario.yaml does not belong to a flight and would be overwritten" in again.stderr
    assert run(command[1], command[2], "--sample", command[3], "--output", tmp_path / "flight").returncode == 0
    with (tmp_path / "results.csv").open() as file:
        row = next(row for row in csv.DictReader(file) if row["sample"] == command[3])
    with (tmp_path / "flight" / "metrics.csv").open() as file:
        (metrics,) = csv.DictReader(file)
    assert len(metrics) == 13
    for name, value in metrics.items():
        assert row[name] == value or float(row[name]) == pytest.approx(float(value), rel=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_the_worst_samples_are_crashes_and_are_printed_with_their_obstacles(run, tmp_path):
    scenario = tmp_path / "pillars.yaml"
    scenario.write_text(
        "pillars:\n  extends: hover\n  duration: 0.4\n  vehicle: {linear_drag: {uniform: {min: 0.0, max: 1.0}}}\n"
        "  laboratory: {wind: [{kind: steady, velocity: [3.0, 0.0, 0.0]}]}\n"
        "  space: {obstacles: {pillar: {kind: cylinder, centre: [0.46, 0.0, 1.0], radius: 0.13, height: 1.0}}}\n"
    )
    result = run("study", scenario, "--samples", 6, "--workers", 1, "--output", tmp_path / "study")
    assert result.returncode == 0
    ends = re.findall(r"^  (.*?) +drake-quad fly", result.stdout.split("worst samples:")[1], re.MULTILINE)
    crashed = [end for end in ends if end.startswith("crashed")]
    assert len(ends) == 5
    assert 0 < len(crashed) < 5
    assert all(re.fullmatch(r"crashed into pillar at 0\.\d\d s", end) for end in crashed)
    assert all(re.fullmatch(r"\d+\.\d cm", end) for end in ends[len(crashed) :])


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_study_compares_controllers_on_the_same_samples(run, tmp_path):
    chosen = [word for name in ("pd", "pid") for word in ("--controller", f"diagrams/controllers/paper.yaml:{name}")]
    result = monte_carlo(run, tmp_path, *chosen)
    assert (result.returncode, result.stderr) == (0, "")
    assert "paired comparison with pd on the same samples:" in result.stdout
    for name in ("pd", "pid"):
        assert load_scenario(tmp_path / name / "scenario.yaml").control.position.kind == name
        assert (tmp_path / f"influences_{name}.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--samples", 0], "samples is 0"),
        (["--workers", -2], "workers is -2"),
        (["--batch", 0], "batch_size is 0"),
        (["--seed", -1], "seed"),
        (["--output", "/proc/nowhere"], "cannot write to the output folder"),
        (["--set", "route.radius={uniform: {min: 1.2, max: 1.4}}"], "route.radius is a distribution"),
    ],
)
def test_study_refuses_input_that_it_cannot_fly(run, tmp_path, arguments, message):
    result = monte_carlo(run, tmp_path / "study", *arguments)
    assert result.returncode == 2
    assert message in result.stderr
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize("name", ["..", ".", "a b"])
def test_a_controller_whose_name_is_not_a_valid_folder_name_is_refused(run, tmp_path, name):
    """A folder that is named `..`, for example, would be the parent folder."""
    file = tmp_path / "controllers.yaml"
    file.write_text(f"{{'{name}': {{control: {{thrust_vectoring: {{max_tilt: 0.5}}}}}}}}\n")
    result = monte_carlo(run, tmp_path / "study", "--controller", f"{file}:{name}")
    assert result.returncode == 2
    assert re.fullmatch(
        r"error: --controller \S+:.*: '.*' cannot be the name of a folder; rename the controller\n", result.stderr
    )
    assert [path.name for path in tmp_path.iterdir()] == ["controllers.yaml"]


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_a_study_reports_altered_rows_that_it_flew_again(run, tmp_path):
    monte_carlo(run, tmp_path)
    path = tmp_path / "results.csv"
    before = path.read_text()
    path.write_text(re.sub(r"^(3,\d\.\d+)\d,", r"\g<1>,", before, flags=re.MULTILINE))
    assert path.read_text() != before
    result = monte_carlo(run, tmp_path, "--resume")
    assert (result.returncode, path.read_text()) == (0, before)
    assert result.stderr == f"remark: {path}: lines 5 had been altered, so their samples were flown again\n"


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_study_remarks_on_a_scenario_without_distributions(run, tmp_path):
    options = ("--set", "duration=0.2", "--samples", 3, "--workers", 1, "--output", tmp_path)
    result = run("study", "diagrams/figure_eight.yaml", *options)
    assert result.returncode == 0
    assert result.stderr.startswith("remark: figure_eight has no distribution")


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_an_existing_study_is_neither_overwritten_nor_mixed_with_another(run, tmp_path):
    assert monte_carlo(run, tmp_path).returncode == 0
    before = (tmp_path / "results.csv").read_bytes()
    for arguments, words in (([], "already contains a study"), (["--resume", "--seed", 9], "its seed is 0, not 9")):
        result = monte_carlo(run, tmp_path, *arguments)
        assert result.returncode == 2
        assert words in result.stderr
    assert (tmp_path / "results.csv").read_bytes() == before


def test_calibrate_paper_refuses_too_few_samples(run, tmp_path):
    result = run("calibrate_paper.py", "--samples", 1, "--output", tmp_path / "folder")
    assert (result.returncode, result.stderr) == (2, "error: --samples is 1, but must be between 2 and 10000\n")
    assert not (tmp_path / "folder").exists()


@pytest.mark.long
@pytest.mark.usefixtures("unrendered_figures")
def test_a_study_in_which_all_samples_crash_is_printed(run, tmp_path):
    result = monte_carlo(run, tmp_path, "--set", "crash.position_error=0.001")
    assert (result.returncode, result.stderr) == (0, "")
    assert "6 crashed, 100 % [54, 100]" in result.stdout
    assert "nan" not in result.stdout
    assert "crashed at 0.1" in result.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_fly_shows_the_flight_live(run, tmp_path):
    study = ["diagrams/laboratory.yaml:low_wind", "--set", "duration=1", "--output", tmp_path]
    result = run("fly", *study, "--meshcat", "--rate", 0)
    assert (result.returncode, result.stderr) == (0, "")
    assert re.search(r"^open http://127\.0\.0\.1:\d+ in a browser on this machine$", result.stdout, re.MULTILINE)
    result = run("fly", *study, "--meshcat", "--rate", -1)
    assert (result.returncode, result.stderr) == (2, "error: --rate is -1, but must be between 0 and 1000000\n")


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_replay_writes_one_page_for_several_samples_or_several_controllers(run, tmp_path):
    study = ["diagrams/laboratory.yaml:low_wind", "--set", "duration=1", "--output"]
    result = run("replay", *study, tmp_path / "swarm", "--samples", 3)
    assert (result.returncode, result.stderr) == (0, "")
    assert "low_wind: 3 flights, 0 crashed" in result.stdout
    controllers = [f"--controller=diagrams/controllers/paper.yaml:{name}" for name in ("pd", "pd_t2fnn")]
    result = run("replay", *study, tmp_path / "two", "--samples", 1, *controllers)
    assert (result.returncode, result.stderr) == (0, "")
    pages = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.html")}
    assert pages == {"swarm/replay.html", "two/replay.html"}
    assert run("replay", *study, tmp_path, "--samples", 0).returncode == 2


@pytest.mark.skipif(shutil.which("dot") is None, reason="no Graphviz on PATH; Debian's package is graphviz")
def test_draw_draws_the_loop_and_its_inner_diagrams(run, tmp_path):
    result = run("draw", "diagrams/hover.yaml", "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert {path.stem for path in tmp_path.iterdir()} >= {"loop", "control", "laboratory"}


def test_missing_graphviz_is_reported_in_one_sentence(run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    result = run("draw", "diagrams/hover.yaml", "--output", tmp_path)
    assert result.returncode == 2
    assert re.fullmatch(r"error: .*Graphviz.* is not on PATH; install Graphviz .*\n", result.stderr)


@pytest.fixture
def forked(monkeypatch):
    """Let benchmarks fork their processes, which then need not import and compile everything again."""
    monkeypatch.setenv("SCIPY_ARRAY_API", "1")
    monkeypatch.setattr(os, "sched_setaffinity", lambda process, cores: None, raising=False)
    # crazyflow must be imported before SciPy, which is possible only in a spawned process.
    if "fork" in multiprocessing.get_all_start_methods() and importlib.util.find_spec("crazyflow") is None:
        fork = multiprocessing.get_context("fork")
        monkeypatch.setattr(multiprocessing, "get_context", lambda method: fork)


@pytest.mark.long
@pytest.mark.usefixtures("forked")
def test_installed_simulators_are_compared(run):
    result = run("compare_simulators.py", "--quick")
    assert result.returncode == 0
    assert re.search(
        r"^\| drake_quad \S+, compiled, 100 Hz.* \| [\d,.]+ \([\d,.]+\) \| [\d,.]+ \([\d,.]+\) \|$", result.stdout, re.M
    )
    for package in ("crazyflow", "rotorpy"):
        is_reported = f"{package} is not installed, so it is not measured" in result.stderr
        assert is_reported != bool(re.search(rf"^\| {package} ", result.stdout, re.MULTILINE))


@pytest.mark.long
@pytest.mark.usefixtures("forked")
def test_installed_environments_are_compared(run):
    result = run("compare_environments.py", "--quick")
    assert result.returncode == 0
    assert re.search(r"^\| drake_quad, everything \| [\d,]+ \|$", result.stdout, re.M)
    reports_missing = "crazyflow is not installed, so it is not measured" in result.stderr
    assert reports_missing != bool(re.search(r"^\| crazyflow ", result.stdout, re.MULTILINE))
    first, last = map(float, re.search(r"peak ([\d.]+) MB .*, ([\d.]+) MB in total", result.stdout).groups())
    assert last - first < 12.0


def test_the_shipped_raptor_weights_equal_those_of_its_package(run, tmp_path):
    pytest.importorskip("foundation_policy")
    result = run("write_raptor.py", "--output", str(tmp_path))
    assert result.returncode == 0, result.stderr
    with np.load(tmp_path / "raptor.npz") as actual, np.load(ROOT / "diagrams" / "policies" / "raptor.npz") as shipped:
        assert actual.files == shipped.files
        for name in actual.files:
            np.testing.assert_array_equal(actual[name], shipped[name])


CRAZYFLIE_LOG = "tests/data/crazyflie/crazyswarm2/log100.xz"
PX4_LOG = "tests/data/px4/sample_px4_events.ulg.xz"


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "cached_results")
def test_the_shipped_crazyswarm2_vehicle_can_be_identified_again(run, tmp_path):
    """The vehicle that the script identifies from a log agrees with the shipped file to 2 %."""
    result = run("identify_crazyswarm2.py", "--log", "180", "--output", tmp_path / "mine.yaml")
    assert result.returncode == 0
    assert load_scenario(f"{tmp_path / 'mine.yaml'}:log180").name == "log180"
    assert re.search(r"^log180 +rotor_time_constant +0\.05", result.stdout, re.MULTILINE)
    lines = [
        (path.read_text(encoding="utf-8").partition("\nlog180:")[2]).splitlines()
        for path in (tmp_path / "mine.yaml", ROOT / "diagrams" / "crazyswarm2.yaml")
    ]
    # The centre of mass is only about 30 µm off the origin in log180, so its tolerance is absolute, 2 µm.
    atol = 0.0
    for new_line, shipped_line in zip(*lines, strict=True):
        if new_line.endswith(":"):
            atol = 2e-6 if "centre_of_mass" in new_line else 0.0
        identified, expected = (
            [float(number) for number in re.findall(r"(?<![\w.])-?\d+\.\d+(?:e-?\d+)?", line.partition("shared")[0])]
            for line in (new_line, shipped_line)
        )
        np.testing.assert_allclose(identified, expected, rtol=0.02, atol=atol)


def test_a_partial_identification_does_not_overwrite_the_shipped_crazyflies(run):
    shipped = (ROOT / "diagrams" / "crazyswarm2.yaml").read_bytes()
    result = run("identify_crazyswarm2.py", "--log", "180")
    sentence = "error: --log: the shipped file contains all four logs; use --output to write fewer to another file\n"
    assert (result.returncode, result.stderr) == (2, sentence)
    assert (ROOT / "diagrams" / "crazyswarm2.yaml").read_bytes() == shipped


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "cached_results")
def test_a_vehicle_is_identified_written_and_flown(run, tmp_path):
    vehicle_file = tmp_path / "mine.yaml"
    result = run("identify", CRAZYFLIE_LOG, "--mass", "0.0375", "--output", vehicle_file, "--name", "log_100")
    assert result.returncode == 0
    assert re.search(r"^thrust_factor +3\.0\d+e-08 ± ", result.stdout, re.MULTILINE)
    # For each parameter, the table states how many estimates from held-out segments lie within the interval.
    num_within = re.findall(r"  (\d+) of 10\b", result.stdout)
    assert len(num_within) >= 8
    assert min(map(int, num_within)) >= 9
    assert re.search(r"^position +0\.5 s ", result.stdout, re.MULTILINE)
    assert "remark: log100: 1 gap" in result.stderr
    written = [Path(line.strip()) for line in result.stdout.split("wrote\n")[1].splitlines()]
    assert [path.name for path in written] == [
        "mine.yaml",
        "fit.png",
        "residuals.png",
        "correlations.png",
        "predictions.png",
    ]
    assert all(path.stat().st_size > 50 for path in written)
    loop = tmp_path / "loop.yaml"
    gains = ROOT / "diagrams" / "hover.yaml"
    loop.write_text(f"loop:\n  extends: [{gains}, mine.yaml]\n  vehicle: {{time_step: 0.0025}}\n")
    assert load_scenario(loop).nominal.mass == 0.0375


def test_intervals_that_contain_the_true_value_are_counted(run, tmp_path):
    """The file contains the results of all flights, so the script simulates none.

    In the second flight only the inertia was identified, and in the third flight nothing.
    """
    path = tmp_path / "wind.csv"
    rows = ["0,inertia[0],1.0,1.2,0.1,inf", "0,linear_drag,0.1,0.3,0.1,inf", "1,inertia[0],1.0,0.9,0.1,inf", "2,,,,,"]
    header = ["# wind seed=11", "sample,name,true,value,deviation,degrees_of_freedom"]
    path.write_text("\n".join([*header, *rows, ""]), encoding="utf-8")
    result = run("check_identification.py", "wind", "--samples", "3", "--output", path)
    assert (result.returncode, result.stderr) == (0, "")
    lines = [line.split() for line in result.stdout.splitlines() if "of" in line.split()]
    assert result.stdout.startswith("3 flights")
    # The two estimates of the inertia have errors of 0.2 and -0.1, with mean 0.05 and standard deviation 0.15.
    assert lines[0] == ["inertia[0]", "1", "of", "2", "50", "%", "[1,", "99]", "+0.33", "0.63", "0.16", "1"]
    assert lines[1][:4] == ["linear_drag", "0", "of", "1"]
    assert lines[1][-1] == "2"
    assert path.read_text(encoding="utf-8").count("\n") == 6


def second_flight(task):
    """Return the identification of the second flight; worker processes import this function."""
    assert task.samples == [1]
    return {1: [synthetic_flights.CheckedParameter("autopilot.damping[0]", 0.5, 0.6, 0.1, 30.0)]}


@pytest.mark.long
def test_check_identification_recovers_a_known_vehicle_and_adds_only_missing_samples(run, tmp_path, monkeypatch):
    path, short = tmp_path / "autopilot.csv", ("--set", "duration=14")
    result = run("check_identification.py", "autopilot", "--samples", "1", *short, "--output", path)
    assert result.returncode == 0
    assert re.search(r"^autopilot.damping\[0\] +[01] of 1 ", result.stdout, re.MULTILINE)
    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()[2:]]
    assert len(rows) > 8
    relative_errors = [abs(float(value) - float(true)) / float(deviation) for _, _, true, value, deviation, _ in rows]
    assert max(relative_errors) < 5.0
    done = path.read_bytes()
    again = run("check_identification.py", "autopilot", "--samples", "1", *short, "--output", path)
    assert (again.returncode, again.stdout, path.read_bytes()) == (0, result.stdout, done)
    monkeypatch.setattr(synthetic_flights, "check_batch", second_flight)
    repeated = run("check_identification.py", "autopilot", "--samples", "2", *short, "--output", path)
    assert repeated.returncode == 0
    (added,) = path.read_bytes().removeprefix(done).splitlines()
    assert added.startswith(b"1,autopilot.damping[0],")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["wind", "--samples", "0"], "--samples is 0, but must be between 1"),
        (["wind", "--output", "mine.txt"], "--output mine.txt: the name must end in .csv"),
        (["wind", "--set", "vehicle.mas=1"], "vehicle.mas"),
        (["wind", "--output", "other.csv"], "the file is truncated or was not written by this script"),
        (["wind", "--output", "cut.csv"], "the file is truncated or was not written by this script"),
        (["wind", "--output", "row.csv"], "the file is truncated or was not written by this script"),
        (["wind", "--output", "binary.csv"], "the file is truncated or was not written by this script"),
        (
            ["wind", "--seed", "12", "--output", "before.csv"],
            "contains flights of 'wind seed=11', not of 'wind seed=12'",
        ),
    ],
)
def test_check_identification_refuses_invalid_arguments_in_one_sentence_with_status_2(
    run, tmp_path, arguments, message
):
    (tmp_path / "other.csv").write_text("time,x\n0,1\n", encoding="utf-8")
    header = "# wind seed=11\nsample,name,true,value,deviation,degrees_of_freedom\n"
    (tmp_path / "before.csv").write_text(header, encoding="utf-8")
    (tmp_path / "cut.csv").write_text(f"{header}0,inertia[0],1.0,1.2,0.1,2", encoding="utf-8")
    (tmp_path / "row.csv").write_text(f"{header}0,inertia[0],1.0\n", encoding="utf-8")
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)))
    paths_and_options = [str(tmp_path / each) if (tmp_path / each).is_file() else each for each in arguments]
    result = run("check_identification.py", *paths_and_options)
    assert result.returncode == 2
    assert message in result.stderr.splitlines()[-1]


def test_the_wind_option_applies_to_logs_without_wind(capsys):
    time = np.array([0.0, 0.1])
    without_wind, with_wind = FlightRecord("still", time), FlightRecord("logged", time, wind=np.ones((2, 3)))
    for winds in (["-8.5,0,0.25"], ["-8.5,0,0.25", "1,2,3"]):
        result = with_winds([without_wind, with_wind], winds)
        np.testing.assert_array_equal(result[0].wind, [[-8.5, 0.0, 0.25]] * 2)
        np.testing.assert_array_equal(result[1].wind, np.ones((2, 3)))
        assert "remark: logged: the log contains the wind, so --wind is ignored" in capsys.readouterr().err


def test_logs_of_different_vehicles_are_not_combined(run, tmp_path):
    cells = ['"[0, 0, 1]"', '"[0, 0, 0]"', '"[0, 0, 0, 1]"', '"[0, 0, 0]"', "0.4", '"[0, 0, 0, 1]"']
    rows = [",".join([time, *cells]) for time in ("0.0", "0.02", "0.04")]
    (tmp_path / "other.csv").write_text("\n".join(["t,p,v,q,w,T_sp,q_sp", *rows, ""]), encoding="utf-8")
    result = run("identify", CRAZYFLIE_LOG, tmp_path / "other.csv", "--output", tmp_path / "mine.yaml")
    assert result.returncode == 2
    sentence = result.stderr.splitlines()[-1]
    named = "vehicles/crazyflie and vehicles/neural_fly:neural_fly"
    assert sentence == f"error: the logs are of different vehicles, {named}; identify each vehicle separately"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.bin"], "nothing.bin: cannot be read"),
        (["README.md"], "README.md: none of the shipped mappings .* fits its columns"),
        ([CRAZYFLIE_LOG, "--output", "mine.txt"], "--output mine.txt: the name of the file must end in .yaml or .yml"),
        ([CRAZYFLIE_LOG, "--mass", "-1"], "--mass -1"),
        (
            [CRAZYFLIE_LOG, "--wind", "1,2"],
            "--wind '1,2' must be three numbers between -100 and 100 m/s, as in -8.5,0,0",
        ),
        (
            [CRAZYFLIE_LOG, "--wind", "0,0,0", "--wind", "1,0,0"],
            "--wind is given 2 times for 1 logs; give it once, or once for each log",
        ),
        ([PX4_LOG], "does not name its vehicle; give an initial vehicle by --vehicle, such as"),
        ([CRAZYFLIE_LOG, "--vehicle", "nowhere.yaml"], "nowhere.yaml"),
        ([CRAZYFLIE_LOG, "--name", "a b"], "--name 'a b': a name consists of letters"),
        ([CRAZYFLIE_LOG, "--set", "nominal.mas=1"], "nominal.mas"),
        (
            [CRAZYFLIE_LOG, "--vehicle", "diagrams/laboratory.yaml:uncertain"],
            "is a distribution; an identification begins with numbers|uncertain",
        ),
    ],
)
def test_identify_refuses_invalid_arguments_in_one_sentence_with_status_2(
    run, tmp_path, arguments, message, monkeypatch
):
    output = [] if "--output" in arguments else ["--output", tmp_path / "mine.yaml"]
    result = run("identify", *arguments, *output)
    assert result.returncode == 2
    sentence = result.stderr.splitlines()[-1]
    assert sentence.startswith("error: ")
    assert re.search(message, sentence)
    assert not (tmp_path / "mine.yaml").exists()


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_a_study_is_written_as_parquet_and_its_crashes_are_plotted_against_a_parameter(run, tmp_path):
    over = ["--over", "vehicle.mass", "--parquet", "--set", "crash.position_error=0.1", "--set", "duration=2"]
    result = monte_carlo(run, tmp_path, *over)
    assert result.returncode == 0
    written = {Path(line.strip()).name for line in result.stdout.split("wrote\n")[1].splitlines()[:-1]}
    assert {"results.csv", "results.parquet", "crash_probability.png"} <= written
    assert (tmp_path / "results.parquet").stat().st_size > 1000
    refused = monte_carlo(run, tmp_path / "none", "--over", "vehicle.gravity")
    assert (refused.returncode, refused.stdout) == (2, "")
    refusal = "--over: vehicle.gravity is not a random parameter of robustness; did you mean vehicle.mass?"
    assert refusal in refused.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures", "without_figures")
def test_a_flight_is_written_in_the_formats_of_other_programs(run, tmp_path, monkeypatch):
    flight = ["hover", "--set", "duration=1", "--mcap", "--output", tmp_path]
    assert run("fly", *flight, "--px4").returncode == 0
    assert (tmp_path / "flight.mcap").read_bytes().startswith(b"\x89MCAP0")
    assert (tmp_path / "px4.csv").read_text().startswith("timestamp,vehicle_local_position.x,")
    for module in ("mcap", "mcap.writer"):
        monkeypatch.setitem(sys.modules, module, None)
    refused = run("fly", *flight)
    assert refused.returncode == 2
    assert "--mcap: mcap is not installed; install it with: pip install 'drake_quad[mcap]'" in refused.stderr
