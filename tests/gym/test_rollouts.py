"""Episodes that are flown again, frames, and policies that are saved."""

import gymnasium
import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.gym import QuadrotorEnv, QuadrotorVectorEnv, save_policy
from drake_quad.gym.saving import Neurons
from drake_quad.visualization.replay.page import save_replay


def test_the_last_episode_is_flown_again_with_all_of_its_signals(tmp_path):
    env = QuadrotorEnv("laboratory:low_wind", {"crash.position_error": 0.3}, action="attitude")
    for seed in (4, 5):
        env.reset(seed=seed)
        terminated, seen, random = False, [], np.random.default_rng(seed)
        while not terminated:
            observation, _, terminated, _, info = env.step(random.uniform(-0.3, 0.3, 4))
            seen.append(observation)
    flight = env.flight()
    assert env.episode() == (5, 0)
    assert flight.metrics.rmse == info["flight"]["rmse"]
    assert flight.metrics.crash_time == info["flight"]["crash_time"] == pytest.approx(0.02 * len(seen))
    np.testing.assert_allclose(flight["observation"][1:], seen, rtol=1e-6, atol=1e-6)
    page = save_replay({"a rollout": flight}, tmp_path / "replay.html")
    assert "a rollout" in page.read_text(encoding="utf-8")
    # The one that is flown now has not ended.
    env.reset()
    env.step(np.zeros(4))
    assert env.flight().metrics.rmse == flight.metrics.rmse


def test_an_episode_that_has_not_ended_is_flown_again_as_far_as_it_is():
    envs = QuadrotorVectorEnv("hover", num_envs=3, record=True)
    envs.reset(seed=0)
    for _ in range(10):
        envs.step(np.full((3, 3), 0.2))
    flight = envs.flight(2)
    assert flight.time[-1] == pytest.approx(0.2)
    assert flight.scenario.seed == 2
    np.testing.assert_allclose(flight["state"][-1], envs._fleet.shown("state")[2], atol=1e-12)


def test_frames_show_the_vehicle_where_it_is():
    overrides = {"space.obstacles.pillar": {"kind": "cylinder", "centre": [1.5, 0, 1], "radius": 0.2, "height": 2}}
    envs = QuadrotorVectorEnv("figure_eight", overrides, num_envs=2, render_mode="rgb_array")
    assert QuadrotorVectorEnv("hover").render() is None
    envs.reset(seed=0)
    first = envs.render()
    assert [frame.shape for frame in first] == [(360, 480, 3)] * 2
    assert first[0].dtype == np.uint8
    for _ in range(40):
        envs.step(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    hanging, climbing = envs.render()
    changed = (hanging != climbing).any(axis=2)
    assert 50 < changed.sum() < 5000
    # The one that climbs is drawn higher: where its rotors are, the other frame is grey or white.
    blue = [frame[..., 2].astype(int) - frame[..., 0] > 60 for frame in (hanging, climbing)]
    low, high = (np.argwhere(where)[:, 0].mean() for where in blue)
    assert high < low - 10
    np.testing.assert_array_equal(envs.render()[0], hanging)


def test_a_network_is_saved_as_a_controller_that_does_what_it_did(tmp_path):
    """A linear policy, flown in the environment and as the controller of a scenario."""
    envs = QuadrotorVectorEnv("figure_eight", {"duration": 3.0}, num_envs=1)
    rng = np.random.default_rng(0)
    size = envs.single_observation_space.shape[0]
    gains = np.zeros((3, size))
    gains[:, :3], gains[:, 3:6], gains[:, 18:21] = 0.3 * np.eye(3), 0.4 * np.eye(3), 0.2 * np.eye(3)
    offset, scale = rng.normal(size=size), rng.uniform(0.5, 2.0, size)
    path = save_policy(envs, [Neurons(gains / scale, gains @ offset)], tmp_path / "mine", offset=offset, scale=scale)
    seen, _ = envs.reset(seed=0)
    for _ in range(150):
        seen, *_, infos = envs.step(np.clip(seen.astype(float) @ gains.T, -1.0, 1.0))
    flight = simulate(load_scenario("figure_eight", {"duration": 3.0}, layers=[path]), compiled=True)
    np.testing.assert_allclose(flight.metrics.rmse, infos["flight"]["rmse"][0], rtol=1e-4)
    assert flight.metrics.rmse < 0.3
    before = path.with_suffix(".npz").read_bytes()
    with pytest.raises(InputError, match="cannot be flown: .*24 rows of input") as wrong:
        save_policy(envs, [Neurons(gains[:, 1:], np.zeros(3))], tmp_path / "mine")
    assert str(path.parent) in str(wrong.value)
    assert path.with_suffix(".npz").read_bytes() == before
    assert sorted(each.name for each in path.parent.iterdir()) == ["policy.npz", "policy.yaml"]


@pytest.mark.parametrize("action", ["acceleration", "attitude", "rates"])
def test_a_policy_for_an_autopilot_is_saved(action, tmp_path):
    env = gymnasium.make("drake_quad/Track-v0", scenario="onboard", action=action)
    rows, size = env.action_space.shape[0], env.observation_space.shape[0]
    path = save_policy(env, [Neurons(np.zeros((rows, size)), np.zeros(rows))], tmp_path)
    assert load_scenario("onboard", layers=[path]).control.action.kind == action
    with pytest.raises(InputError, match="a dict is no environment of drake_quad.gym"):
        save_policy({}, [], tmp_path)
