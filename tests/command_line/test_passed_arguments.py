"""Tests that commands pass their arguments on to the computations, which are replaced by stubs."""

import argparse
import io
import math
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shtab
from tqdm import tqdm

from drake_quad import InputError, load_scenario
from drake_quad.command_line import (
    compare,
    completion,
    design,
    fly,
    identify,
    judge,
    options,
    progress,
    replicate,
    study,
    tune,
    workers,
)
from drake_quad.command_line.main import COMMANDS, full_parser
from drake_quad.design.cascade import default_options, on_board_options
from drake_quad.design.gains import OutputRegulator, PolePair
from drake_quad.design.tuning import Budget, TuningParameter
from drake_quad.evaluation.experiment import QUICK, EvaluationSizes
from drake_quad.evaluation.families import FAMILIES
from drake_quad.evaluation.results import SENSITIVITY_VARIANTS
from drake_quad.flight.formats.flight_format import FORMATS
from drake_quad.laboratory.metrics import Metrics
from drake_quad.logs.record import FlightRecord
from drake_quad.replication.experiment import QUICK as QUICK_EXPERIMENT
from drake_quad.replication.experiment import ExperimentSizes
from drake_quad.replication.published import Cell
from drake_quad.scenario.files.shipped import shipped_folder
from drake_quad.studies.study import Study

COMMAND_PACKAGE = "drake_quad.command_line"


def written(result):
    """Return the files after the word "wrote" in the output of a command."""
    return [line.strip() for line in result.stdout.split("wrote\n")[1].splitlines() if line.startswith("  ")]


def metrics_of(count, crashed=()):
    rmse, time = np.linspace(0.1, 0.2, count), np.full(count, np.inf)
    time[list(crashed)] = 3.0
    return Metrics(rmse, *[rmse] * (len(Metrics._fields) - 2), time)


@pytest.fixture
def replaced(monkeypatch):
    """Return a function that replaces functions of a command by stubs and records the arguments of their calls."""
    calls = {}

    def stub_of(name, result):
        calls[name] = []

        def call(*arguments, **named):
            calls[name].append((arguments, named))
            return result(*arguments, **named) if callable(result) else result

        return call

    def replace(command, **results):
        for name, result in results.items():
            monkeypatch.setattr(f"{COMMAND_PACKAGE}.{command}.{name}", stub_of(name, result))
        return calls

    return replace


def test_controllers_are_compared_on_the_requested_number_of_samples(run, replaced, tmp_path):
    calls = replaced("compare", fly_samples=metrics_of(3), plot_comparison=None, save_figures=["comparison.png"])
    one = ["compare", "--scenario", "hover", "--controller", "controllers/paper:pd", "--output", tmp_path]
    for more_options, count, compiled, duration in (
        ([], 20, True, load_scenario("hover").duration),
        (["--quick"], 4, True, 6.0),
        (["--quick", "--samples", 7, "--wired", "--set", "duration=2"], 7, False, 2.0),
        (["--samples", 10_000], 10_000, True, load_scenario("hover").duration),
        (["--samples", 1], 1, True, load_scenario("hover").duration),
    ):
        calls["fly_samples"].clear()
        result = run(*one, *more_options)
        assert result.returncode == 0
        assert written(result) == [str(tmp_path / "comparison.csv"), "comparison.png"]
        assert result.stdout.startswith(f"mean ± standard deviation over {count} samples; ")
        (((scenario, samples), named),) = calls["fly_samples"]
        assert (samples, named["compiled"], scenario.duration) == (range(count), compiled, duration)
    assert run(*one, "--samples", 10_001).returncode == 2


def test_each_controller_is_combined_with_each_laboratory():
    arguments = argparse.Namespace(scenario=None, controller=None, quick=True, set=["vehicle.mass=0.7"], seed=3)
    result = compare.scenarios_from_arguments(arguments)
    names = ["pd", "pd_t1fnn", "pd_t2fnn", "pid", "pd_feed_forward"]
    assert {laboratory: [*each] for laboratory, each in result.items()} == dict.fromkeys(
        ("nominal", "low_wind", "high_wind"), names
    )
    for laboratory, each in result.items():
        for name, scenario in each.items():
            assert (scenario.name, scenario.duration, scenario.seed, scenario.vehicle.mass) == (laboratory, 6.0, 3, 0.7)
            assert (scenario.control.network is not None) == ("fnn" in name)
    twice = argparse.Namespace(
        scenario=["hover"], controller=["controllers/paper:pd"] * 2, quick=False, set=[], seed=None
    )
    with pytest.raises(InputError, match="--controller controllers/paper:pd is given twice"):
        compare.scenarios_from_arguments(twice)


def test_replayed_samples_begin_with_the_given_one(run, replaced, tmp_path):
    flight = SimpleNamespace(metrics=SimpleNamespace(crashed=False))
    calls = replaced(
        "replay", simulate_samples=lambda _, samples: [flight] * len(samples), save_swarm=None, save_replay=None
    )
    result = run("replay", "hover", "--samples", 3, "--first", 5, "--output", tmp_path)
    assert result.returncode == 0
    assert written(result) == [str(tmp_path / "replay.html")]
    assert result.stdout.startswith("hover: 3 flights, 0 crashed\n")
    ((scenario, samples), _), ((flights, file), _) = calls["simulate_samples"][0], calls["save_swarm"][0]
    assert (scenario.name, samples) == ("hover", range(5, 8))
    assert flights == {"hover": [flight] * 3}
    assert file == tmp_path / "replay.html"
    assert run("replay", "hover", "--samples", 1, "--output", tmp_path).returncode == 0
    assert calls["simulate_samples"][1][0][1] == range(1)
    assert calls["save_replay"] == [(({"hover": flight}, file), {})]
    assert run("replay", "hover", "--output", tmp_path).returncode == 0
    assert calls["simulate_samples"][2][0][1] == range(100)
    for wrong in (["--samples", 0], ["--samples", 1001], ["--first", -1]):
        assert run("replay", "hover", *wrong, "--output", tmp_path).returncode == 2
    assert run("replay", "hover", "--samples", 1000, "--output", tmp_path).returncode == 0


def test_repeated_sensitivity_fields_are_used_once(run, replaced, tmp_path):
    result = SimpleNamespace(crash_time=math.inf, metrics={"rmse": 0.0}, gradients={"rmse": np.zeros(1)})
    calls = replaced(
        "sensitivities",
        flight_sensitivities=result,
        plot_sensitivities=None,
        save_figures=[],
        write_sensitivities="file",
    )
    fields = [word for name in ("vehicle.mass", "vehicle.gravity", "vehicle.mass") for word in ("--field", name)]
    assert run("sensitivities", "hover", *fields, "--sample", 4, "--output", tmp_path).returncode == 0
    ((scenario, fields), named) = calls["flight_sensitivities"][0]
    assert (scenario.name, fields, named) == ("hover", ("vehicle.mass", "vehicle.gravity"), {"sample": 4})
    assert calls["plot_sensitivities"] == [((result, "rmse"), {})]
    assert run("sensitivities", "hover", "--output", tmp_path).returncode == 0
    assert "vehicle.arm_length" in calls["flight_sensitivities"][1][0][1]


@pytest.mark.parametrize(("loop", "block", "axis"), [("position", "position", 0), ("attitude", "attitude", 1)])
def test_gains_are_mapped_around_the_gains_of_the_scenario(run, replaced, tmp_path, loop, block, axis):
    calls = replaced("map", panel="a panel", plot_map=None, write_map="file", print_panel=None, save_figures=[])
    gain_overrides = [f"control.{block}.k_p=[1.5, 2.5, 3.5]", f"control.{block}.k_d=[4.5, 5.5, 6.5]"]
    command_line = [
        "hover",
        "--loop",
        loop,
        "--set",
        gain_overrides[0],
        "--set",
        gain_overrides[1],
        "--output",
        tmp_path,
    ]
    result = run("map", *command_line)
    assert result.returncode == 0
    assert written(result) == ["file"]
    assert len(calls["print_panel"]) == 2
    scenario = load_scenario("hover", gain_overrides)
    (nominal, worst), (((panels, k_p, k_d), named),) = calls["panel"], calls["plot_map"]
    assert panels == ["a panel"] * 2
    first, second = 1.5 + axis, 4.5 + axis
    np.testing.assert_allclose(k_p, np.linspace(0.05 * first, 3.0 * first, 40))
    np.testing.assert_allclose(k_d, np.linspace(0.05 * second, 3.0 * second, 40))
    assert (named["marked"], named["loop"]) == ((first, second), loop)
    for (arguments, keywords), case in zip((nominal, worst), calls["panel"], strict=True):
        assert arguments[2] == loop
        np.testing.assert_array_equal(arguments[3], k_p)
        np.testing.assert_array_equal(arguments[4], k_d)
        assert keywords == {"compiled": True}
        assert case[0] is arguments
    assert (nominal[0][0], nominal[0][1]) == ("nominal", scenario)
    lag, delay = scenario.vehicle.rotor_time_constant, scenario.laboratory.command_link.delay_ticks
    assert worst[0][0] == f"rotor_time_constant={1.4 * lag:.4g}, delay_ticks={delay + 1:g}"
    slow = worst[0][1]
    assert slow.vehicle.rotor_time_constant == pytest.approx(1.4 * lag, rel=1e-3)
    assert slow.laboratory.command_link.delay_ticks == delay + 1


def test_a_quick_map_is_small_and_short_and_its_worst_case_can_be_named(run, replaced, tmp_path):
    calls = replaced("map", panel="a panel", plot_map=None, write_map="file", print_panel=None, save_figures=[])
    ranges = ["--k-p", 1, 4, "--k-d", 2, 3, "--worst", "vehicle.mass=0.9", "--worst", "vehicle.linear_drag=0.1"]
    assert run("map", "hover", "--quick", *ranges, "--wired", "--output", tmp_path).returncode == 0
    nominal, worst = calls["panel"]
    np.testing.assert_allclose(nominal[0][3], np.linspace(1.0, 4.0, 12))
    np.testing.assert_allclose(nominal[0][4], np.linspace(2.0, 3.0, 12))
    assert nominal[1] == worst[1] == {"compiled": False}
    assert nominal[0][1].duration == worst[0][1].duration == 5.0
    assert worst[0][0] == "mass=0.9, linear_drag=0.1"
    assert (worst[0][1].vehicle.mass, worst[0][1].vehicle.linear_drag) == (0.9, 0.1)
    calls["panel"].clear()
    assert run("map", "hover", "--quick", "--set", "duration=2", "--size", 3, "--output", tmp_path).returncode == 0
    assert calls["panel"][0][0][1].duration == 2.0
    assert len(calls["panel"][0][0][3]) == 3
    # The worst case adds no delay here, since the link already has the largest possible delay of fifty ticks.
    calls["panel"].clear()
    delay_override = ["--set", "laboratory.command_link.delay_ticks=50"]
    assert run("map", "hover", "--quick", *delay_override, "--output", tmp_path).returncode == 0
    assert calls["panel"][1][0][1].laboratory.command_link.delay_ticks == 50
    for size, status in ((2, 0), (200, 0), (201, 2)):
        assert run("map", "hover", "--size", size, "--output", tmp_path).returncode == status


def test_the_range_of_a_tuned_parameter_is_a_factor_of_four_or_the_given_range():
    scenario = load_scenario("hover", ["control.position.k_p=[2, 3, 4]"])
    pair = "control.position.k_p.0,control.position.k_p.1"
    paths = tuple(pair.split(","))
    assert tune.parse_tuning_parameter(pair, scenario) == TuningParameter(paths, 0.5, 8.0)
    assert tune.parse_tuning_parameter(f"{pair}=0.1:3", scenario) == TuningParameter(paths, 0.1, 3.0)
    for ends, words in (
        ("3", "write it as LOW:HIGH"),
        ("a:b", "write it as LOW:HIGH"),
        ("0:3", "HIGH above LOW"),
        ("3:3", "HIGH above LOW"),
    ):
        with pytest.raises(InputError, match=words):
            tune.parse_tuning_parameter(f"{pair}={ends}", scenario)
    for path in ("vehicle.mass", "control.kind"):
        with pytest.raises(InputError, match="must name a field of `control` whose value is a number above 0"):
            tune.parse_tuning_parameter(f"control.position.k_p.0,{path}", scenario)
    integral = load_scenario("hover", ["control.position={kind: pid, k_p: [1, 1, 1], k_d: [1, 1, 1], k_i: [0, 1, 1]}"])
    with pytest.raises(InputError, match="a number above 0"):
        tune.parse_tuning_parameter("control.position.k_i.0", integral)


def test_a_controller_is_tuned_on_training_samples_and_tested_on_later_ones(run, replaced, tmp_path):
    tuned = SimpleNamespace(values=(1.5, 2.5), min_margin_ratio=0.876)
    calls = replaced("tune", tune=tuned, fly_samples=metrics_of(4, crashed=[3]), link_margins={}, print_margins=None)
    command_line = ["hover", "--rounds", 5, "--samples", 6, "--sensitivity", 1.75, "--delay-margin", 0.25]
    result = run("tune", *command_line, "--set", "control.position.k_p=[2, 2, 4]", "--output", tmp_path)
    assert result.returncode == 0
    assert written(result) == [str(tmp_path / "scenario.yaml")]
    assert len(calls["print_margins"]) == 1
    (((scenarios, parameters, margin_ratios), named),) = calls["tune"]
    assert [scenario.name for scenario in scenarios] == ["hover"]
    assert [parameter.paths for parameter in parameters] == [
        (f"control.position.{gain}.0", f"control.position.{gain}.1") for gain in ("k_p", "k_d")
    ]
    assert (margin_ratios.__self__.sensitivity, margin_ratios.__self__.delay) == (1.75, 0.25)
    assert named == {"budget": Budget()._replace(samples=6, rounds=5)}
    (before, _), (after, _) = calls["fly_samples"]
    assert before[1] == after[1] == range(6, 6 + 32)
    assert (before[0].control.position.k_p[0], after[0].control.position.k_p[0]) == (2.0, 1.5)
    assert load_scenario(tmp_path / "scenario.yaml").control.position.k_d[:2] == (2.5, 2.5)
    lines = [line.split("  ") for line in result.stdout.splitlines()]
    k_p = [word.strip() for word in lines[1] if word.strip()]
    assert k_p == ["control.position.k_p.0, control.position.k_p.1", "2", "1.5"]
    # The expected value is the mean of 10, 13.3 and 16.7 cm; the fourth flight crashes.
    assert "13.33 cm, 1 crashed" in result.stdout
    assert "no candidate meets the limits; the smallest margin of the best candidate is 88 %" in result.stdout
    tuned.min_margin_ratio = 1.0
    assert "no candidate meets" not in run("tune", *command_line, "--output", tmp_path).stdout


def test_the_mean_error_is_over_flights_without_a_crash(monkeypatch):
    for metrics, words in ((metrics_of(2), "15.00 cm"), (metrics_of(2, [0, 1]), "–, 2 crashed")):
        monkeypatch.setattr(tune, "fly_samples", lambda scenario, samples, metrics=metrics: metrics)
        assert tune.rmse_text(None, range(2)) == words


def studied(scenario, samples, **given):
    metrics = metrics_of(samples, crashed=given.pop("crashed", ()))
    mass = {"vehicle.mass": np.linspace(0.5, 0.7, samples)} if given.pop("drawn", True) else {}
    return Study(scenario, 10.0, np.arange(samples), mass, metrics, **given)


@pytest.mark.slow
def test_a_study_writes_each_controller_to_its_own_folder(run, replaced, tmp_path):
    calls = replaced("study", run_monte_carlo=lambda scenario, samples, **_: studied(scenario, samples), save_plots=[])
    two = [f"--controller=controllers/paper:{name}" for name in ("pd", "pid")]
    options = ["--samples", 5, "--workers", 1, "--batch", 7, "--resume", "--wired", "--output", tmp_path]
    result = run("study", "robustness", *two, *options)
    assert result.returncode == 0
    for name, ((scenario, samples), named) in zip(("pd", "pid"), calls["run_monte_carlo"], strict=True):
        assert scenario.control.position.kind == name
        assert samples == 5
        assert named["folder"] == tmp_path / name
        assert (named["resume"], named["num_workers"], named["batch_size"], named["compiled"]) == (True, 1, 7, False)
    assert f"  {tmp_path / 'pid' / 'results.csv'}" in result.stdout
    assert "diagrams uncompiled; 0 crashed" in result.stdout
    assert "paired comparison with pd on the same samples:" in result.stdout
    calls["run_monte_carlo"].clear()
    alone = run("study", "robustness", "--workers", 1, "--output", tmp_path)
    assert "beside" not in alone.stdout
    (((_, samples), named),) = calls["run_monte_carlo"]
    assert (samples, named["folder"]) == (1000, tmp_path)
    assert (named["resume"], named["batch_size"], named["compiled"]) == (False, None, True)
    assert "diagrams compiled;" in alone.stdout


def test_a_study_reports_altered_rows_and_fails_if_a_sample_fails(run, replaced, tmp_path):
    rows = SimpleNamespace(invalid_lines=(3, 4, 5, 6, 7, 8), failures={})
    replaced(
        "study",
        run_monte_carlo=lambda scenario, samples, **_: studied(
            scenario, samples, invalid_lines=rows.invalid_lines, failures=rows.failures
        ),
        save_plots=[],
    )
    command_line = ["study", "robustness", "--samples", 4, "--workers", 1, "--output", tmp_path]
    for lines, words in (((3, 4, 5, 6, 7, 8), "3, 4, 5, 6, 7, ..."), ((3, 4, 5, 6, 7), "3, 4, 5, 6, 7")):
        rows.invalid_lines = lines
        result = run(*command_line)
        message = (
            f"remark: {tmp_path / 'results.csv'}: lines {words} had been altered, so their samples were flown again\n"
        )
        assert (result.returncode, result.stderr) == (0, message)
    rows.invalid_lines, rows.failures = (), {2: "too slow"}
    result = run(*command_line)
    assert result.returncode == 1
    assert "failed: 1 samples could not be simulated (sample 2 of robustness: too slow)" in result.stderr
    # A sample of one of the two controllers fails.
    replaced(
        "study",
        run_monte_carlo=lambda scenario, samples, **_: studied(
            scenario, samples, failures={} if scenario.control.position.kind == "pd" else {2: "too slow"}
        ),
    )
    two = [f"--controller=controllers/paper:{name}" for name in ("pd", "pid")]
    result = run(*command_line, *two)
    assert result.returncode == 1
    assert "(sample 2 of pid: too slow)" in result.stderr
    assert written(result) == [str(tmp_path / name / "results.csv") for name in ("pd", "pid")]


def test_a_study_saves_only_figures_that_show_samples(replaced, monkeypatch):
    for name in ("distribution", "convergence", "influences", "crash_probability"):
        monkeypatch.setattr(f"drake_quad.visualization.study_plots.plot_{name}", lambda *arguments: arguments[1])
    replaced("study", save_figures=lambda figures, folder, vector: (figures, folder, vector))
    arguments = SimpleNamespace(metric="peak_error", over=None, vector="svg")
    scenario = load_scenario("robustness")

    def figures(**studies):
        result, folder, vector = study.save_plots(studies, "folder", arguments)
        assert (folder, vector) == ("folder", "svg")
        return result

    both = {"distribution": "peak_error", "convergence": "peak_error"}
    calm, crashed = studied(scenario, 20), studied(scenario, 20, crashed=[0, 1, 2])
    assert figures(a=calm) == both | {"influences": "peak_error"}
    everything = {"influences": "peak_error", "crash_influences": "crashed", "crash_probability": "vehicle.mass"}
    assert figures(a=crashed) == both | everything
    assert figures(a=calm, b=crashed) == both | {
        "influences_a": "peak_error",
        "influences_b": "peak_error",
        "crash_influences_b": "crashed",
        "crash_probability": "vehicle.mass",
    }
    assert figures(a=studied(scenario, 20, crashed=range(20))).keys() == both.keys() | everything.keys() - {
        "influences"
    }
    assert figures(a=studied(scenario, 20, crashed=[0], drawn=False)) == both
    arguments.over = "vehicle.gravity"
    assert figures(a=crashed)["crash_probability"] == "vehicle.gravity"
    assert study.save_plots({"a": studied(scenario, 0)}, "folder", arguments) == []
    # A study without samples has no figure.
    assert figures(a=calm, b=studied(scenario, 0)) == both | {"influences": "peak_error"}


def test_batches_fly_on_this_machine_or_on_a_cluster(monkeypatch):
    calls = []

    @contextmanager
    def stub_pool(*arguments, **options):
        calls.append((arguments, options))
        yield "a pool"

    monkeypatch.setattr(workers, "Workers", stub_pool)
    monkeypatch.setattr(workers, "dask_pool", stub_pool)
    for cluster, limit in ((None, 5.0), ("tcp://there", None)):
        with workers.open_executor(SimpleNamespace(cluster=cluster, workers=3, time_limit=limit)) as result:
            assert result == "a pool"
    assert calls == [((3,), {"time_limit": 5.0}), (("tcp://there", 3), {})]
    with (
        pytest.raises(InputError, match="--time-limit works for processes on this machine only"),
        workers.open_executor(SimpleNamespace(cluster="tcp://there", workers=3, time_limit=5.0)),
    ):
        pass


def test_a_single_remark_reports_several_studies_without_random_parameters(capsys):
    two = [f"controllers/paper:{name}" for name in ("pd", "pid")]
    given = argparse.Namespace(
        scenario="hover", controller=two, set=[], seed=None, over=None, metric="rmse", draws=None, samples=40
    )
    assert [*study.scenarios_from_arguments(given)] == ["pd", "pid"]
    assert capsys.readouterr().err.count("has no distribution") == 1
    given.over = "vehicle.mass"
    with pytest.raises(
        InputError, match="--over: vehicle.mass is not a random parameter of pd; its random parameters are: none"
    ):
        study.scenarios_from_arguments(given)
    given.scenario, given.controller = "robustness", []
    assert [*study.scenarios_from_arguments(given)] == ["robustness"]
    assert capsys.readouterr().err.count("has no distribution") == 1


def test_sobol_draws_are_refused_for_controllers_with_different_random_parameters(tmp_path):
    scenario_file = tmp_path / "mine.yaml"
    scenario_file.write_text(
        "mine: {extends: 'controllers/paper:pd', vehicle: {linear_drag: {uniform: {min: 0.1, max: 0.2}}}}\n"
    )
    given = argparse.Namespace(
        scenario="hover",
        controller=["controllers/paper:pd", f"{scenario_file}:mine"],
        seed=None,
        over=None,
        set=["vehicle.mass={uniform: {min: 0.6, max: 0.7}}"],
        metric="rmse",
        draws="sobol",
        samples=40,
    )
    with pytest.raises(InputError, match=r"mine and pd have different random parameters \(vehicle.linear_drag\)"):
        study.scenarios_from_arguments(given)
    given.draws = "latin_hypercube"
    assert {each.draws.kind for each in study.scenarios_from_arguments(given).values()} == {"latin_hypercube"}


@pytest.fixture
def simulated(replaced, monkeypatch):
    """Let the command `fly` use stubs for the simulation and for writing files, and return their recorded calls."""
    numbers = dict.fromkeys(Metrics._fields, 0.1)
    flight = SimpleNamespace(
        metrics=Metrics(**numbers), crash="", compiled=False, time=np.array([1.0]), cause=None,
        save=lambda folder: [folder / "flight.csv"],
    )  # fmt: skip
    calls = replaced("fly", simulate=flight, save_network="net.yaml")
    calls["written"] = []

    def written(name):
        return lambda *given: calls["written"].append((name, *given)) or name

    formats = [each._replace(write=written(each.file_name)) for each in FORMATS]
    monkeypatch.setattr("drake_quad.command_line.fly.FORMATS", formats)
    monkeypatch.setattr("drake_quad.visualization.plots.save_plots", lambda *_, **named: [named["vector"]])
    monkeypatch.setattr("drake_quad.visualization.replay.page.save_replay", lambda flights, path: path)
    calls["flight"] = flight
    return calls


def test_the_flown_sample_is_given_by_the_option_or_the_scenario(run, simulated, tmp_path):
    for more_options, sample, compiled in (
        ([], None, None),
        (["--sample", 0, "--wired"], 0, False),
        (["--set", "sample=4"], 4, None),
        (["--set", "sample=4", "--sample", 2], 2, None),
    ):
        simulated["simulate"].clear()
        result = run("fly", "laboratory:low_wind", "--seed", 7, *more_options, "--output", tmp_path)
        assert (result.returncode, result.stderr) == (0, "")
        ((scenario,), named), *_ = simulated["simulate"]
        assert scenario.name == "low_wind"
        assert (named["sample"], named["compiled"], named["prepare"]) == (sample, compiled, None)
        first = result.stdout.splitlines()[0].split()
        assert first == (["flight", "time", "1.00", "s"] if sample is None else ["sample", str(sample), "(seed", "7)"])
    simulated["flight"].cause = "it diverged"
    assert run("fly", "hover", "--output", tmp_path).stderr == "remark: the flight ended because it diverged\n"


def test_files_for_other_programs_are_written_on_request(run, simulated, tmp_path):
    command_line = ["fly", "paper:no_wind_pd_t2fnn", "--output", tmp_path]
    result = run(*command_line, "--px4", "--vector", "pdf", "--save-network", tmp_path / "net.yaml")
    written = [line.strip() for line in result.stdout.split("wrote\n")[1].splitlines()]
    assert written == [str(tmp_path / "flight.csv"), "pdf", str(tmp_path / "replay.html"), "px4.csv", "net.yaml"]
    assert simulated["written"] == [("px4.csv", simulated["flight"], tmp_path / "px4.csv")]
    assert simulated["save_network"] == [((simulated["flight"], str(tmp_path / "net.yaml")), {})]
    for wrong, words in (
        (["--rate", "inf"], "--rate is inf, but must be between 0 and 1000000"),
        (["--rate", "-0.5"], "--rate is -0.5, but must be between 0 and 1000000"),
    ):
        refused = run(*command_line, *wrong)
        assert refused.returncode == 2
        assert words in refused.stderr


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_flight_on_a_terminal_waits_until_a_browser_is_connected(monkeypatch, capsys):
    """The flight starts when a browser is connected. The command ends when Enter is pressed or its input ends."""
    connections = iter((0, 0, 1))
    meshcat = SimpleNamespace(
        web_url=lambda: "http://127.0.0.1:7000", GetNumActiveConnections=lambda: next(connections), Delete=lambda: None
    )
    waits = []
    monkeypatch.setattr("drake_quad.visualization.replay.scene.local_meshcat", lambda: meshcat)
    monkeypatch.setattr(fly.time, "sleep", waits.append)
    monkeypatch.setattr("sys.stdin", Terminal(""))
    assert fly.start_meshcat() is meshcat
    assert len(waits) == 2
    assert 0.0 < waits[0] < 1.0
    assert capsys.readouterr().out.splitlines() == [
        "open http://127.0.0.1:7000 in a browser on this machine",
        "the flight starts as soon as the page is open",
    ]
    drawn = []
    monkeypatch.setattr("drake_quad.visualization.replay.page.draw_replay", lambda *arguments: drawn.append(arguments))
    fly.show_replay(meshcat, "mine", "a flight")
    assert drawn == [(meshcat, {"mine": "a flight"})]
    assert "press Enter to end" in capsys.readouterr().out
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    fly.show_replay(meshcat, "mine", "a flight")
    assert capsys.readouterr().out == ""
    assert fly.start_meshcat() is meshcat


def test_options_of_a_design_replace_the_defaults_of_their_loops():
    scenario = load_scenario("laboratory:nominal")
    period = scenario.laboratory.command_link.period

    def options(*words):
        return design.design_options(design.options().parse_args([*map(str, words)]), scenario)

    default = default_options(period)
    assert options() == default
    assert options("--on-board") == default | on_board_options()
    for axis, each in options("--phase-margin", 50, "--gain-margin", 8, "--delay-margin", 3, "--on-board").items():
        required_delay = 3.0 * period if axis in ("roll", "pitch", "yaw") and each.requirements.delay else 0.0
        assert tuple(each.requirements) == (50.0, 8.0, required_delay)
    assert options("--delay-margin", 3)["roll"].requirements.delay == 3.0 * period
    assert options("--delay-margin", 3)["x"].requirements.delay == 0.0
    damped = options(*(f"--loop={each}" for each in ("height.damping=0.7", "yaw.bandwidth=3", "position.bandwidth=2")))
    assert {axis for axis, each in damped.items() if each.family == PolePair(0.7)} == {"z"}
    assert {axis: each.effort for axis, each in damped.items() if each.effort} == {"yaw": 3.0, "x": 2.0, "y": 2.0}
    costs = {axis: each.family for axis, each in options("--method", "lqr", "--loop", "yaw.rate_time=0.0").items()}
    times = {"roll": 0.2, "pitch": 0.2, "yaw": 0.0, "x": 1.0, "y": 1.0, "z": 0.2}
    assert costs == {axis: OutputRegulator(time) for axis, time in times.items()}


@pytest.mark.parametrize(
    ("option", "minimum", "maximum"),
    [
        ("phase-margin", 0.0, 180.0),
        ("gain-margin", 0.0, 60.0),
        ("delay-margin", 0.0, 1000.0),
        ("integral", 0.01, 0.9),
    ],
)
def test_design_options_are_checked_against_their_ranges(option, minimum, maximum):
    scenario = load_scenario("laboratory:nominal")
    for value in (minimum, maximum):
        design.design_options(design.options().parse_args([f"--{option}={value}"]), scenario)
    for value in (minimum - 1e-4, maximum + 1e-4):
        with pytest.raises(InputError, match=f"--{option} is .*, but must be between {minimum:g} and {maximum:g}"):
            design.design_options(design.options().parse_args([f"--{option}={value}"]), scenario)


@pytest.mark.parametrize(
    ("field", "minimum", "maximum"),
    [("yaw.bandwidth", 1e-3, 100.0), ("height.damping", 0.05, 0.999), ("position.rate_time", 0.0, 10.0)],
)
def test_loop_requests_are_checked_against_their_ranges(field, minimum, maximum):
    scenario = load_scenario("laboratory:nominal")
    method, other = ("lqr", "poles") if "rate" in field else ("poles", "lqr")

    def options_for(request, method=method):
        return design.design_options(design.options().parse_args(["--method", method, "--loop", request]), scenario)

    options_for(f"{field}={minimum}")
    options_for(f"{field}={maximum}")
    for value, condition in (
        (minimum - 1e-4, f"greater than or equal to {minimum:g}"),
        (maximum + 1e-4, f"less than or equal to {maximum:g}"),
    ):
        with pytest.raises(InputError, match=f"--loop {field}=.*: {field} is .*, but must be {condition}"):
            options_for(f"{field}={value:.6f}")
    with pytest.raises(InputError, match=f"--loop {field} requires --method {method}"):
        options_for(f"{field}={minimum}", other)


def test_a_loop_request_must_name_a_loop_and_a_field():
    scenario = load_scenario("laboratory:nominal")
    for request, message in {
        "x.damping=0.7": "x is unknown; allowed are attitude, yaw, height, position",
        "yaw.dampings=0.7": "yaw.dampings is unknown; allowed are bandwidth, damping, rate_time; did you mean damping",
        "yaw.damping": "must be field.path=value",
        "yaw.damping=much": "yaw.damping is 'much', but must be a valid number",
    }.items():
        with pytest.raises(InputError, match=f"--loop {request}: {message}"):
            design.design_options(design.options().parse_args(["--loop", request]), scenario)


def test_a_vehicle_is_named_after_its_file_or_its_first_log():
    def name(given=None, output=None, log="logs/my log.v2.csv"):
        return identify.vehicle_name(SimpleNamespace(name=given, output=output, log=[Path(log), Path("other.csv")]))

    assert name() == "my_log"
    assert name(output=Path("out/mine.yaml")) == "mine"
    assert name("a-b.c", output=Path("out/mine.yaml")) == "a-b.c"
    assert name(log=".csv") == "identified"
    with pytest.raises(InputError, match="--name 'a b': a name consists of letters"):
        name("a b")


def test_the_initial_vehicle_is_read_from_the_log_or_from_the_scenario_next_to_it(tmp_path):
    time = np.arange(3.0)
    plain, crazyflie = FlightRecord("a", time), FlightRecord("b", time, vehicle="vehicles/crazyflie")
    logs = [tmp_path / "flight.csv.xz", tmp_path / "b.csv"]
    assert identify.initial_vehicle_name([plain, crazyflie], logs) == "vehicles/crazyflie"
    (tmp_path / "scenario.yaml").write_text("", encoding="utf-8")
    assert identify.initial_vehicle_name([plain], logs) == str(tmp_path / "scenario.yaml")
    attitude = {"attitude": np.zeros((3, 3)), "attitude_command": np.zeros((3, 3))}
    for record, like in (
        (plain, "vehicles/hummingbird"),
        (FlightRecord("c", time, **attitude), "vehicles/neural_fly:neural_fly"),
        (FlightRecord("d", time, attitude=np.zeros((3, 3))), "vehicles/hummingbird"),
        (FlightRecord("e", time, motor_command=np.zeros((3, 4)), **attitude), "vehicles/hummingbird"),
        (FlightRecord("f", time, rotor_speed_command=np.zeros((3, 4)), **attitude), "vehicles/hummingbird"),
    ):
        with pytest.raises(InputError, match=f"such as {like}, "):
            identify.initial_vehicle_name([record], logs[1:])


def test_winds_are_three_numbers_below_a_hundred():
    record = FlightRecord("a", np.arange(3.0))
    for wrong in ("1,2", "1,2,3,4", "a,b,c", "100,0,0", "nan,0,0"):
        with pytest.raises(InputError, match="must be three numbers between -100 and 100 m/s"):
            identify.with_winds([record], [wrong])
    assert identify.with_winds([record], []) == [record]
    with pytest.raises(InputError, match="--wind is given 2 times for 3 logs; give it once, or once for each log"):
        identify.with_winds([record] * 3, ["0,0,0"] * 2)
    result = identify.with_winds([record] * 2, ["1,0,0", "2,0,0"])
    assert [each.wind[0, 0] for each in result] == [1.0, 2.0]
    assert result[0].wind.shape == (3, 3)


def test_judge_evaluates_all_families_unless_the_option_family_is_given(run, replaced, tmp_path, monkeypatch):
    missing = lambda diagrams, name: ["mpc"] if name == "outdoor" else []  # noqa: E731
    calls = replaced(
        "judge", fly_evaluation="found", missing_designs=missing, write_report=[Path("report.md")], print_errors=None
    )
    monkeypatch.setattr(judge, "output_folder", lambda folder: folder)
    for given, families, only, sizes, folder in (
        ([], [*FAMILIES], None, EvaluationSizes(), "out/controllers"),
        (
            ["--samples", 9, "--family", "laboratory", "--only", "pd"],
            ["laboratory"],
            ["pd"],
            EvaluationSizes(samples=9),
            "out/controllers",
        ),
        (["--quick"], [*FAMILIES], None, QUICK, "out/controllers_quick"),
        (["--quick", "--output", tmp_path], [*FAMILIES], None, QUICK, tmp_path),
    ):
        calls["fly_evaluation"].clear()
        result = run("judge", *given)
        assert result.returncode == 0
        message = "remark: the family outdoor has no design of mpc, so these controllers are left out\n"
        assert result.stderr == (message if "outdoor" in families else "")
        assert written(result) == [str(Path(folder) / name) for name in ("flights.csv", "traits.csv")] + ["report.md"]
        assert "simulated in 0 s\n" in result.stdout
        ((arguments, named),) = calls["fly_evaluation"]
        assert arguments == (shipped_folder(), families, sizes, Path(folder))
        assert named["only"] == only
    assert calls["write_report"][-1] == ((tmp_path, "found"), {})
    for samples, status in ((1, 2), (2, 0), (10_000, 0), (10_001, 2)):
        assert run("judge", "--samples", samples).returncode == status


def test_judge_tunes_the_controllers_of_each_given_family(run, replaced):
    design_of = SimpleNamespace(name="pd", description="6 numbers")
    calls = replaced(
        "judge", design_family=[design_of], design_sensitivity_variants=[design_of] * 2, tunable_entries="entries"
    )
    result = run("judge", "--tune", "outdoor", SENSITIVITY_VARIANTS, "--rounds", 3, "--only", "pd")
    assert result.returncode == 0
    (((_, name, family, entries), named),) = calls["design_family"]
    assert (name, family, entries, named) == ("outdoor", FAMILIES["outdoor"], "entries", {"budget": Budget(rounds=3)})
    assert calls["tunable_entries"][0][0][0] == FAMILIES["outdoor"]
    assert calls["tunable_entries"][0][0][2] == ["pd"]
    assert calls["design_sensitivity_variants"][0][1] == {"budget": Budget(rounds=3)}
    assert result.stdout.count("outdoor: pd, 6 numbers, 0 s\n") == 1
    assert result.stdout.count(f"{SENSITIVITY_VARIANTS}: pd, 6 numbers, 0 s\n") == 2
    assert run("judge", "--tune").returncode == 0
    assert [arguments[1] for arguments, _ in calls["design_family"][1:]] == [*FAMILIES]
    assert len(calls["design_sensitivity_variants"]) == 2
    for rounds, status in ((0, 2), (1, 0), (1000, 0), (1001, 2)):
        assert run("judge", "--tune", SENSITIVITY_VARIANTS, "--rounds", rounds).returncode == status


def test_the_experiment_is_flown_in_the_requested_size(run, replaced, tmp_path, monkeypatch):
    results = SimpleNamespace(entries=[], claims=[SimpleNamespace(statement="a claim", verdict="holds")])
    calls = replaced(
        "replicate",
        fly_experiment="flights",
        read_experiment="found",
        collect_findings=results,
        write_report=lambda folder, *_, **__: [folder / "report.md"],
    )
    result = run("replicate", "--quick", "--workers", 1, "--output", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    (((load, sizes, folder, _), named),) = calls["fly_experiment"]
    assert (load, sizes, folder) == (replicate.load, QUICK_EXPERIMENT, tmp_path)
    assert (named["resume"], named["compiled"]) == (False, True)
    assert calls["read_experiment"] == [((tmp_path,), {})]
    assert calls["collect_findings"] == [(("found",), {})]
    ((arguments, named),) = calls["write_report"]
    assert arguments == (tmp_path, "found", results, "flights")
    assert named["vector"] is None
    assert written(result) == [str(tmp_path / "report.md")]
    assert "a claim  holds" in result.stdout
    monkeypatch.chdir(tmp_path)
    options = ["--workers", 1, "--resume", "--wired", "--vector", "pdf", "--output", tmp_path / "whole"]
    assert run("replicate", *options).returncode == 0
    (_, sizes, folder, _), named = calls["fly_experiment"][1]
    assert (sizes, folder) == (ExperimentSizes(), tmp_path / "whole")
    assert (named["resume"], named["compiled"]) == (True, False)
    assert calls["write_report"][1][1]["vector"] == "pdf"

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    replaced("replicate", fly_experiment=interrupted)
    result = run("replicate", "--quick", "--workers", 1, "--output", tmp_path)
    message = f"interrupted: the finished table cells are in {tmp_path}; --resume continues from them\n"
    assert (result.returncode, result.stderr) == (1, message)
    assert replicate.load(Cell("low_wind", "pd")).name == "low_wind_pd"


class Bar:
    """Stub of a progress bar, which records its options and its updates."""

    def __init__(self, *items, **options):
        self.options, self.n, self.total = options, 0, options.get("total")
        self.words, self.initial, self.items = [], 0, items

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def __iter__(self):
        return iter(*self.items)

    def update(self, step=1):
        self.n += step

    def set_postfix_str(self, text, **_):
        self.words.append(text)


def test_progress_bars_show_the_finished_part(monkeypatch):
    bars = []
    monkeypatch.setattr(progress, "new_bar", lambda *items, **options: bars.append(Bar(*items, **options)) or bars[-1])
    with progress.progress_bar("mine", unit=" flights") as show:
        for done in (30, 50, 100):
            show(done, 100)
            assert (bars[-1].n, bars[-1].total) == (done, 100)
    # The first 30 flights already existed, so the displayed speed does not include them.
    assert (bars[-1].initial, bars[-1].options) == (30, {"desc": "mine", "unit": " flights"})
    with progress.progress_bar("flying") as show:
        for controller, done in (("pd", 20), ("pid", 70)):
            show(done, 200, controller)
            assert bars[-1].n == done
    assert (bars[-1].words, bars[-1].total) == (["pd", "pid"], 200)


def test_progress_bars_are_shown_only_on_a_terminal_and_disappear(capsys):
    with progress.new_bar(total=3) as bar:
        bar.update()
    assert bar.disable
    assert not bar.leave
    assert tqdm.monitor_interval == 0
    assert capsys.readouterr() == ("", "")


def test_arguments_are_completed_according_to_their_kind():
    completions = {}

    def complete(action):
        completion._complete(action)
        completions[action.dest, action.metavar] = getattr(action, "complete", None)

    parser = full_parser(complete)
    scenario_completion = {"bash": "_drake_quad_scenarios", "zsh": "_drake_quad_scenarios"}
    assert (
        completions["scenario", None]
        == completions["controller", "FILE:NAME"]
        == completions["vehicle", None]
        == scenario_completion
    )
    assert completions["output", "FOLDER"] == shtab.DIRECTORY
    assert (
        completions["log", None] == completions["save_network", "FILE"] == completions["mapping", "FILE"] == shtab.FILE
    )
    assert completions["seed", None] is None
    (commands,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    assert [*commands.choices] == [*COMMANDS]
    with pytest.raises(SystemExit):
        parser.parse_args([])


@pytest.mark.slow
def test_names_of_scenarios_are_in_the_script_of_each_shell(run):
    for shell, name in (("bash", " laboratory:high_wind "), ("zsh", r" laboratory\:high_wind ")):
        assert name in run("completion", shell).stdout


def test_scenarios_are_named_after_their_controllers():
    def controlled(*controllers, **given):
        arguments = {"scenario": "hover", "controller": [*controllers], "set": ["duration=2"], "seed": 9}
        return options.controlled_scenarios(argparse.Namespace(**(arguments | given)))

    (alone,) = controlled().items()
    assert (alone[0], alone[1].duration, alone[1].seed) == ("hover", 2.0, 9)
    two = controlled("controllers/paper:pd", "diagrams/gains/laboratory.yaml")
    assert [*two] == ["pd", "laboratory"]
    assert (two["pd"].duration, two["pd"].seed) == (2.0, 9)
    with pytest.raises(InputError, match="--controller controllers/paper:pd is given twice"):
        controlled("controllers/paper:pd", "controllers/paper:pd")


def test_the_folder_is_given_by_the_option_or_named_after_the_scenario(tmp_path):
    folder = argparse.Namespace(output=None, default_output=tmp_path / "study", scenario="laboratory:nominal")
    scenario = load_scenario("laboratory:nominal")
    assert options.resolve_output_folder(folder, scenario) == tmp_path / "study" / "nominal"
    assert options.resolve_output_folder(folder, scenario, name="pd_pid") == tmp_path / "study" / "pd_pid"
    folder.output = Path("there")
    assert options.resolve_output_folder(folder, scenario) == Path("there")
    assert options.parser("", "drake-quad fly", output="out", scenario="hover").parse_args([]).scenario == "hover"


def test_numeric_options_are_checked_against_their_ranges():
    for value, fits in ((0.9, False), (1.0, True), (3.0, True), (3.1, False), (math.nan, False)):
        given = argparse.Namespace(delay_margin=value)
        if fits:
            options.check_ranges(given, {"delay-margin": (1.0, 3.0)})
        else:
            with pytest.raises(InputError, match="--delay-margin is .*, but must be between 1 and 3"):
                options.check_ranges(given, {"delay-margin": (1.0, 3.0)})


@pytest.mark.slow
def test_long_lists_of_scenarios_are_wrapped_and_aligned(run):
    lines = run("scenarios").stdout.splitlines()
    assert max(map(len, lines)) <= 120
    # All names of scenarios begin in the same column.
    width = max(len(line.split()[0]) for line in lines if not line.startswith(" "))
    assert {len(line) - len(line[width:].lstrip()) for line in lines if len(line) > width} == {width + 2}
