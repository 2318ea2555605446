"""What beyond the cells is flown: settings side by side fly as they would alone."""

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
    Sizes,
    _fly_cell,
    _Jobs,
    _record_cell,
    _Recorded,
    _submit_sweep,
    fly_experiment,
)
from drake_quad.replication.measures import CURVED, STRAIGHT, LegMetrics
from drake_quad.replication.printed import CONTROLLERS, WINDS
from drake_quad.replication.results import FAIR, cells_of
from drake_quad.replication.sweeps import (
    SLOPES,
    best_gain_settings,
    fly_legs,
    fly_settings,
    gain_settings,
    load_sweep,
    noise_settings,
    q_settings,
    slope_settings,
)
from drake_quad.studies import monte_carlo
from drake_quad.studies.crew import attempt
from drake_quad.studies.flying import fly_batch
from drake_quad.studies.processes import Workers
from drake_quad.studies.study_folder import StudyRows

PAPER = "diagrams/paper.yaml"
POSITION = "control.position"


def scenario(name, *overrides):
    return load_scenario(f"{PAPER}:{name}", ["duration=1.5", *overrides])


def test_recorded_samples_are_those_flown_alone():
    study = scenario("low_wind_pd_t2fnn")
    for sample, flight in zip((4, 2), simulate_samples(study, [4, 2]), strict=True):
        alone = simulate(study, sample=sample, compiled=False)
        assert flight.scenario == alone.scenario
        np.testing.assert_array_equal(flight.time, alone.time)
        for name, values in alone.signals.items():
            np.testing.assert_allclose(flight[name], values, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(flight.metrics, alone.metrics, rtol=1e-9)


def test_settings_of_a_fleet_are_those_of_scenarios():
    settings = {name: values[[1, 5]] for name, values in noise_settings().items()}
    found = fly_settings(scenario("no_wind_pd_t2fnn"), settings, [0, 3])
    noise, a1, a2 = (settings[name][1] for name in ("noise", "a1", "a2"))
    overrides = [
        f"laboratory.motion_capture.position_noise={noise}",
        f"control.network.a1={a1}",
        f"control.network.a2={a2}",
    ]
    alone = simulate(scenario("no_wind_pd_t2fnn", *overrides), sample=3, compiled=False).metrics
    assert found.rmse.shape == (2, 2)
    assert found.rmse[1, 1] == pytest.approx(alone.rmse, rel=1e-9)


def test_exponents_of_one_are_the_network_of_type_1():
    settings = {name: values[:1] for name, values in q_settings().items()}
    assert (settings["a1"][0], settings["a2"][0]) == (1.0, 1.0)
    found = fly_settings(scenario("no_wind_pd_t2fnn"), settings, [0])
    assert found.rmse[0, 0] == pytest.approx(simulate(scenario("no_wind_pd_t1fnn"), sample=0).metrics.rmse, rel=1e-9)


def test_gains_are_those_of_both_horizontal_axes():
    settings = {name: values[[7]] for name, values in gain_settings(4).items()}
    found = fly_settings(scenario("no_wind_pd"), settings, [1])
    gains = [f"{POSITION}.{name}.{axis}={settings[name][0]}" for name in ("k_p", "k_d") for axis in (0, 1)]
    assert found.rmse[0, 0] == pytest.approx(simulate(scenario("no_wind_pd", *gains), sample=1).metrics.rmse, rel=1e-9)


def test_legs_are_straight_or_curved_but_for_the_rise():
    names = {leg.name for leg in plan_route(scenario("no_wind_pd")).legs}
    assert names == {"rise", *STRAIGHT, *CURVED}


@pytest.mark.slow
def test_errors_leg_by_leg_make_up_the_whole():
    study = load_scenario(f"{PAPER}:no_wind_pd")
    errors = fly_legs(study, {"k_p": np.array([1.447]), "k_d": np.array([1.684])}, [0])
    rmse = simulate(study, sample=0).metrics.rmse
    low, high = sorted((errors.straight[0, 0], errors.curved[0, 0]))
    assert low < rmse < high or rmse == pytest.approx(low, rel=0.1)
    assert errors.swing[0, 0] > 0.0


def test_as_much_is_flown_as_the_report_says():
    """Three winds with eight controllers; noise, q, slopes in three winds; two maps and the legs."""
    assert Sizes() == (1000, 8, 60, 16, 4, 16)
    assert Sizes().flights == 24 * 1000 + (15 + 15 + 3 * 7) * 60 + 2 * 256 * 4 + 256 * 16
    assert QUICK == (4, 4, 4, 5, 2, 2)
    assert QUICK.flights == 24 * 4 + (15 + 15 + 3 * 7) * 4 + 2 * 25 * 2 + 25 * 2


def fail(what):
    raise ArithmeticError(f"{what} is cursed")


def test_jobs_are_done_by_workers_and_their_failure_is_told():
    seen = []
    with Workers(2) as workers:
        jobs = _Jobs(workers)
        done = [jobs.submit(name, count, int, str(count)) for name, count in (("a", 3), ("b", 4), ("c", 5))]
        jobs.work(lambda what, flights: seen.append((what, flights)))
        assert [job.result for job in done] == [3, 4, 5]
        assert sorted(what for what, _ in seen) == ["a", "b", "c"]
        assert seen[-1][1] == 12
        jobs = _Jobs(workers)
        jobs.submit("d", 1, fail, "this one")
        with pytest.raises(RuntimeError, match="ArithmeticError: this one is cursed"):
            jobs.work(None)


def test_a_cell_with_a_sample_that_cannot_be_flown_is_none(tmp_path, monkeypatch):
    def fly_some(job, samples):
        return fail("sample 1") if 1 in samples else fly_batch(job, samples)

    monkeypatch.setattr(monte_carlo, "fly_batch", fly_some)
    with pytest.raises(RuntimeError, match="sample 1 of hover could not be flown: ArithmeticError: sample 1 is cursed"):
        _fly_cell(load_scenario("diagrams/hover.yaml", ["duration=0.1"]), 2, tmp_path, compiled=True)


class Here:
    """Does tasks in this process, the last that was begun first."""

    def __init__(self, capacity):
        self.capacity, self.under_way, self.most = capacity, [], 0

    def begin(self, function, given):
        self.under_way.append((function, given))
        self.most = max(self.most, len(self.under_way))

    def finished(self):
        return [attempt(*self.under_way.pop())]


@pytest.mark.parametrize(
    ("count", "sizes"), [(64, [15]), (100, [10, 5]), (300, [3] * 5), (1024, [1] * 15), (3000, [1] * 15)]
)
def test_as_many_settings_fly_in_a_fleet_as_there_is_room_for(count, sizes):
    """At least one; as many vehicles as 1,024 otherwise, each on the same samples."""
    jobs, settings = _Jobs(Here(1)), q_settings()
    submitted = _submit_sweep(jobs, "q", "a scenario", settings, count, compiled=False)
    assert [job.flights for job in submitted] == [size * count for size in sizes]
    assert {job.what for job in submitted} == {"q"}
    first = 0
    for job, size in zip(submitted, sizes, strict=True):
        function, (scenario, part, samples) = job.call.func, job.call.args
        assert (function, scenario, samples) == (fly_settings, "a scenario", range(count))
        assert job.call.keywords == {"compiled": False}
        for name, values in settings.items():
            np.testing.assert_array_equal(part[name], values[first : first + size])
        first += size


@pytest.mark.slow
def test_recorded_samples_are_the_first_of_the_cell_and_only_what_is_missing_is_flown(tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "measures", lambda flight: {"twice": 2.0 * flight.metrics.rmse, "once": 1.0})
    added = []
    add_rows = StudyRows.add_rows

    def add_and_tell(rows, new):
        added.append(new[:, 0].tolist())
        add_rows(rows, new)

    monkeypatch.setattr(StudyRows, "add_rows", add_and_tell)
    study = scenario("low_wind_pd_t2fnn", "duration=0.3")
    for count in (3, 5):
        first, numbers = _record_cell(study, count, tmp_path, 2, compiled=True)
        found = read_study(tmp_path)
        assert found.samples.tolist() == list(range(count))
        assert list(numbers) == ["twice", "once"]
        np.testing.assert_allclose(numbers["twice"], 2.0 * found.metrics.rmse[:2], rtol=1e-9)
        np.testing.assert_array_equal(numbers["once"], [1.0, 1.0])
        assert first.metrics.rmse == pytest.approx(found.metrics.rmse[0], rel=1e-9)
    assert added == [[0.0, 1.0], [2.0], [3.0, 4.0]]
    assert found.duration == pytest.approx(0.3)


def test_an_experiment_leaves_every_number_where_it_is_read(tmp_path, monkeypatch):
    """With flights in whose place stands what was asked for, done in another order."""
    sizes = Sizes(cells=6, recorded=3, sweep=4, grid=2, map=3, legs=2)
    cells, told = {}, []

    def fly_cell(scenario, count, folder, *, compiled):
        assert not compiled
        assert not (folder / "old").exists()
        cells[scenario] = (count, folder, None)

    def record_cell(scenario, count, folder, recorded, *, compiled):
        fly_cell(scenario, count, folder, compiled=compiled)
        cells[scenario] = (count, folder, recorded)
        return _Recorded(f"flight of {scenario}", {"pd_fade": np.arange(recorded) + len(scenario)})

    def fly_settings(scenario, settings, samples, *, compiled):
        assert not compiled
        number = next(iter(settings.values()))[:, np.newaxis] + 100.0 * np.arange(len(samples)) + len(scenario)
        return Metrics(*(place + number for place in range(len(Metrics._fields))))

    def fly_legs(scenario, settings, samples, *, compiled):
        assert (scenario, compiled) == ("no_wind_pd", False)
        rows = settings["k_p"][:, np.newaxis] + 10.0 * settings["k_d"][:, np.newaxis] + 100.0 * np.array(samples)
        return LegMetrics(rows, rows + 1000.0, rows + 2000.0)

    fakes = {"_fly_cell": fly_cell, "_record_cell": record_cell, "fly_settings": fly_settings, "fly_legs": fly_legs}
    for name, function in fakes.items():
        monkeypatch.setattr(experiment, name, function)
    monkeypatch.setattr(experiment, "_VEHICLES", 12)
    stale = tmp_path / "cells" / "no_wind_pd" / "old"
    stale.parent.mkdir(parents=True)
    stale.touch()
    workers = Here(3)
    found = fly_experiment(
        lambda cell: cell.scenario, sizes, tmp_path, workers, compiled=False, progress=lambda *each: told.append(each)
    )
    assert workers.most == 3
    assert found == {cell: f"flight of {cell.scenario}" for cell in cells_of(CONTROLLERS)}
    assert cells == {
        f"{wind}_{name}": (6, tmp_path / "cells" / f"{wind}_{name}", 3 if name in CONTROLLERS else None)
        for wind in WINDS
        for name in (*CONTROLLERS, *FAIR)
    }
    assert told[-1][1] == sizes.flights
    assert [done for _, done in told] == sorted(done for _, done in told)
    steps = {what: 0 for what, _ in told}
    for (what, done), before in zip(told, [0, *(done for _, done in told)]):
        steps[what] += done - before
    assert steps == {
        **{f"{wind}_{name}": 6 for wind in WINDS for name in (*CONTROLLERS, *FAIR)},
        "noise": 60,
        "q": 60,
        "map_pd": 12,
        "map_pd_t2fnn": 12,
        "legs": 8,
        **{f"slope_{wind}": 28 for wind in WINDS},
    }

    recorded = read_table(tmp_path / "recorded.csv")
    assert len(recorded["sample"]) == 3 * len(WINDS) * len(CONTROLLERS)
    for wind, name, sample, value in zip(*recorded.values(), strict=True):
        assert value == sample + len(f"{wind}_{name}")
    expected = {
        "noise": (noise_settings(), 4, "no_wind_pd_t2fnn"),
        "q": (q_settings(), 4, "no_wind_pd_t2fnn"),
        **{f"slope_{wind}": (slope_settings(), 4, f"{wind}_pd_t2fnn") for wind in WINDS},
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
    np.testing.assert_array_equal(legs.metrics, fly_legs("no_wind_pd", best_gain_settings(2), [0, 1], compiled=False))
    np.testing.assert_array_equal(legs.settings["k_p"], best_gain_settings(2)["k_p"])
    assert (legs.samples.tolist(), len(SLOPES)) == ([0, 1], 7)

    stale.parent.mkdir(exist_ok=True)
    stale.touch()
    monkeypatch.setattr(experiment, "_record_cell", lambda *_, compiled: _Recorded(None, {"pd_fade": np.zeros(1)}))
    fly_experiment(lambda cell: cell.scenario, sizes, tmp_path, Here(1), resume=True, compiled=False)
    assert stale.exists()


def test_a_cell_is_flown_in_one_fleet(tmp_path, monkeypatch):
    """What is there already stays."""
    sizes = []

    def fly_and_tell(job, samples):
        sizes.append(len(samples))
        return fly_batch(job, samples)

    monkeypatch.setattr(monte_carlo, "fly_batch", fly_and_tell)
    for count in (4, 7):
        _fly_cell(load_scenario("diagrams/hover.yaml", ["duration=0.1"]), count, tmp_path, compiled=True)
    assert sizes == [4, 3]
