"""Tests that the studies of Drake and of this library, which share only the systems, have the same distribution."""

import numpy as np
import pytest
import scipy

from drake_quad import load_scenario
from drake_quad.studies import drake_monte_carlo as drakes_tool
from drake_quad.studies.drake_monte_carlo import drake_monte_carlo
from drake_quad.studies.monte_carlo import run_monte_carlo

OVERRIDES = ["duration=0.5", "crash.position_error=0.05"]


@pytest.mark.long
@pytest.mark.parametrize("path", ["diagrams/robustness.yaml", "diagrams/laboratory.yaml:low_wind"])
def test_drake_and_our_monte_carlo_studies_agree(path):
    """The distributions are compared by the Kolmogorov–Smirnov test and, for crashes, by Fisher's test."""
    scenario = load_scenario(path, OVERRIDES)
    drake_metrics, our_metrics = drake_monte_carlo(scenario, 50, seed=3), run_monte_carlo(scenario, 800, seed=3).metrics
    for name in ("rmse", "rmse_x", "rmse_z", "peak_error", "effort_y", "variation_x"):
        samples = [getattr(metrics, name)[~metrics.crashed] for metrics in (drake_metrics, our_metrics)]
        assert len(np.unique(samples[0])) == len(samples[0]) > 20
        assert scipy.stats.ks_2samp(*samples).pvalue > 0.01
    counts = [[metrics.crashed.sum(), (~metrics.crashed).sum()] for metrics in (drake_metrics, our_metrics)]
    assert scipy.stats.fisher_exact(counts).pvalue > 0.01


@pytest.mark.slow
def test_a_seed_reproduces_the_flights():
    scenario = load_scenario("diagrams/robustness.yaml", ["duration=0.2"])
    first, repeated, other_seed = (drake_monte_carlo(scenario, 3, seed=seed).rmse for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, repeated)
    assert not np.isin(other_seed, first).any()


@pytest.mark.slow
def test_all_ticks_count_for_the_metrics():
    """Updates that are pending at the end are completed, so the number of ticks equals that of `simulate`."""
    scenario = load_scenario("diagrams/laboratory.yaml:nominal", ["duration=0.2", "metrics.start=0.199"])
    assert np.isfinite(drake_monte_carlo(scenario, 1).rmse[0])
    assert np.isfinite(run_monte_carlo(scenario, 1).metrics.rmse[0])


@pytest.mark.slow
def test_sample_indices_are_31_bits_of_drake_s_generator(monkeypatch):
    """The indices cover the whole range, with a given seed and with the seed of the scenario."""
    calls = []

    def draw(scenario, sample, *, seed):
        calls.append((sample, seed))
        return draw_sample(scenario, sample, seed=seed)

    draw_sample = drakes_tool.draw_sample
    monkeypatch.setattr(drakes_tool, "draw_sample", draw)
    scenario = load_scenario("diagrams/hover.yaml", ["duration=0.02", "seed=9"])
    drake_monte_carlo(scenario, 6, seed=4)
    drake_monte_carlo(scenario, 1)
    samples, seeds = zip(*calls, strict=True)
    assert seeds == (4,) * 6 + (9,)
    assert len(set(samples[:6])) == 6
    assert 2**30 <= max(samples) < 2**31


@pytest.mark.slow
def test_drake_s_generator_seeds_wind_and_noise(monkeypatch):
    """Two flights of the same sample differ only in this seed."""
    draw_sample = drakes_tool.draw_sample
    monkeypatch.setattr(drakes_tool, "draw_sample", lambda scenario, _, *, seed: draw_sample(scenario, 0, seed=seed))
    scenario = load_scenario("diagrams/laboratory.yaml:nominal", ["duration=0.1"])
    assert len({*drake_monte_carlo(scenario, 3).rmse}) == 3


@pytest.mark.parametrize(
    ("cameras", "time_step", "extra_time"), [(0.02, 0.01, 0.0025), (0.04, 0.0, 0.005), (0.01, 0.0, 0.0025)]
)
def test_a_flight_ends_between_its_last_tick_and_the_next_event(monkeypatch, cameras, time_step, extra_time):
    """The control period is 20 ms, and the flight ends a quarter of the shortest period after the last tick."""
    calls = []

    def simulate(make_simulator, output, final_time, num_samples, generator):
        calls.append((final_time, num_samples))
        simulator = make_simulator(generator)
        simulator.AdvanceTo(0.0)
        output(simulator.get_system(), simulator.get_context())

    monkeypatch.setattr(drakes_tool, "MonteCarloSimulation", simulate)
    overrides = ["duration=0.4", f"laboratory.motion_capture.period={cameras}", f"vehicle.time_step={time_step}"]
    drake_monte_carlo(load_scenario("diagrams/hover.yaml", overrides), 17)
    assert calls == [(pytest.approx(0.4 + extra_time, abs=1e-9), 17)]
