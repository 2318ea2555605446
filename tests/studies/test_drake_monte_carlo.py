"""Drake's Monte Carlo tool and ours, of which no code is common but the systems, fly samples of one distribution."""

import numpy as np
import pytest
from scipy import stats

from drake_quad import load_scenario
from drake_quad.studies import run_monte_carlo
from drake_quad.studies.drake_monte_carlo import drake_monte_carlo

OVERRIDES = ["duration=1.0", "crash.position_error=0.2"]


@pytest.mark.parametrize("path", ["diagrams/robustness.yaml", "diagrams/laboratory.yaml:low_wind"])
def test_the_two_agree(path):
    """In distribution, by the tests of Kolmogorov and Smirnov and, for crashes, of Fisher."""
    scenario = load_scenario(path, OVERRIDES)
    theirs, ours = drake_monte_carlo(scenario, 50, seed=3), run_monte_carlo(scenario, 2000, seed=3).metrics
    for name in ("rmse", "rmse_x", "rmse_z", "peak_error", "effort_y", "variation_x"):
        samples = [getattr(metrics, name)[~metrics.crashed] for metrics in (theirs, ours)]
        assert len(np.unique(samples[0])) == len(samples[0]) > 20
        assert stats.ks_2samp(*samples).pvalue > 0.01
    counts = [[metrics.crashed.sum(), (~metrics.crashed).sum()] for metrics in (theirs, ours)]
    assert stats.fisher_exact(counts).pvalue > 0.01


def test_a_seed_gives_the_same_flights_again():
    scenario = load_scenario("diagrams/robustness.yaml", ["duration=0.2"])
    first, again, other = (drake_monte_carlo(scenario, 3, seed=seed).rmse for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.isin(other, first).any()


def test_all_ticks_count():
    """What is left pending at the end is done: as many ticks as in a flight of ours."""
    scenario = load_scenario("diagrams/laboratory.yaml:nominal", ["duration=0.2", "metrics.start=0.199"])
    assert np.isfinite(drake_monte_carlo(scenario, 1).rmse[0])
    assert np.isfinite(run_monte_carlo(scenario, 1).metrics.rmse[0])
