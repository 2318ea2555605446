"""The episodes that an environment prepares."""

import math

import numpy as np
import pytest

from drake_quad.flight.mission import plan_route
from drake_quad.gym import episodes as module
from drake_quad.gym.episodes import Episodes
from drake_quad.gym.task import task_of


@pytest.mark.parametrize(("n", "most"), [(1, 32), (500, 4096), (4097, 2 * 4097)])
def test_the_memory_of_prepared_episodes_is_bounded(n, most):
    """Each vehicle has room for its episode and the next one, and only a small fleet has room for more."""
    scenario = task_of("hover")
    episodes = Episodes(scenario, plan_route(scenario), n, outputs=("state",))
    for rows in episodes._ready:
        assert 2 * n <= math.prod(rows.shape[:2]) <= most


@pytest.mark.slow
def test_a_vehicle_that_is_ahead_of_another_begins_its_own_next_episode(monkeypatch):
    """Its episodes are made ready when it needs them, although the other still has some."""
    scenario = task_of("robustness")
    plan = plan_route(scenario)

    def parameters(*vehicles):
        episodes = Episodes(scenario, plan, 2, outputs=("state",))
        for each in vehicles:
            found = episodes.begin(np.array(each)).parameters
        return found

    # All are ready from the start.
    expected = parameters([0, 1], [0], [0, 1])
    monkeypatch.setattr(module, "_MAX_EPISODES_AHEAD", 2)
    np.testing.assert_array_equal(parameters([0, 1], [0], [0, 1]), expected)
    assert not np.array_equal(parameters([0, 1]), expected)
