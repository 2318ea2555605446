"""Tests of options that commands share, of remarks that they print before a flight, and of progress bars."""

import argparse
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_passed_arguments import Bar, metrics_of, replaced, simulated, studied, written  # noqa: F401 - fixtures

from drake_quad import InputError, load_scenario
from drake_quad.command_line import identify, judge, replicate, study
from drake_quad.command_line import map as stability_map
from drake_quad.command_line.main import COMMANDS, command_module
from drake_quad.command_line.options import parse_overrides, scenario_from_arguments
from drake_quad.identification.result import EstimatedValue, FlightDifference
from drake_quad.logs.record import FlightRecord
from drake_quad.replication.report import CAPTIONS
from drake_quad.scenario.batch import draw_sample

# Commands that take a scenario but write no files.
COMMANDS_WITHOUT_FILES = {"scenarios"}
COMMANDS_WITHOUT_SCENARIO = {"judge", "replicate", "identify", "identify-controller", "estimate", "completion"}
COMMANDS_WITH_FIGURES = {"risk", "falsify", "sobol", "estimate",
    "fly", "study", "compare", "plan", "design", "map", "sensitivities", "identify", "compare-log", "replicate",
}  # fmt: skip


def options_of(command):
    """Return the names of a command's options."""
    return {flag for action in command_module(command).options()._actions for flag in action.option_strings}


COMMANDS_WITH_UNCOMPILED_FLIGHTS = {"fly", "study", "compare", "map", "replicate", "risk", "falsify", "sobol"}


@pytest.mark.slow
def test_scenario_commands_have_override_options_and_commands_with_figures_have_the_vector_option():
    for command in COMMANDS:
        flags = options_of(command)
        assert ("--seed" in flags) == (command not in COMMANDS_WITHOUT_SCENARIO)
        assert ("--set" in flags) == (command not in COMMANDS_WITHOUT_SCENARIO - {"identify", "identify-controller"})
        assert ("--output" in flags) == (command not in COMMANDS_WITHOUT_FILES | {"completion", "live"})
        assert ("--vector" in flags) == (command in COMMANDS_WITH_FIGURES)
        assert ("--wired" in flags) == (command in COMMANDS_WITH_UNCOMPILED_FLIGHTS)


def test_folders_are_named_after_the_command_by_default():
    folders = {
        command: str(options.default_output)
        for command in COMMANDS
        if hasattr(
            options := argparse.Namespace(**vars(command_module(command).options())["_defaults"]), "default_output"
        )
    }
    assert folders["fly"] == folders["plan"] == "out"
    assert folders["study"] == "out/monte_carlo"
    assert folders["compare-log"] == "out/compare_log"
    assert len(set(folders.values())) == len(folders) - 1


@pytest.fixture
def scenario_with_remark(monkeypatch):
    monkeypatch.setattr("drake_quad.command_line.flight_remarks.flight_remarks", lambda _: ("it has a remark",))


@pytest.mark.slow
@pytest.mark.usefixtures("scenario_with_remark")
def test_remarks_on_scenarios_are_printed_once_before_they_fly(run, replaced, simulated, tmp_path):  # noqa: F811
    crash = SimpleNamespace(metrics=SimpleNamespace(crashed=False))
    replaced("compare", fly_samples=metrics_of(3), plot_comparison=None, save_figures=[])
    replaced("compare_log", read_log=FlightRecord("a", np.arange(3.0)), compare_with_log=None, print_comparison=None)
    replaced("compare_log", save_comparison=[])
    replaced("replay", simulate_samples=lambda _, samples: [crash] * len(samples), save_swarm=None)
    actual = SimpleNamespace(crash_time=math.inf, metrics={"rmse": 0.0}, gradients={"rmse": np.zeros(1)})
    replaced("sensitivities", flight_sensitivities=actual, plot_sensitivities=None, save_figures=[])
    replaced("sensitivities", write_sensitivities="file")
    replaced("study", run_monte_carlo=lambda scenario, samples, **_: studied(scenario, samples), save_plots=[])
    two = [f"--controller=controllers/paper:{name}" for name in ("pd", "pid")]
    for command_line in (
        ["compare", "--scenario", "robustness", *two],
        ["compare-log", "log.csv", "robustness"],
        ["replay", "robustness", *two],
        ["sensitivities", "hover"],
        ["study", "robustness", *two, "--samples", 3, "--workers", 1],
        ["fly", "hover"],
    ):
        result = run(*command_line, "--output", tmp_path)
        assert (result.returncode, result.stderr) == (0, "remark: it has a remark\n")


@pytest.mark.parametrize("command", ["design", "design-lqg", "tune", "map"])
def test_design_commands_print_remarks_on_the_scenario_before_they_design(command, replaced, monkeypatch, capsys):  # noqa: F811
    """The remark says that the wind has no effect. The design function is a stub that raises an error."""
    module = command_module(command)
    function = {"design": "design_cascade", "design-lqg": "design_lqg", "tune": "tune", "map": "mapped_gains"}[command]

    def stop(*_, **__):
        raise InputError("stopped")

    monkeypatch.setattr(module, function, stop)
    wind = "laboratory.wind=[{kind: steady, velocity: [1, 0, 0]}]"
    with pytest.raises(InputError, match="stopped"):
        module.main(module.options().parse_args(["hover", "--set", wind]))
    assert "remark: laboratory.wind has no effect" in capsys.readouterr().err


def test_a_live_view_shows_the_flight_at_its_rate_and_then_its_replay(run, replaced, simulated, tmp_path):  # noqa: F811
    calls = replaced("fly", start_meshcat="a browser", live_view="a view", show_replay=None)
    for options, rate in (([], 1.0), (["--rate", 0], 0.0)):
        calls["show_replay"].clear()
        calls["live_view"].clear()
        simulated["simulate"].clear()
        assert run("fly", "robustness", "--sample", 3, "--meshcat", *options, "--output", tmp_path).returncode == 0
        (((meshcat, drawn, plan, given), _),) = calls["live_view"]
        assert (meshcat, given) == ("a browser", rate)
        # The view shows the vehicle of the sample.
        assert drawn.vehicle.mass == draw_sample(load_scenario("robustness"), 3).vehicle.mass
        ((_, named),) = simulated["simulate"]
        assert named["prepare"] == "a view"
        assert named["plan"] is plan
        assert calls["show_replay"] == [(("a browser", "robustness", simulated["flight"]), {})]


def test_the_default_worst_case_of_a_map_increases_the_lag_and_the_delay_of_the_flown_sample():
    for overrides, sample in (([], 0), (["sample=3"], 3)):
        scenario = load_scenario("robustness", ["vehicle.rotor_time_constant={choice: [0.02, 0.05]}", *overrides])
        drawn = draw_sample(scenario, sample)
        lag, delay = drawn.vehicle.rotor_time_constant, drawn.laboratory.command_link.delay_ticks
        assert stability_map._default_worst_case(scenario) == [
            f"vehicle.rotor_time_constant={1.4 * lag:.4g}",
            f"laboratory.command_link.delay_ticks={delay + 1:g}",
        ]


def test_a_map_panel_has_the_linear_model_and_the_flights_of_the_same_gains(replaced):  # noqa: F811
    calls = replaced("map", linear_map="linear", simulated_map="flown")
    k_p, k_d = np.array([1.0, 2.0]), np.array([3.0, 4.0])
    for overrides, sample in (([], 0), (["sample=3"], 3)):
        scenario = load_scenario("hover", overrides)
        assert stability_map.panel("calm", scenario, "position", k_p, k_d, compiled=False) == (
            "calm",
            "linear",
            "flown",
        )
        assert calls["linear_map"][-1] == ((scenario, "position", k_p, k_d), {})
        assert calls["simulated_map"][-1] == ((scenario, "position", k_p, k_d), {"sample": sample, "compiled": False})


def test_an_identified_vehicle_is_written_to_the_default_folder(run, replaced, monkeypatch, tmp_path):  # noqa: F811
    prints = dict.fromkeys(
        ("print_logs", "print_estimates", "print_flights", "print_score", "print_hover", "print_predictions")
    )
    vehicle = SimpleNamespace(vehicle=SimpleNamespace(motors=None))
    replaced(
        "identify", read_log=FlightRecord("a", np.arange(3.0)),
        identify=SimpleNamespace(estimates=None, vehicle=vehicle), write_vehicle=None, save_figures=[],
        predict_held_out=SimpleNamespace(remark_on_worse_predictions=lambda _: ""), **prints,
    )  # fmt: skip
    replaced("identify.plots", **{f"plot_{name}": None for name in ("fit", "residuals", "thrust", "correlations")})
    replaced("identify.plots", plot_predictions=None)
    folders = []
    monkeypatch.setattr(identify, "output_folder", lambda folder: folders.append(folder) or folder)
    result = run("identify", "logs/flight 7.csv", "--vehicle", "vehicles/hummingbird")
    assert written(result) == ["out/identified/flight_7.yaml"]
    assert folders == [Path("out/identified"), Path("out/identified/flight_7")]
    assert run("identify", "a.csv", "--vehicle", "hover", "--output", tmp_path / "mine.yml").returncode == 0


def test_judge_tunes_designs_only_in_a_source_checkout(monkeypatch, tmp_path):
    monkeypatch.setattr(judge, "shipped_folder", lambda: tmp_path / "diagrams")
    with pytest.raises(InputError, match="--tune writes into diagrams/ of a source checkout"):
        judge.tune(SimpleNamespace(tune=["outdoor"], only=None, rounds=1))


def test_the_progress_bar_of_a_report_counts_its_figures(run, replaced, monkeypatch, tmp_path):  # noqa: F811
    bars = []
    monkeypatch.setattr(replicate, "new_bar", lambda *items, **options: bars.append(Bar(*items, **options)) or bars[-1])

    def write_report(*_, progress, **__):
        for _ in CAPTIONS:
            progress()
        return []

    results = SimpleNamespace(entries=[], claims=[])
    replaced(
        "replicate", fly_experiment=None, read_experiment=None, collect_findings=results, write_report=write_report
    )
    assert run("replicate", "--quick", "--workers", 1, "--output", tmp_path).returncode == 0
    assert bars[-1].n == bars[-1].total == len(CAPTIONS)


def test_correlations_and_obstacles_of_a_study_are_printed(capsys, tmp_path):
    shared = "vehicle.{}={{normal: {{mean: {}, standard_deviation: {}, min: 0.0001, shared: {{a: {}}}}}}}"
    numbers = (("mass", 0.68, 0.02, 0.9), ("linear_drag", 0.2, 0.05, 0.5), ("gravity", 9.8, 0.01, 0.3))
    obstacle = "space={obstacles: {post: {kind: cylinder, centre: [3, 0, 1], radius: 0.1, height: 2}}}"
    scenario = load_scenario("hover", [shared.format(*each) for each in numbers] + [obstacle])
    result = studied(scenario, 4, crashed=[1, 2])
    result = type(result)(
        scenario, 10.0, result.samples, result.parameters, result.metrics, obstacle_hit=np.array([0, 1, 0, 0])
    )
    study.print_study("mine", result, tmp_path, "compiled")
    text = capsys.readouterr().out
    assert "(vehicle.mass and vehicle.linear_drag: +0.45; 2 more pairs)" in text
    assert "means and standard deviations are taken over the 2 samples without a crash" in text
    (post,) = (line.split() for line in text.splitlines() if line.startswith("post"))
    assert post[1] == "1"
    assert "crashed into post at 3.00 s" in text
    empty = type(result)(scenario, 10.0, np.arange(0), {}, metrics_of(0))
    study.print_study("mine", empty, tmp_path, "compiled")
    assert "worst samples:" not in capsys.readouterr().out
    study.print_rate({"a": studied(scenario, 4, simulated_time=0.5)}, 0.25)
    assert capsys.readouterr().out == "simulation speed: 2 vehicle-seconds per second\n"


def test_the_command_draw_shows_the_diagram_of_the_first_sample(run, replaced, tmp_path):  # noqa: F811
    calls = replaced("draw", draw_sample=lambda scenario, _: scenario, build_tracking_diagram=None, drawings={})
    assert run("draw", "hover", "--output", tmp_path).returncode == 0
    assert calls["draw_sample"][0][0][1] == 0


def test_further_overrides_come_after_those_of_the_command_line():
    """Later overrides have priority, so `--set` cannot change the worst case that `--worst` defines for a map."""
    arguments = argparse.Namespace(scenario="hover", set=["duration=3", "name=mine"], seed=7)
    scenario = scenario_from_arguments(arguments, extra_overrides=parse_overrides(["duration=2"], "--worst"))
    assert (scenario.duration, scenario.name, scenario.seed) == (2.0, "mine", 7)
    assert scenario_from_arguments(arguments).duration == 3.0


@pytest.mark.parametrize(
    ("command", "option", "needed"), [("study", "--parquet", {"pandas", "pyarrow"}), ("fly", "--mcap", {"mcap.writer"})]
)
def test_libraries_that_an_option_needs_are_checked_before_the_flight(run, replaced, command, option, needed):  # noqa: F811
    def is_missing(name, _extra, *modules):
        assert (name, {*modules}) == (option, needed)
        raise InputError("it is missing")

    flies = {"study": "run_monte_carlo", "fly": "simulate"}[command]
    calls = replaced(command, check_extra=is_missing, **{flies: None})
    result = run(command, "hover", option)
    assert (result.returncode, calls[flies]) == (2, [])
    assert "it is missing" in result.stderr


def test_differences_between_flights_are_printed_with_their_units(capsys):
    thrust, force = (EstimatedValue(value, deviation, "N") for value, deviation in ((0.02, 0.005), (0.3, 0.1)))
    flights = (
        FlightDifference("first", thrust, {"trim_force.x": force, "wind_force.y": force}),
        FlightDifference("second", None, {}),
    )
    identify.print_flights(SimpleNamespace(flights=flights))
    _, header, first, second = capsys.readouterr().out.splitlines()
    assert re.split(r"\s{2,}", header.strip()) == [
        *("flight", "thrust, %", "trim x, N", "trim y, N", "wind x, N", "wind y, N")
    ]
    assert re.split(r"\s{2,}", first.strip())[2:] == ["0.30 ± 0.20", "–", "–", "0.30 ± 0.20"]
    assert second.split() == ["second", *["–"] * 5]
    identify.print_flights(SimpleNamespace(flights=flights[1:]))
    assert not capsys.readouterr().out
