"""Tests that `QuadrotorEnv`, the environment with one vehicle, agrees with `QuadrotorVectorEnv`."""

import numpy as np
import pytest

from drake_quad.gym.env import QuadrotorEnv
from drake_quad.gym.episodes import Episode
from drake_quad.gym.vector_env import QuadrotorVectorEnv
from drake_quad.reference.plan import Plan


@pytest.mark.long
def test_a_single_environment_equals_a_vector_environment_with_one_vehicle():
    task = {"duration": 0.1}
    single = QuadrotorEnv("hover", task, render_mode="rgb_array")
    vector = QuadrotorVectorEnv("hover", task, num_envs=1, render_mode="rgb_array")
    assert single.scenario == vector.scenario
    assert isinstance(single.plan, Plan)
    np.testing.assert_array_equal(single.plan.waypoints, vector.plan.waypoints)
    assert single.observation_space == vector.single_observation_space
    assert single.action_space == vector.single_action_space
    # A tick of the scenario lasts 20 ms, so there are 50 frames per second.
    assert single.metadata == {"render_modes": ["rgb_array"], "render_fps": 50}
    for seed, episode in ((4, Episode(4, 0)), (None, Episode(4, 1))):
        observation, infos = single.reset(seed=seed)
        observations, _ = vector.reset(seed=seed)
        np.testing.assert_array_equal(observation, observations[0])
        assert infos == {}
        assert single.episode() == vector.episode() == episode
    frame = single.render()
    assert (frame.shape, frame.dtype) == ((360, 480, 3), np.uint8)
    np.testing.assert_array_equal(frame, vector.render()[0])
    for tick in range(5):
        action = np.array([0.1, -0.1, 0.2 * tick])
        observation, reward, terminated, truncated, info = single.step(action)
        observations, rewards, *_, infos = vector.step([action])
        np.testing.assert_array_equal(observation, observations[0])
        assert reward == rewards[0]
        assert (terminated, truncated) == (False, tick == 4)
        assert bool(info) == (tick == 4)
    flight = infos["flight"]
    assert info["flight"] == {name: flight[name][0] for name in flight if not name.startswith("_")}
    assert {"rmse", "effort_x", "obstacle"} <= info["flight"].keys()
    assert all(isinstance(value, float | int) for value in info["flight"].values())
    assert len(single.flight().time) == 6


def test_an_image_requires_a_render_mode_and_a_flight_requires_recorded_actions():
    env = QuadrotorEnv("hover", record=False)
    env.reset(seed=1)
    assert env.render_mode is None
    assert env.render() is None
    with pytest.raises(ValueError, match="actions are not recorded"):
        env.flight()
