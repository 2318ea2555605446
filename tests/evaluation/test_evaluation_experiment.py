"""Tests of which flights an evaluation selects. Stubs replace the flights and record their arguments."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from invented_flights import NUM_FLIGHTS, flights

from drake_quad import InputError, load_scenario
from drake_quad.design.certificate import certify_hover
from drake_quad.design.tuning import Budget, LoopLimit, TuningResult
from drake_quad.evaluation import experiment, protocol
from drake_quad.evaluation.designs import design_file, read_designs, write_designs
from drake_quad.evaluation.entries import controller_entries
from drake_quad.evaluation.experiment import (
    QUICK,
    EvaluationSizes,
    fly_evaluation,
    fly_family,
    fly_laps,
    fly_sensitivity_variants,
    missing_designs,
)
from drake_quad.evaluation.families import FAMILIES, FIRST_EVALUATION_SAMPLE, LaboratoryFamily, overrides_for_laps
from drake_quad.evaluation.results import (
    SENSITIVITY_LIMITS,
    SENSITIVITY_VARIANT_CONTROLLERS,
    SENSITIVITY_VARIANTS,
    Traits,
    laboratory_with_laps,
    sensitivity_variant_name,
)

SIZES = EvaluationSizes(
    samples=7, num_uncompiled_samples=3, num_lap_samples=5, max_laps=3, num_delay_samples=4, max_delay_frames=6
)


@pytest.fixture
def replaced_flights(monkeypatch):
    """Replace flights and linear models by stubs that return text, and scenarios by the names of their layers."""

    def layered_name(family, diagrams, laboratory, layers=(), overrides=()):
        return (laboratory, *(layer.rpartition(":")[2] for layer in layers), *overrides)

    monkeypatch.setattr(LaboratoryFamily, "scenario", layered_name)
    monkeypatch.setattr(
        experiment,
        "timed_flights",
        lambda scenario, count, compiled=True: (("flown", scenario, count, compiled), f"time {scenario[0]}"),
    )
    monkeypatch.setattr(experiment, "worst_margins", lambda scenario: (f"peak {scenario}", f"delay {scenario}"))
    monkeypatch.setattr(
        experiment, "delay_flown", lambda scenario, sizes: f"stood {scenario} {sizes.num_delay_samples}"
    )
    monkeypatch.setattr(
        experiment, "single_vehicle_time", lambda scenario, compiled=True: f"lone {scenario} {compiled}"
    )
    monkeypatch.setattr(
        experiment,
        "certified_scales",
        lambda scenario, compiled=True: (f"stable {scenario}", f"unstable {scenario}", compiled),
    )


def test_a_controller_flies_in_each_laboratory_of_its_family(replaced_flights, diagrams):
    family = LaboratoryFamily({"gale": "a", "calm": "b"}, ("calm",), "gale", on_board=False, position_networks=True)
    for name in ("pd", "pd_t2fnn_map", "mpc"):
        *result, last = fly_family(diagrams, "mine", family, name, SIZES)
        uncompiled = name == "mpc"
        count = 3 if uncompiled else 7
        for laboratory, flown in zip(("gale", "calm"), result, strict=True):
            assert flown == (laboratory, name, ("flown", (laboratory, name), count, not uncompiled))
        # The margins of a controller with a network are those of the same controller without it.
        base = ("calm", "mpc" if uncompiled else "pd")
        windy = ("gale", name)
        tolerated = last[2].delay_flown
        times, calm = (f"lone {windy} {not uncompiled}", "time gale"), ("calm", name)
        certificate = (f"stable {calm}", f"unstable {calm}", not uncompiled)
        assert last == (
            "mine",
            name,
            Traits(f"peak {base}", f"delay {base}", tolerated, *times, *certificate),
        )
        assert math.isnan(tolerated) if uncompiled else tolerated == f"stood {windy} 4"


@pytest.mark.long
def test_certified_scales_are_those_of_certify_hover_or_nan_with_a_reason(diagrams):
    lag = "vehicle.rotor_time_constant={uniform: {min: 0.035, max: 0.065}}"
    late = load_scenario("hover", [lag, "laboratory.command_link.delay_ticks=8"])
    actual, expected = experiment.certified_scales(late), certify_hover(late)
    assert actual == (expected.stable_scale, expected.unstable.scale, "")
    learning = load_scenario("hover", [lag], layers=[f"{diagrams}/controllers/paper.yaml:pd_t2fnn"])
    for scenario, compiled, reason in (
        (learning, True, "has poles at 1 in hover, for example those of a learning network's weights"),
        (load_scenario("hover"), True, "there is nothing to certify"),
        (late, False, "cannot be compiled"),
    ):
        missing = experiment.certified_scales(scenario, compiled=compiled)
        assert math.isnan(missing.stable_scale)
        assert reason in missing.not_certified


def test_quick_evaluations_certify_nothing(replaced_flights, diagrams):
    *_, last = fly_family(diagrams, "outdoor", FAMILIES["outdoor"], "pd", QUICK)
    assert last[2].not_certified == "certificates are not computed in a quick test"


def test_margins_do_not_depend_on_the_flight_duration(replaced_flights, diagrams):
    family = FAMILIES["neural_fly"]
    result = list(fly_family(diagrams, "neural_fly", family, "indi_t2fnn_map", SIZES._replace(duration=2.5)))
    assert [laboratory for laboratory, *_ in result] == [*family.laboratories, "neural_fly"]
    assert all(metrics[1][-1] == "duration=2.5" for *_, metrics in result[:-1])
    assert result[-1][2].sensitivity == "peak ('8 m/s', 'indi')"
    assert "duration=2.5" in result[-1][2].delay_flown
    assert QUICK.overrides == ("duration=1.0",)
    assert SIZES.overrides == ()


def test_networks_with_the_position_as_input_and_their_base_controllers_fly_one_to_three_laps(
    replaced_flights, diagrams
):
    entries = ["pd", "pd_t2fnn", "indi", "indi_t2fnn_map", "lqg"]
    result = list(fly_laps(diagrams, "laboratory", FAMILIES["laboratory"], entries, SIZES))
    assert [each[:2] for each in result] == [
        (laboratory_with_laps(n), name) for name in ("indi", "indi_t2fnn_map") for n in (1, 2, 3)
    ]
    for laboratory, name, metrics in result:
        laps = int(laboratory[-1])
        assert metrics == ("flown", ("high wind", name, *overrides_for_laps(laps)), 5, True)
    assert overrides_for_laps(3) == ("route.laps=3", "metrics.first_lap=3")


def test_designs_with_other_sensitivity_limits_fly_in_high_wind(replaced_flights, diagrams):
    result = list(
        fly_sensitivity_variants(diagrams, FAMILIES["laboratory"], ["pd", "lqg"], SIZES._replace(duration=2.0))
    )
    names = [sensitivity_variant_name("lqg", limit) for limit in SENSITIVITY_LIMITS]
    assert [each[:2] for each in result] == [
        (laboratory, name) for name in names for laboratory in ("high wind", "priced")
    ]
    short_flight = ("high wind", names[0], "duration=2.0")
    assert result[0][2] == ("flown", short_flight, 7, True)
    full_flight = ("high wind", names[0])
    assert result[1][2] == Traits(
        f"peak {full_flight}",
        f"delay {full_flight}",
        f"stood {short_flight} 4",
        f"lone {short_flight} True",
        "time high wind",
    )


def test_times_are_cpu_times_per_vehicle_and_tick(monkeypatch, diagrams):
    """A flight of 4 s has 200 ticks.

    Three single flights take 3 s, 1 s, and 0.5 s, since the third crashes after 1 s of flight.
    """
    scenario = load_scenario(diagrams / "laboratory.yaml:nominal")
    clock, fleets, flown = iter([0.0, 14.0, 20.0, 23.0, 30.0, 31.0, 40.0, 40.5]), [], []

    class Fleet:
        def __init__(self, scenario, _plan, count, *, compiled):
            self.scenario, self.duration = scenario, 4.0
            fleets.append((count, compiled))

        def fly(self, samples):
            flown.append([*samples])
            return SimpleNamespace(crash_time=np.array([1.0 if samples[0] == FIRST_EVALUATION_SAMPLE + 2 else np.inf]))

    monkeypatch.setattr(experiment, "StudyFleet", Fleet)
    monkeypatch.setattr(experiment.time, "process_time", lambda: next(clock))
    assert scenario.laboratory.command_link.period == 0.02
    _, fleet_time = experiment.timed_flights(scenario, 7)
    assert fleet_time == pytest.approx(14.0 / 7.0 / 200.0)
    assert experiment.single_vehicle_time(scenario) == pytest.approx(1.0 / 200.0)
    assert fleets == [(7, True), (1, True)]
    assert flown == [
        [*range(FIRST_EVALUATION_SAMPLE, FIRST_EVALUATION_SAMPLE + 7)],
        *([FIRST_EVALUATION_SAMPLE + i] for i in range(3)),
    ]
    clock = iter(range(20))
    experiment.timed_flights(scenario, 3, compiled=False)
    experiment.single_vehicle_time(scenario, compiled=False)
    assert fleets[2:] == [(3, False), (1, False)]


@pytest.mark.parametrize(
    ("crashes_from", "expected"), [(0.0, -0.01), (1.0, 0.0), (4.0, 0.03), (6.0, 0.05), (7.0, math.inf)]
)
def test_the_tolerated_delay_is_one_frame_below_the_first_delay_with_a_crash(
    monkeypatch, diagrams, crashes_from, expected
):
    scenario = load_scenario(diagrams / "laboratory.yaml:nominal")
    latency_frames, recorded = scenario.laboratory.motion_capture.latency_frames, []

    def simulate(batch, plan, *, record, compiled):
        assert not record
        extra_frames = batch.varying[experiment.LATENCY] - latency_frames
        recorded.append((extra_frames.tolist(), batch.samples))
        # Only one of the samples crashes.
        crashed = (extra_frames >= crashes_from) & (np.array(batch.samples) == FIRST_EVALUATION_SAMPLE + 2)
        return SimpleNamespace(fly=recorded.append, metrics=lambda: SimpleNamespace(crashed=crashed))

    monkeypatch.setattr(experiment, "simulate_fleet", simulate)
    assert experiment.delay_flown(scenario, SIZES) == pytest.approx(expected)
    (extra_frames, samples), duration = recorded
    assert extra_frames == [float(frames) for frames in range(7) for _ in range(4)]
    assert samples == (*range(FIRST_EVALUATION_SAMPLE, FIRST_EVALUATION_SAMPLE + 4),) * 7
    assert duration > 10.0


def test_worst_margins_are_the_worst_of_all_loops_at_the_command_link(monkeypatch, diagrams):
    scenario = load_scenario(diagrams / "laboratory.yaml:nominal")
    loops = {
        "one": SimpleNamespace(sensitivity=2.0, delay=0.04),
        "two": SimpleNamespace(sensitivity=1.5, delay=0.03),
        "none": None,
    }
    monkeypatch.setattr(experiment, "link_margins", lambda _: loops)
    assert experiment.worst_margins(scenario) == (2.0, 0.03)

    def refuse(_):
        raise experiment.InputError("no linear model")

    monkeypatch.setattr(experiment, "link_margins", refuse)
    assert all(map(math.isnan, experiment.worst_margins(scenario)))


def test_missing_designs_of_a_family_are_named(tmp_path):
    write_all_designs_but(tmp_path, "outdoor", ("pid", "lqg"))
    assert missing_designs(tmp_path, "outdoor") == ["pid", "lqg"]


def write_all_designs_but(folder, family, names):
    path = design_file(folder, family)
    path.parent.mkdir(parents=True, exist_ok=True)
    designs = {name: {"control": {}} for name in FAMILIES[family].entries if name not in names}
    write_designs(path, designs, comments={})


def test_an_evaluation_is_flown_job_by_job(monkeypatch, tmp_path):
    """The family that contains `LAPS_LABORATORY` also flies several laps, and designs with other sensitivity limits."""
    traits, calls, reports, rows = Traits(1.0, 2.0, 3.0, 4.0, 5.0), [], [], []

    def fly_family(folder, name, family, entry, sizes):
        calls.append((name, entry, sizes))
        yield next(iter(family.laboratories)), entry, flights(0.1)
        yield name, entry, traits

    def fly_laps(folder, name, family, entries, sizes):
        calls.append(("laps", name, family, entries, sizes))
        yield laboratory_with_laps(1), "pd", flights(0.2)

    def fly_sensitivity_variants(folder, family, entries, sizes):
        calls.append(("priced", family, entries, sizes))
        yield SENSITIVITY_VARIANTS, "indi@3", traits

    for name, function in {
        "fly_family": fly_family,
        "fly_laps": fly_laps,
        "fly_sensitivity_variants": fly_sensitivity_variants,
    }.items():
        monkeypatch.setattr(experiment, name, function)
    write_all_designs_but(tmp_path, "outdoor", ["mpc"])
    write_all_designs_but(tmp_path, "laboratory", [])

    def progress(*each):
        reports.append(each)
        rows.append(len((tmp_path / "flights.csv").read_text(encoding="utf-8").splitlines()) - 1)

    families = ["outdoor", "laboratory"]
    result = fly_evaluation(tmp_path, families, QUICK, tmp_path, only=["pd", "mpc"], progress=progress)
    laboratory = FAMILIES["laboratory"]
    assert calls == [
        ("outdoor", "pd", QUICK),
        ("laboratory", "pd", QUICK),
        ("laboratory", "mpc", QUICK),
        ("laps", "laboratory", laboratory, ["pd", "mpc"], QUICK),
        ("priced", laboratory, ["pd", "mpc"], QUICK),
    ]
    names = ["outdoor pd", "laboratory pd", "laboratory mpc", "laps", SENSITIVITY_VARIANTS]
    assert reports == [(done, 5, name) for done, name in enumerate(names, start=1)]
    # The results are written after each job.
    assert rows == [NUM_FLIGHTS, 2 * NUM_FLIGHTS, 3 * NUM_FLIGHTS, 4 * NUM_FLIGHTS, 4 * NUM_FLIGHTS]
    assert {laboratory_name: [*each] for laboratory_name, each in result.flights.items()} == {
        "outdoor": ["pd"], "no wind": ["pd", "mpc"], "high wind, lap 1": ["pd"],
    }  # fmt: skip
    assert {name: [*each] for name, each in result.traits.items()} == {
        "outdoor": ["pd"], "laboratory": ["pd", "mpc"], SENSITIVITY_VARIANTS: ["indi@3"],
    }  # fmt: skip
    for name in ("mpc", "moon"):
        with pytest.raises(InputError, match="none of the chosen controllers has a design"):
            fly_evaluation(tmp_path, ["outdoor"], QUICK, tmp_path, only=[name])
    with pytest.raises(InputError, match="none of the chosen controllers has a design"):
        fly_evaluation(tmp_path, ["laboratory"], QUICK, tmp_path, only=["moon"])


@pytest.fixture
def tuned(monkeypatch):
    """Replace the tuning by a stub that returns the middle of each range, and return its recorded arguments."""
    calls = []

    def tune(scenarios, parameters, fractions, *, budget, extra_latency=0.0, before=None, progress=None):
        calls.append((scenarios, fractions, budget, extra_latency, before))
        numbers = tuple(math.sqrt(parameter.low * parameter.high) for parameter in parameters)
        return TuningResult(numbers, 0.1234, 0.876 if fractions is None else 1.7)

    monkeypatch.setattr(protocol, "tune", tune)
    return calls


@pytest.mark.slow
def test_designs_with_other_sensitivity_limits_are_written_to_the_file_of_sensitivity_variants(
    tuned, monkeypatch, diagrams, tmp_path
):
    """INDI is tuned by the search and LQG from Riccati equations, each with four limits."""
    lqg, limits = load_scenario(diagrams / "laboratory.yaml:nominal"), []
    folder = tmp_path / "diagrams"
    (folder / "controllers" / "designed").mkdir(parents=True)
    winds = (f"{wind}: {{extends: '{diagrams}/laboratory.yaml:{wind}'}}\n" for wind in ("low_wind", "high_wind"))
    (folder / "laboratory.yaml").write_text("".join(winds), encoding="utf-8")
    monkeypatch.setattr(
        protocol, "design_lqg", lambda flown_scenario, lqg_limits: limits.append((flown_scenario, lqg_limits)) or lqg
    )
    monkeypatch.setattr(LoopLimit, "margin_ratios", lambda limit, scenario: limit.sensitivity)
    budget = Budget(rounds=2, candidates=4)
    designs = list(protocol.design_sensitivity_variants(folder, budget=budget))
    path = design_file(folder, "priced")
    names = [
        sensitivity_variant_name(name, limit)
        for name in SENSITIVITY_VARIANT_CONTROLLERS
        for limit in SENSITIVITY_LIMITS
    ]
    assert [each.name for each in designs] == [*read_designs(path)] == names
    assert list(path.parent.iterdir()) == [path]
    assert path.read_text(encoding="utf-8").startswith(
        "# Controllers for laboratory.yaml that were designed with other limits on the peak sensitivity"
    )
    entry = controller_entries(on_board=False, position_networks=False)["indi"]
    assert read_designs(path)["indi@1.6"] == entry.geometric_mean()
    for (scenarios, fractions, used_budget, extra_latency, _), limit in zip(tuned, SENSITIVITY_LIMITS, strict=True):
        assert [each.name for each in scenarios] == ["low_wind", "high_wind"]
        assert fractions(scenarios[0]) == limit
        assert (used_budget, extra_latency) == (budget, 0.0)
    assert designs[0].description == f"{len(entry.parameters)} numbers tuned in 2 rounds, 12.34 cm in training"
    assert [lqg_limits.sensitivity for _, lqg_limits in limits] == [*SENSITIVITY_LIMITS]
    assert {(flown_scenario.name, lqg_limits.delay) for flown_scenario, lqg_limits in limits} == {("high_wind", 0.05)}
    assert read_designs(path)["lqg@3"]["control"] == lqg.control.model_dump(mode="json", exclude_none=True)
    assert designs[-1].description == "designed from Riccati equations"


@pytest.mark.slow
def test_a_network_is_tuned_with_an_additional_delay_instead_of_a_limit_on_the_linear_loop(
    tuned, monkeypatch, diagrams, tmp_path
):
    """The additional delay is the delay that the controller tolerates without a network.

    If the file already contains a design of the network, this design is a candidate of the search.
    """
    folder = tmp_path / "diagrams"
    (folder / "controllers" / "designed").mkdir(parents=True)
    (folder / "mine.yaml").write_text(f"mine: {{extends: '{diagrams}/laboratory.yaml:low_wind'}}\n", encoding="utf-8")
    family = LaboratoryFamily(
        {"low wind": "mine.yaml"},
        ("low wind",),
        "low wind",
        lap_overrides=overrides_for_laps(2),
        position_networks=True,
    )
    calls = []

    def tolerated(scenarios, max_delay, *, budget):
        calls.append((scenarios, max_delay, budget))
        return 0.03

    monkeypatch.setattr(protocol, "tolerated_delay", tolerated)
    entries = {
        name: controller_entries(on_board=False, position_networks=True)[name]
        for name in ("pd", "pd_t2fnn", "pd_t2fnn_map")
    }
    budget = Budget(rounds=3)
    designs = list(protocol.design_family(folder, "mine", family, entries, budget=budget))
    suffix = "numbers tuned in 3 rounds, 12.34 cm in training, also with 30 ms of extra delay, meets 88 % of the limit"
    assert [each.description for each in designs] == [
        "6 numbers tuned in 3 rounds, 12.34 cm in training",
        *(f"{len(entries[name].parameters)} {suffix}" for name in ("pd_t2fnn", "pd_t2fnn_map")),
    ]
    assert [(fractions is None, extra_latency, before) for _, fractions, _, extra_latency, before in tuned] == [
        (False, 0.0, None), (True, 0.03, None), (True, 0.03, None),
    ]  # fmt: skip
    assert [(max_delay, given) for _, max_delay, given in calls] == [(0.05, budget)] * 2
    assert all(flown_scenarios[0].control.network is None for flown_scenarios, *_ in calls)
    # Only networks that depend on the position are trained in laps.
    assert [scenarios[0].route.laps for scenarios, *_ in tuned] == [1, 1, 2]
    again = list(protocol.design_family(folder, "mine", family, {"pd": entries["pd"]}, budget=budget))
    assert tuned[-1][4] == pytest.approx(
        [math.sqrt(parameter.low * parameter.high) for parameter in entries["pd"].parameters], rel=1e-3
    )
    assert [each.name for each in again] == ["pd"]
    text = design_file(folder, "mine").read_text(encoding="utf-8")
    assert "family mine of" in text
    assert "peak sensitivity of 2.2 and a delay margin of 50 ms" in text
