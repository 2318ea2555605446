"""Tests that initial values of episodes are computed in advance."""

import math

import numpy as np
import pytest

from drake_quad.flight.mission import plan_route
from drake_quad.gym import episodes as module
from drake_quad.gym.episodes import Episodes
from drake_quad.gym.task import environment_scenario


@pytest.mark.parametrize(("n", "max_episodes"), [(1, 32), (500, 4096), (4097, 2 * 4097)])
def test_the_number_of_episodes_in_memory_is_bounded(n, max_episodes):
    """The memory contains the current and the next episode of each vehicle, and further episodes in small fleets."""
    scenario = environment_scenario("hover")
    episodes = Episodes(scenario, plan_route(scenario), n, outputs=("state",))
    for rows in episodes._ready:
        assert 2 * n <= math.prod(rows.shape[:2]) <= max_episodes


@pytest.mark.long
def test_a_vehicle_with_more_resets_than_others_gets_its_own_next_episode(monkeypatch):
    """Further episodes of this vehicle are computed on demand, while other vehicles still have unused episodes."""
    scenario = environment_scenario("robustness")
    plan = plan_route(scenario)

    def parameters(*vehicles):
        episodes = Episodes(scenario, plan, 2, outputs=("state",))
        for each in vehicles:
            actual = episodes.begin(np.array(each)).parameters
        return actual

    # All episodes are computed at the start.
    expected = parameters([0, 1], [0], [0, 1])
    monkeypatch.setattr(module, "_MAX_EPISODES_AHEAD", 2)
    np.testing.assert_array_equal(parameters([0, 1], [0], [0, 1]), expected)
    assert not np.array_equal(parameters([0, 1]), expected)
