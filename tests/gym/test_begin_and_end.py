"""Tests of the defaults and seeds of environments, and of the last completed episode."""

import numpy as np
import pytest

from drake_quad import InputError
from drake_quad.errors import InputWarning
from drake_quad.gym import QuadrotorVectorEnv


def hover(**options):
    return QuadrotorVectorEnv("hover", {"duration": 0.2}, **options)


def test_an_environment_has_one_vehicle_and_records_no_actions_by_default():
    envs = hover()
    assert envs.num_envs == 1
    envs.reset(seed=0)
    envs.step(np.zeros((1, 3)))
    with pytest.raises(InputError, match="actions are not recorded"):
        envs.flight()


def test_a_fleet_that_does_not_fit_into_memory_is_refused_immediately():
    with pytest.raises(InputError, match="num_envs is"):
        hover(num_envs=10**12)


def test_a_seed_also_seeds_the_generator_of_the_environment():
    envs = hover(num_envs=2)
    envs.reset(seed=7)
    assert envs.np_random_seed == 7
    # The first reset also draws a seed for vehicles without a seed, so the generator is compared after the second
    # reset.
    envs.reset(seed=7)
    drawn = envs.np_random.random()
    # Seeds of single vehicles and resets without a seed do not change the generator.
    envs.reset(seed=[1, 2])
    envs.reset(seed=np.array([3, 4]))
    envs.reset()
    assert envs.np_random_seed == 7
    envs.reset(seed=7)
    assert envs.np_random.random() == drawn


def test_reset_options_without_a_mask_reset_all_vehicles():
    envs = hover(num_envs=2)
    envs.reset(seed=1, options={})
    envs.reset(options={"reset_mask": None})
    assert [envs.episode(i).sample for i in range(2)] == [1, 1]
    with pytest.raises(InputError, match="reset_mask must contain 2 Booleans, at least one of them True"):
        envs.reset(options={"reset_mask": np.array([False, False])})


@pytest.mark.parametrize("ticks", [1, 2])
def test_an_episode_without_a_tick_is_not_the_last_completed_one(ticks):
    """A reset completes the current episode only if it has at least one tick."""
    envs = hover(num_envs=2, record=True)
    envs.reset(seed=3)
    for _ in range(ticks):
        envs.step(np.full((2, 3), 0.1))
    for _ in range(3):
        envs.reset()
    flight = envs.flight(1)
    assert len(flight.time) == ticks + 1
    assert (flight.scenario.seed, flight.scenario.sample) == (4, 0)


def test_an_environment_warns_of_a_route_that_ends_in_motion():
    route = {
        "kind": "lissajous",
        "centre": [0, 0, 1],
        "amplitude": [1, 1, 0],
        "turns": [1, 2, 0],
        "period": 4.0,
        "laps": 1,
    }
    with pytest.warns(InputWarning, match=r"^the route ends in motion \(.*\) at 4\.00 s"):
        QuadrotorVectorEnv("figure_eight", {"route": route, "duration": 20.0}, action="rates")


def test_reset_options_that_are_no_dictionary_are_refused():
    environment = QuadrotorVectorEnv("figure_eight", {"duration": 1.0}, action="rates")
    with pytest.raises(InputError, match="^options is 5, but must be a dictionary$"):
        environment.reset(seed=0, options=5)


@pytest.mark.parametrize("action", [np.ma.masked_all((1, 4)), np.full((1, 4), np.longdouble("1e4000"))])
def test_masked_and_huge_actions_are_refused(action):
    environment = QuadrotorVectorEnv("figure_eight", {"duration": 1.0}, action="rates")
    environment.reset(seed=0)
    with pytest.raises(InputError, match="action"):
        environment.step(action)
