"""Tests of Monte Carlo studies of worlds."""

import numpy as np
import pytest

from drake_quad import InputError, World, load_scenario, simulate_worlds, study_world
from drake_quad.worlds import study as module


@pytest.fixture(scope="module")
def world():
    overrides = ["route={kind: hover, duration: 2.0}", "metrics={start: 0, end: null}"]
    scenario = load_scenario("robustness", overrides)
    offsets = {"a": (0.0, 0.0, 0.0), "b": (0.7, 0.0, 0.0)}
    return World.formation(scenario, offsets, radius=0.25, downwash=None)


@pytest.mark.slow
def test_a_study_has_the_metrics_and_collisions_of_recorded_flights(world, monkeypatch):
    monkeypatch.setattr(module, "_MAX_WORLDS", 8)
    counts = []
    study = study_world(world, 20, progress=counts.append)
    assert counts == [8, 8, 4]
    flown = simulate_worlds(world, range(20))
    np.testing.assert_array_equal(study.collided, [bool(each.collisions) for each in flown])
    assert 0 < study.collided.sum() < 20
    assert study.collision_probability.value == study.collided.mean()
    for name in world.vehicles:
        expected = [each.flights[name].metrics.rmse for each in flown]
        np.testing.assert_allclose(study.metrics[name].rmse, expected, rtol=1e-9)
    expected = [[each.flights[name]["clearance"].min() for name in world.vehicles] for each in flown]
    np.testing.assert_allclose(study.smallest_clearances, expected, rtol=1e-9)


@pytest.mark.slow
def test_a_study_depends_only_on_its_seed(world):
    first, repeated, other = (study_world(world, 5, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.smallest_clearances, repeated.smallest_clearances)
    assert not np.array_equal(first.smallest_clearances, other.smallest_clearances)


def test_a_study_needs_a_sample(world):
    with pytest.raises(InputError, match="num_samples is 0, but must be at least 1"):
        study_world(world, 0)
