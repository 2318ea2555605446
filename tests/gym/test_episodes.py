"""The episodes that an environment prepares."""

import math

import pytest

from drake_quad.assembly.planning import plan_route
from drake_quad.gym.episodes import Episodes
from drake_quad.gym.task import task_of


@pytest.mark.parametrize(("n", "most"), [(1, 32), (500, 4096), (4097, 2 * 4097)])
def test_the_memory_of_prepared_episodes_is_bounded(n, most):
    """Each vehicle has room for its episode and the next one, and only a small fleet has room for more."""
    scenario = task_of("hover")
    episodes = Episodes(scenario, plan_route(scenario), n, shown=("state",))
    for rows in episodes._ready:
        assert 2 * n <= math.prod(rows.shape[:2]) <= most
