"""What beyond the cells is flown: settings side by side fly as they would alone."""

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.assembly.planning import plan_route
from drake_quad.flight import simulate_samples
from drake_quad.replication.experiment import QUICK, Sizes, _fly_cell, _Jobs
from drake_quad.replication.measures import CURVED, STRAIGHT
from drake_quad.replication.sweeps import fly_legs, fly_settings, gain_settings, noise_settings, q_settings
from drake_quad.studies import monte_carlo
from drake_quad.studies.flying import fly_batch
from drake_quad.studies.processes import Workers

PAPER = "diagrams/paper.yaml"
POSITION = "control.position"


def scenario(name, *overrides):
    return load_scenario(f"{PAPER}:{name}", ["duration=1.5", *overrides])


def test_recorded_samples_are_those_flown_alone():
    study = scenario("low_wind_pd_t2fnn")
    for sample, flight in zip((4, 2), simulate_samples(study, [4, 2]), strict=True):
        alone = simulate(study, sample=sample)
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
        f"{POSITION}.network.a1={a1}",
        f"{POSITION}.network.a2={a2}",
    ]
    alone = simulate(scenario("no_wind_pd_t2fnn", *overrides), sample=3).metrics
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
        _fly_cell(load_scenario("diagrams/hover.yaml", ["duration=0.1"]), 2, tmp_path)
