"""Tests of commands that estimate risks, search for worst cases, and attribute variances."""

import inspect
import re

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.command_line import risk
from drake_quad.command_line.main import command_module
from drake_quad.files import read_table
from drake_quad.studies.risk import estimate_risk

MASS_DISTRIBUTION = "vehicle.mass={normal: {mean: 0.68, standard_deviation: 0.02, min: 0.5}}"
HOVER = ("hover", "--set", "duration=0.3", "--set", MASS_DISTRIBUTION)


def files(result):
    return [line.strip().rpartition("/")[2] for line in result.stdout.partition("\nwrote\n")[2].splitlines()]


@pytest.mark.long
def test_risk_prints_the_probability_and_writes_scenarios_that_fly(run, tmp_path):
    options = ["--event", "peak_error > 0.005", "--population", "500", "--to", "900%", "--output", tmp_path]
    result = run("risk", *HOVER, *options)
    assert result.returncode == 0
    assert re.search(r"hover: the probability of peak_error > 0\.005 is [\d.]+ % \[[\d., ]+\], from", result.stdout)
    assert "vehicle.mass" in result.stdout
    names = ["runs.csv", "coordinates.csv", "exceedance.png", "coordinates.png"]
    assert files(result) == [*names, "worst_1.yaml", "worst_2.yaml", "worst_3.yaml"]
    worst = load_scenario(tmp_path / "worst_1.yaml")
    assert worst.noise.period == 1.0
    assert f"drake-quad fly {tmp_path / 'worst_1.yaml'}" in result.stdout


def test_an_estimation_ends_at_30_per_cent_by_default():
    assert risk.options().parse_args(["hover"]).to == "30%"
    assert inspect.signature(estimate_risk).parameters["half_width"].default == 0.3


@pytest.mark.long
def test_falsify_prints_the_worst_case_beside_the_nominal_one(run, tmp_path):
    result = run("falsify", *HOVER, "--flights", "500", "--noise", "1", "--output", tmp_path)
    assert result.returncode == 0
    assert "hover: the worst of 500 flights" in result.stdout
    assert files(result) == ["worst.yaml", "parameters.csv", "worst.png", "search.png"]
    assert (tmp_path / "parameters.csv").read_text().startswith("parameter,nominal,worst\nvehicle.mass,0.68")
    assert load_scenario(tmp_path / "worst.yaml").vehicle.mass != 0.68
    _, commands = result.stdout.split("to fly the worst case again, or to see it in a replay:\n")
    worst = tmp_path / "worst.yaml"
    assert commands.splitlines()[:2] == [f"  drake-quad fly {worst}", f"  drake-quad replay {worst} --samples 1"]


@pytest.mark.long
def test_sobol_prints_the_fractions_of_the_variance(run, tmp_path):
    result = run("sobol", *HOVER, "--points", "16", "--metric", "rmse_z", "--output", tmp_path)
    assert result.returncode == 0
    assert "hover: fractions of the variance of rmse_z" in result.stdout
    assert files(result) == ["sobol.csv", "sobol.png"]


@pytest.mark.parametrize("command", ["risk", "falsify", "sobol"])
def test_search_commands_have_the_same_worker_options_as_the_command_study(command):
    arguments = ["--workers", "3", "--time-limit", "5", "--resume", "--wired", "--vector", "pdf"]
    result = (
        command_module(command).options().parse_args(["outdoor", *arguments, "--controller", "controllers/paper:pd"])
    )
    assert (result.scenario, result.workers, result.time_limit, result.cluster) == ("outdoor", 3, 5.0, None)
    assert (result.resume, result.wired, result.vector) == (True, True, "pdf")
    assert command_module(command).options().parse_args([]).scenario == "robustness"


@pytest.mark.slow
def test_a_search_is_continued_only_if_it_is_asked_for(run, tmp_path):
    command = ["sobol", *HOVER, "--points", "8", "--metric", "rmse_z", "--workers", "1", "--output", tmp_path]
    first = run(*command)
    assert first.returncode == 0
    refused = run(*command)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "already contains a study; continue it with --resume, or choose another folder" in refused.stderr
    again = run(*command, "--resume")
    assert again.stdout.splitlines()[1:] == first.stdout.splitlines()[1:]


@pytest.mark.long
def test_studies_with_sobol_draws_state_their_replicates(run, tmp_path):
    options = ["--samples", "64", "--draws", "sobol", "--workers", "1", "--output", tmp_path]
    result = run("study", *HOVER, *options)
    assert result.returncode == 0
    assert "sobol draws in 16 independent replicates of 4 samples, from which the intervals follow" in result.stdout
    assert load_scenario(tmp_path / "scenario.yaml").draws.kind == "sobol"
    other = ["--set", "vehicle.linear_drag={uniform: {min: 0.1, max: 0.2}}", "--resume"]
    refused = run("study", *HOVER, *options, *other)
    assert refused.returncode == 2


@pytest.mark.long
def test_certify_prints_both_bounds_and_writes_a_flight_that_diverges(run, tmp_path):
    options = ["--set", "laboratory.command_link.delay_ticks=8", "--vary", "vehicle.rotor_time_constant=30%"]
    result = run("certify", "hover", *options, "--output", tmp_path)
    assert result.returncode == 0
    assert "stable up to scale" in result.stdout
    assert "unstable at scale" in result.stdout
    assert "gap between the scales" in result.stdout
    assert "all loops at the command link at once: disk margin" in result.stdout
    assert files(result) == ["scales.csv", "parameters.csv", "unstable.yaml"]
    scales, parameters = (read_table(tmp_path / f"{name}.csv") for name in ("scales", "parameters"))
    assert scales["stable_up_to_scale"][0] < scales["unstable_at_scale"][0]
    assert 0.065 < parameters["certified_to"][0] < parameters["value_of_unstable_loop"][0]
    # The suggested flight shows the instability.
    assert "to see the instability, fly in hover with the parameters at scale" in result.stdout
    assert f"\n  drake-quad fly {tmp_path / 'unstable.yaml'}\n" in result.stdout
    flight = simulate(load_scenario(tmp_path / "unstable.yaml"))
    errors = np.linalg.norm(flight["state"][:, :3] - flight["reference"][:, :3], axis=1)
    half = len(errors) // 2
    assert errors[half:].max() > max(errors[0], 1.5 * errors[half // 2 : half].max())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["study", *HOVER, "--draws", "sobol", "--samples", "20"], "sobol draws need at least 32 samples"),
        (["study", *HOVER, "--draws", "sobol", "--until", "rmse ± 1 %"], "a study with sobol draws cannot end early"),
        (["study", "hover", "--draws", "latin_hypercube"], "latin_hypercube draws have no effect"),
        (
            ["compare", "--scenario", "hover", "--set", MASS_DISTRIBUTION, "--set", "draws={kind: sobol, size: 3}"],
            "draws.size is 3, but must be a power of two for sobol",
        ),
        (["risk", "hover", "--event", "peak > 1"], "there is no metric called"),
        (["risk", "hover", "--to", "much"], "--to 'much' must be a percentage above 0 %, as in 30%"),
        (["risk", *HOVER, "--population", "505"], "size is 505, but must be a multiple of 10"),
        (["falsify", *HOVER, "--flights", "100"], "--flights 100: one generation needs 250 candidates"),
        (["falsify", *HOVER, "--maximize", "rms"], "--maximize: rms is not a metric of hover; did you mean rmse"),
        (["falsify", "hover"], "hover contains no distribution"),
        (["certify", "hover"], "hover contains no distribution; give ranges of fields, as in --vary"),
        (["certify", "hover", "--vary", "vehicle.mass=0.1"], "--vary vehicle.mass=0.1 must have the form FIELD="),
        (["certify", "hover", "--vary", "vehicle.battery_sag=5%"], "vehicle.battery_sag is 0"),
        (["sobol", *HOVER, "--metric", "rms"], "--metric: rms is not a metric of hover; did you mean rmse"),
        (["sobol", *HOVER, "--points", "100"], "num_points is 100, but must be a power of two"),
    ],
)
def test_invalid_options_of_the_robustness_commands_are_refused_in_one_sentence(run, tmp_path, arguments, message):
    result = run(*arguments, "--output", tmp_path / "out")
    assert result.returncode == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr


def test_percentages_are_parsed():
    assert (risk.parse_percent("30%"), risk.parse_percent(" 5 % "), risk.parse_percent("12.5")) == (0.3, 0.05, 0.125)
