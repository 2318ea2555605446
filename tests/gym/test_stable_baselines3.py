"""Tests of training with Stable-Baselines3, if it is installed: pip install 'drake_quad[learn]'."""

import re
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from drake_quad import InputError, load_scenario, simulate
from drake_quad.gym import QuadrotorEnv, QuadrotorVectorEnv

stable_baselines3 = pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed")
wrappers = pytest.importorskip("stable_baselines3.common.vec_env")
StableVectorEnv, save_trained = (
    getattr(pytest.importorskip("drake_quad.gym.stable_baselines3"), name)
    for name in ("StableVectorEnv", "save_trained")
)

# PyTorch emits warnings about its own code.
pytestmark = pytest.mark.filterwarnings("ignore")


def envs_of(n=6, **options):
    options = {"autoreset_mode": AutoresetMode.SAME_STEP, **options}
    return QuadrotorVectorEnv("laboratory:low_wind", {"duration": 1.0}, num_envs=n, action="rates", **options)


def test_the_adapter_gives_the_same_flights_as_the_environment():
    adapter_envs, vector_envs = envs_of(), StableVectorEnv(envs_of())
    vector_envs.seed(4)
    observed, _ = adapter_envs.reset(seed=4)
    np.testing.assert_array_equal(vector_envs.reset(), observed)
    ended = 0
    for k in range(80):
        actions = np.random.default_rng(k).uniform(-0.5, 0.5, (6, 4)).astype(np.float32)
        observed, rewards, terminations, truncations, infos = adapter_envs.step(actions)
        actual = vector_envs.step(actions)
        np.testing.assert_array_equal(actual[0], observed)
        np.testing.assert_array_equal(actual[1], rewards.astype(np.float32))
        np.testing.assert_array_equal(actual[2], terminations | truncations)
        for i in np.flatnonzero(actual[2]):
            np.testing.assert_array_equal(actual[3][i]["terminal_observation"], infos["final_obs"][i])
            assert actual[3][i]["TimeLimit.truncated"] == truncations[i]
            assert actual[3][i]["flight"]["rmse"] == infos["flight"]["rmse"][i]
            ended += 1
    assert ended >= 6
    with pytest.raises(InputError, match="autoreset_mode must be AutoresetMode.SAME_STEP"):
        StableVectorEnv(envs_of(autoreset_mode=AutoresetMode.NEXT_STEP))


@pytest.mark.parametrize("activation", ["Tanh", "ReLU"])
def test_a_saved_policy_gives_the_actions_of_its_model(activation, tmp_path):
    torch = pytest.importorskip("torch")
    envs = (
        wrappers.VecNormalize(wrappers.VecMonitor(StableVectorEnv(envs_of(8))))
        if activation == "Tanh"
        else StableVectorEnv(envs_of(8))
    )
    kwargs = {"net_arch": [16, 8], "activation_fn": getattr(torch.nn, activation)}
    model = stable_baselines3.PPO(
        "MlpPolicy", envs, n_steps=32, batch_size=64, policy_kwargs=kwargs, seed=0, device="cpu"
    )
    model.learn(600)
    flight = simulate(
        load_scenario("laboratory:low_wind", {"duration": 1.0}, layers=[save_trained(model, tmp_path / "mine.yaml")])
    )
    if activation == "Tanh":
        envs.training = False
        normal = envs.normalize_obs(flight["observation"].astype(np.float32))
    else:
        normal = flight["observation"].astype(np.float32)
    expected, _ = model.predict(normal, deterministic=True)
    np.testing.assert_allclose(flight["action"].clip(-1.0, 1.0), expected, atol=1e-4)


def flown_with(policy):
    return simulate(load_scenario("laboratory:low_wind", {"duration": 1.0}, layers=[policy]))


def agrees(model, flight):
    """Return whether the actions in a flight are those that a model predicts for the observations in this flight."""
    observed, normal = flight["observation"].astype(np.float32), model.get_vec_normalize_env()
    expected, _ = model.predict(observed if normal is None else normal.normalize_obs(observed), deterministic=True)
    return np.allclose(flight["action"].clip(-1.0, 1.0), expected, atol=1e-4)


def briefly_trained(envs, **options):
    kwargs = {"net_arch": [12], **options.pop("policy_kwargs", {})}
    model = stable_baselines3.PPO("MlpPolicy", envs, n_steps=16, policy_kwargs=kwargs, device="cpu", seed=1, **options)
    return model.learn(2 * 16 * envs.num_envs)


def test_supported_wrappers_of_environments_are_accepted(tmp_path):
    monitored = wrappers.VecMonitor(wrappers.VecNormalize(StableVectorEnv(envs_of(8))))
    unnormalised = wrappers.VecNormalize(StableVectorEnv(envs_of(8)), norm_obs=False)
    single_env = wrappers.DummyVecEnv([lambda: gymnasium.make("drake_quad/Track-v0", scenario="laboratory:low_wind")])
    for envs in (monitored, unnormalised, single_env):
        model = briefly_trained(envs)
        assert agrees(model, flown_with(save_trained(model, tmp_path / "mine.yaml")))
    assert np.load(tmp_path / "mine.npz").files == ["weights_0", "biases_0", "activation_0"] + [
        f"{name}_1" for name in ("weights", "biases", "activation")
    ]


@pytest.mark.parametrize("name", ["SAC", "TD3", "DDPG"])
def test_policies_of_algorithms_other_than_ppo_are_saved(name, tmp_path):
    kwargs = {"net_arch": [12], "activation_fn": pytest.importorskip("torch").nn.SiLU}
    envs = StableVectorEnv(envs_of(2))
    make = getattr(stable_baselines3, name)
    model = make("MlpPolicy", envs, learning_starts=20, policy_kwargs=kwargs, device="cpu", seed=1).learn(60)
    assert agrees(model, flown_with(save_trained(model, tmp_path / "mine.yaml")))


def test_a_squashed_policy_is_saved_with_its_tanh(tmp_path):
    kwargs = {"squash_output": True, "log_std_init": -1.0}
    model = briefly_trained(StableVectorEnv(envs_of(8)), use_sde=True, policy_kwargs=kwargs)
    assert agrees(model, flown_with(save_trained(model, tmp_path / "mine.yaml")))


def test_policies_that_a_saved_controller_cannot_reproduce_are_refused(tmp_path):
    torch = pytest.importorskip("torch")
    extractors = pytest.importorskip("stable_baselines3.common.torch_layers")

    class Halved(extractors.FlattenExtractor):
        def forward(self, observations):
            return 0.5 * super().forward(observations)

    class Longer(torch.nn.ELU):
        pass

    adapter_envs = StableVectorEnv(envs_of(4))
    closed = briefly_trained(adapter_envs)
    closed.env = None
    rescaled = gymnasium.wrappers.RescaleAction(QuadrotorEnv("hover"), np.float32(-2.0), np.float32(2.0))
    for make, words in [
        (
            lambda: briefly_trained(adapter_envs, policy_kwargs={"features_extractor_class": Halved}),
            "its dense layers do not reproduce its actions",
        ),
        (
            lambda: briefly_trained(adapter_envs, policy_kwargs={"activation_fn": Longer}),
            "a Longer module is not supported here",
        ),
        (
            lambda: briefly_trained(wrappers.VecFrameStack(adapter_envs, 2)),
            "wrapped in a VecFrameStack, which is not supported",
        ),
        (
            lambda: briefly_trained(wrappers.VecNormalize(wrappers.VecNormalize(adapter_envs))),
            "two VecNormalize wrappers normalise the observations",
        ),
        (
            lambda: briefly_trained(wrappers.DummyVecEnv([lambda: rescaled])),
            "wrapped in a RescaleAction, which is not supported",
        ),
        (lambda: closed, "the model has no environment"),
        (
            lambda: stable_baselines3.PPO("MlpPolicy", "Pendulum-v1", device="cpu"),
            "must be an environment of drake_quad",
        ),
    ]:
        with pytest.raises(InputError, match=words):
            save_trained(make(), tmp_path / "mine.yaml")
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
def test_the_example_trains_a_policy_that_hovers_and_tracks(root, tmp_path):
    command = [sys.executable, str(root / "scripts" / "train_policy.py"), "400000"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, timeout=600, cwd=tmp_path).stdout
    for name in ("figure_eight", "hover"):
        assert float(re.search(rf"RMSE, {name}: ([\d.]+) cm", printed)[1]) < 15.0
