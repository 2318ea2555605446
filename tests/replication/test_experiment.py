"""Tests of sweeps and of the experiment, in which all settings of a sweep fly in one fleet."""

import numpy as np
import pytest

from drake_quad import load_scenario, read_study, simulate
from drake_quad.files import read_table
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_samples
from drake_quad.laboratory.metrics import Metrics
from drake_quad.replication import experiment
from drake_quad.replication.experiment import (
    QUICK,
    ExperimentSizes,
    RecordedCell,
    SweepPlan,
    _fly_cell,
    _record_cell,
    fly_experiment,
    sweep_plans,
)
from drake_quad.replication.measures import CURVED_LEGS, STRAIGHT_LEGS, LegMetrics
from drake_quad.replication.published import CONTROLLERS, WINDS
from drake_quad.replication.results import FAIR_CONTROLLERS, select_cells
from drake_quad.replication.sweeps import (
    BEST_GAIN_RANGES,
    NOISE_SETTINGS,
    Q_SETTINGS,
    SLOPE_SETTINGS,
    SLOPES,
    fly_legs,
    fly_settings,
    gain_settings,
    load_sweep,
    num_rows,
)
from drake_quad.studies import monte_carlo
from drake_quad.studies.flying import fly_batch

PAPER_SCENARIOS = "diagrams/paper.yaml"
POSITION = "control.position"


def scenario(name, *overrides):
    return load_scenario(f"{PAPER_SCENARIOS}:{name}", ["duration=1.5", *overrides])


@pytest.mark.long
def test_recorded_samples_equal_single_flights():
    study = scenario("low_wind_pd_t2fnn")
    for sample, flight in zip((4, 2), simulate_samples(study, [4, 2]), strict=True):
        single_flight = simulate(study, sample=sample, compiled=False)
        assert flight.scenario == single_flight.scenario
        np.testing.assert_array_equal(flight.time, single_flight.time)
        for name, values in single_flight.signals.items():
            np.testing.assert_allclose(flight[name], values, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(flight.metrics, single_flight.metrics, rtol=1e-9)


@pytest.mark.slow
def test_settings_in_a_fleet_give_the_same_error_as_overrides_of_the_scenario():
    settings = {name: values[[1, 5]] for name, values in NOISE_SETTINGS.items()}
    result = fly_settings(scenario("no_wind_pd_t2fnn"), settings, [0, 3])
    noise, a1, a2 = (settings[name][1] for name in ("noise", "a1", "a2"))
    overrides = [
        f"laboratory.motion_capture.position_noise={noise}",
        f"control.network.a1={a1}",
        f"control.network.a2={a2}",
    ]
    single_metrics = simulate(scenario("no_wind_pd_t2fnn", *overrides), sample=3, compiled=False).metrics
    assert result.rmse.shape == (2, 2)
    assert result.rmse[1, 1] == pytest.approx(single_metrics.rmse, rel=1e-9)


@pytest.mark.slow
def test_exponents_of_one_give_the_type_1_network():
    settings = {name: values[:1] for name, values in Q_SETTINGS.items()}
    assert (settings["a1"][0], settings["a2"][0]) == (1.0, 1.0)
    result = fly_settings(scenario("no_wind_pd_t2fnn"), settings, [0])
    assert result.rmse[0, 0] == pytest.approx(simulate(scenario("no_wind_pd_t1fnn"), sample=0).metrics.rmse, rel=1e-9)


@pytest.mark.slow
def test_gains_apply_to_both_horizontal_axes():
    settings = {name: values[[7]] for name, values in gain_settings(4).items()}
    result = fly_settings(scenario("no_wind_pd"), settings, [1])
    gains = [f"{POSITION}.{name}.{axis}={settings[name][0]}" for name in ("k_p", "k_d") for axis in (0, 1)]
    assert result.rmse[0, 0] == pytest.approx(simulate(scenario("no_wind_pd", *gains), sample=1).metrics.rmse, rel=1e-9)


def test_every_leg_except_the_rise_is_listed_as_straight_or_curved():
    names = {leg.name for leg in plan_route(scenario("no_wind_pd")).legs}
    assert names == {"rise", *STRAIGHT_LEGS, *CURVED_LEGS}


@pytest.mark.slow
def test_leg_errors_add_up_to_the_total():
    study = load_scenario(f"{PAPER_SCENARIOS}:no_wind_pd")
    errors = fly_legs(study, {"k_p": np.array([1.447]), "k_d": np.array([1.684])}, [0])
    rmse = simulate(study, sample=0).metrics.rmse
    low, high = sorted((errors.straight[0, 0], errors.curved[0, 0]))
    assert low < rmse < high or rmse == pytest.approx(low, rel=0.1)
    assert errors.swing[0, 0] > 0.0


def test_the_experiment_has_the_numbers_of_flights_that_the_report_states():
    assert ExperimentSizes() == (1000, 8, 60, 16, 4, 16)
    assert QUICK == (4, 4, 4, 5, 2, 2)
    flights = {
        name: num_rows(plan.settings) * plan.num_samples for name, plan in sweep_plans(ExperimentSizes()).items()
    }
    assert flights == {
        "noise": 15 * 60,
        "q": 15 * 60,
        **{f"slope_{wind}": 7 * 60 for wind in WINDS},
        "map_pd": 256 * 4,
        "map_pd_t2fnn": 256 * 4,
        "legs": 256 * 16,
    }


def fail(failed_part):
    raise ArithmeticError(f"{failed_part} failed")


def test_a_cell_with_a_failed_sample_is_refused(tmp_path, monkeypatch):
    def fly_some(job, samples):
        return fail("sample 1") if 1 in samples else fly_batch(job, samples)

    monkeypatch.setattr(monte_carlo, "fly_batch", fly_some)
    with pytest.raises(RuntimeError, match="sample 1 of hover could not be flown: .*ArithmeticError: sample 1 failed"):
        _fly_cell(load_scenario("diagrams/hover.yaml", ["duration=0.1"]), 2, tmp_path, compiled=True)


@pytest.mark.parametrize(
    ("count", "sizes"), [(64, [15]), (100, [10, 5]), (300, [3] * 5), (1024, [1] * 15), (3000, [1] * 15)]
)
def test_a_fleet_flies_as_many_settings_as_fit_into_it(count, sizes):
    """A fleet has at most 1,024 vehicles, unless a single setting has more samples."""
    settings = Q_SETTINGS
    jobs = SweepPlan(None, settings, count, fly=return_arguments).jobs("q", "a scenario", compiled=False)
    assert [job.size for job in jobs] == [size * count for size in sizes]
    assert {job.name for job in jobs} == {"q"}
    first = 0
    for job, size in zip(jobs, sizes, strict=True):
        (scenario,), options = job.call()
        assert (scenario, options["samples"], options["compiled"]) == ("a scenario", range(count), False)
        for name, values in settings.items():
            np.testing.assert_array_equal(options["settings"][name], values[first : first + size])
        first += size


def return_arguments(*arguments, **options):
    return arguments, options


@pytest.mark.slow
def test_recorded_samples_are_the_first_samples_of_their_table_cell(tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "measures", lambda flight: {"twice": 2.0 * flight.metrics.rmse, "once": 1.0})
    study = scenario("low_wind_pd_t2fnn", "duration=0.3")
    _fly_cell(study, 3, tmp_path, compiled=True)
    cell = read_study(tmp_path)
    first, numbers = _record_cell(study, 2, compiled=True)
    assert list(numbers) == ["twice", "once"]
    np.testing.assert_allclose(numbers["twice"], 2.0 * cell.metrics.rmse[:2], rtol=1e-9)
    np.testing.assert_array_equal(numbers["once"], [1.0, 1.0])
    assert first.metrics.rmse == pytest.approx(cell.metrics.rmse[0], rel=1e-9)


@pytest.mark.slow
def test_a_resumed_cell_is_identical_to_an_uninterrupted_one(tmp_path):
    study = scenario("no_wind_pid", "duration=0.3")
    _fly_cell(study, 3, tmp_path, compiled=True)
    path = tmp_path / "results.csv"
    uninterrupted = path.read_bytes()
    path.write_bytes(b"".join(uninterrupted.splitlines(keepends=True)[:2]))
    _fly_cell(study, 3, tmp_path, compiled=True)
    assert path.read_bytes() == uninterrupted


def test_a_written_experiment_can_be_read(tmp_path, monkeypatch):
    """In place of flights, the test writes numbers that depend on the arguments of each flight."""
    sizes = ExperimentSizes(cells=6, recorded=3, sweep=4, grid=2, map=3, legs=2)
    cells, progress_calls = {}, []

    def fly_cell(scenario, count, folder, *, compiled):
        assert not compiled
        assert not (folder / "old").exists()
        cells[scenario] = (count, folder)

    def record_cell(scenario, count, *, compiled):
        assert not compiled
        return RecordedCell(f"flight of {scenario}", {"pd_fade": np.arange(count) + len(scenario)})

    def fly_settings(scenario, settings, samples, *, compiled):
        assert not compiled
        number = next(iter(settings.values()))[:, np.newaxis] + 100.0 * np.arange(len(samples)) + len(scenario)
        return Metrics(*(first_metric + number for first_metric in range(len(Metrics._fields))))

    def fly_legs(scenario, settings, samples, *, compiled):
        assert (scenario, compiled) == ("no_wind_pd", False)
        rows = settings["k_p"][:, np.newaxis] + 10.0 * settings["k_d"][:, np.newaxis] + 100.0 * np.array(samples)
        return LegMetrics(rows, rows + 1000.0, rows + 2000.0)

    def plans(sizes):
        result = {name: plan._replace(fly=fly_settings, max_vehicles=12) for name, plan in sweep_plans(sizes).items()}
        return result | {"legs": result["legs"]._replace(fly=fly_legs)}

    for name, function in {"_fly_cell": fly_cell, "_record_cell": record_cell, "sweep_plans": plans}.items():
        monkeypatch.setattr(experiment, name, function)
    old_file = tmp_path / "cells" / "no_wind_pd" / "old"
    old_file.parent.mkdir(parents=True)
    old_file.touch()
    result = fly_experiment(
        lambda cell: cell.scenario, sizes, tmp_path, compiled=False, progress=lambda *each: progress_calls.append(each)
    )
    assert result == {cell: f"flight of {cell.scenario}" for cell in select_cells(CONTROLLERS)}
    assert cells == {
        f"{wind}_{name}": (6, tmp_path / "cells" / f"{wind}_{name}")
        for wind in WINDS
        for name in (*CONTROLLERS, *FAIR_CONTROLLERS)
    }
    steps = {name: 0 for *_, name in progress_calls}
    for (done, _, name), previously_done in zip(progress_calls, [0, *(done for done, *_ in progress_calls)]):
        steps[name] += done - previously_done
    assert steps == {
        **{f"{wind}_{name}": 6 for wind in WINDS for name in (*CONTROLLERS, *FAIR_CONTROLLERS)},
        **{f"recorded {wind}_{name}": 3 for wind in WINDS for name in CONTROLLERS},
        "noise": 60,
        "q": 60,
        "map_pd": 12,
        "map_pd_t2fnn": 12,
        "legs": 8,
        **{f"slope_{wind}": 28 for wind in WINDS},
    }
    assert {total for _, total, _ in progress_calls} == {sum(steps.values())}

    recorded = read_table(tmp_path / "recorded.csv")
    assert len(recorded["sample"]) == 3 * len(WINDS) * len(CONTROLLERS)
    for wind, name, sample, value in zip(*recorded.values(), strict=True):
        assert value == sample + len(f"{wind}_{name}")
    expected = {
        "noise": (NOISE_SETTINGS, 4, "no_wind_pd_t2fnn"),
        "q": (Q_SETTINGS, 4, "no_wind_pd_t2fnn"),
        **{f"slope_{wind}": (SLOPE_SETTINGS, 4, f"{wind}_pd_t2fnn") for wind in WINDS},
        **{f"map_{name}": (gain_settings(2), 3, f"no_wind_{name}") for name in ("pd", "pd_t2fnn")},
    }
    for name, (settings, count, flown) in expected.items():
        sweep = load_sweep(tmp_path / f"{name}.csv", Metrics)
        assert sweep.samples.tolist() == list(range(count))
        assert list(sweep.settings) == list(settings)
        for number, values in settings.items():
            np.testing.assert_array_equal(sweep.settings[number], values)
        np.testing.assert_array_equal(sweep.metrics, fly_settings(flown, settings, range(count), compiled=False))
    legs = load_sweep(tmp_path / "legs.csv", LegMetrics)
    np.testing.assert_array_equal(
        legs.metrics, fly_legs("no_wind_pd", gain_settings(2, BEST_GAIN_RANGES), [0, 1], compiled=False)
    )
    np.testing.assert_array_equal(legs.settings["k_p"], gain_settings(2, BEST_GAIN_RANGES)["k_p"])
    assert (legs.samples.tolist(), len(SLOPES)) == ([0, 1], 7)

    old_file.parent.mkdir(parents=True)
    old_file.touch()
    monkeypatch.setattr(experiment, "_fly_cell", lambda *_, compiled: None)
    fly_experiment(lambda cell: cell.scenario, sizes, tmp_path, resume=True, compiled=False)
    assert old_file.exists()


def test_a_cell_is_flown_in_one_fleet(tmp_path, monkeypatch):
    """A second call with more samples keeps the existing results, and flies only the missing samples."""
    sizes = []

    def fly_and_tell(job, samples):
        sizes.append(len(samples))
        return fly_batch(job, samples)

    monkeypatch.setattr(monte_carlo, "fly_batch", fly_and_tell)
    for count in (4, 7):
        _fly_cell(load_scenario("diagrams/hover.yaml", ["duration=0.1"]), count, tmp_path, compiled=True)
    assert sizes == [4, 3]
