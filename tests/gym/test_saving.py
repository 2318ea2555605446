"""Tests of policies that are saved as controllers."""

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.gym import Layer, QuadrotorVectorEnv, save_policy, torch_layers
from drake_quad.gym.saving import evaluate_layers


@pytest.mark.slow
def test_a_saved_network_gives_the_same_flight_as_a_controller(tmp_path):
    """A linear policy flies in the environment and as the controller of a scenario."""
    envs = QuadrotorVectorEnv("figure_eight", {"duration": 3.0}, num_envs=1)
    rng = np.random.default_rng(0)
    size = envs.single_observation_space.shape[0]
    gains = np.zeros((3, size))
    gains[:, :3], gains[:, 3:6], gains[:, 18:21] = 0.3 * np.eye(3), 0.4 * np.eye(3), 0.2 * np.eye(3)
    offset, scale = rng.normal(size=size), rng.uniform(0.5, 2.0, size)
    path = save_policy(
        envs, [Layer(gains / scale, gains @ offset)], tmp_path / "mine" / "linear.yaml", offset=offset, scale=scale
    )
    observations, _ = envs.reset(seed=0)
    for _ in range(150):
        observations, *_, infos = envs.step(np.clip(observations.astype(float) @ gains.T, -1.0, 1.0))
    flight = simulate(load_scenario("figure_eight", {"duration": 3.0}, layers=[path]), compiled=True)
    np.testing.assert_allclose(flight.metrics.rmse, infos["flight"]["rmse"][0], rtol=1e-4)
    assert flight.metrics.rmse < 0.3
    before = path.with_suffix(".npz").read_bytes()
    with pytest.raises(InputError, match="cannot be saved: .*layers.0.inputs is 23, but must be 24") as wrong:
        save_policy(envs, [Layer(gains[:, 1:], np.zeros(3))], tmp_path / "mine" / "linear.yaml")
    assert str(path.parent) in str(wrong.value)
    assert path.with_suffix(".npz").read_bytes() == before
    assert sorted(each.name for each in path.parent.iterdir()) == ["linear.npz", "linear.yaml"]


@pytest.mark.long
@pytest.mark.parametrize("action", ["acceleration", "attitude", "rates"])
def test_a_policy_for_an_autopilot_is_saved(action, tmp_path):
    env = gymnasium.make("drake_quad/Track-v0", scenario="onboard", action=action)
    rows, size = env.action_space.shape[0], env.observation_space.shape[0]
    path = save_policy(env, [Layer(np.zeros((rows, size)), np.zeros(rows))], tmp_path / "mine.yaml")
    assert load_scenario("onboard", layers=[path]).control.action.kind == action
    with pytest.raises(InputError, match="env is a dict, but must be an environment of drake_quad.gym"):
        save_policy({}, [], tmp_path / "mine.yaml")


def test_missing_fields_of_a_policy_are_not_taken_from_the_scenario(tmp_path):
    """The controller raptor_plus can stop rotors. A policy that was trained with idling rotors cannot."""
    env = QuadrotorVectorEnv("figure_eight", action="rotor_speeds", observation={"signals": ["velocity"]})
    path = save_policy(env, [Layer(np.zeros((4, 3)), np.zeros(4))], tmp_path / "mine.yaml")
    over = load_scenario("figure_eight", layers=["controllers/raptor:raptor_plus", path])
    assert over.control == load_scenario("figure_eight", layers=[path]).control
    assert over.control.action.min_rotor_speed is None


@pytest.mark.slow
def test_the_parameter_of_an_activation_is_saved(tmp_path):
    env = QuadrotorVectorEnv("figure_eight", observation={"signals": ["velocity"]})
    layers = [Layer(np.ones((3, 3)), np.zeros(3), "leaky_relu", 0.3), Layer(np.eye(3), np.zeros(3), "tanh")]
    path = save_policy(env, layers, tmp_path / "mine.yaml")
    loaded = load_scenario("figure_eight", layers=[path]).control.policy
    assert [(layer.activation, layer.alpha) for layer in loaded.layers] == [("leaky_relu", 0.3), ("tanh", None)]


@pytest.mark.slow
def test_a_saved_controller_is_named_after_its_file(tmp_path):
    """`drake-quad compare` prints this name."""
    env = QuadrotorVectorEnv("figure_eight", observation={"signals": ["velocity"]})
    layer = Layer(np.zeros((3, 3)), np.zeros(3))
    for name in ("one", "task"):
        path = save_policy(env, [layer], tmp_path / f"{name}.yaml")
        assert load_scenario("figure_eight", layers=[f"{path}:{name}"]).control.kind == "policy"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["one.npz", "one.yaml", "task.npz", "task.yaml"]
    for wrong in (tmp_path / "mine", tmp_path / "my policy.yaml", tmp_path / ".yaml"):
        with pytest.raises(InputError, match="a policy must be written to a .yaml file with a name of letters"):
            save_policy(env, [layer], wrong)


def test_errors_while_writing_a_controller_are_reported(tmp_path, monkeypatch):
    env = QuadrotorVectorEnv("figure_eight", observation={"signals": ["velocity"]})

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(InputError, match="the policy cannot be written to .*: no space left on device"):
        save_policy(env, [Layer(np.zeros((3, 3)), np.zeros(3))], tmp_path / "mine.yaml")
    assert not [*tmp_path.iterdir()]


def module(name, **attributes):
    return type(name, (), attributes)()


def fake_tensor(array):
    """Return a stand-in for a tensor of PyTorch."""
    return SimpleNamespace(detach=lambda: SimpleNamespace(cpu=lambda: SimpleNamespace(numpy=lambda: np.array(array))))


@pytest.mark.parametrize(
    ("given", "activation", "alpha"),
    [
        (module("ELU", alpha=0.5), "elu", 0.5),
        (module("LeakyReLU", negative_slope=0.2), "leaky_relu", 0.2),
        (module("GELU", approximate="none"), "gelu", None),
        (module("GELU", approximate="tanh"), "gelu_tanh", None),
    ],
)
def test_parameters_of_activations_are_read_from_pytorch(given, activation, alpha):
    linear = module("Linear", weight=fake_tensor(np.eye(2)), bias=None)
    (layer,) = torch_layers([linear, given])
    assert (layer.activation, layer.alpha) == (activation, alpha)


def test_layers_of_pytorch_are_read_by_their_names():
    """The modules are stand-ins. The tests of Stable-Baselines3 use real modules, if it is installed."""
    rng = np.random.default_rng(1)
    w, b, v = rng.normal(size=(5, 4)), rng.normal(size=5), rng.normal(size=(2, 5))
    given = [
        module("Flatten"),
        module("Linear", weight=fake_tensor(w), bias=fake_tensor(b)),
        module("ELU", alpha=1.0),
        module("Linear", weight=fake_tensor(v), bias=None),
        module("Tanh"),
    ]
    layers = torch_layers(given)
    observations = rng.normal(size=(7, 4))
    offset, scale = rng.normal(size=4), rng.uniform(0.5, 2.0, 4)
    x = np.clip((observations - offset) * scale, -1.2, 1.2) @ w.T + b
    expected = np.tanh(np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))) @ v.T)
    np.testing.assert_allclose(
        evaluate_layers(layers, observations, offset=offset, scale=scale, limit=1.2), expected, rtol=1e-12
    )
    for wrong, words in [
        (
            [*given, module("Mish")],
            "a Mish module is not supported here; use Linear modules, each followed by at most one Tanh",
        ),
        ([*given, module("Tanh")], "a Tanh module is not supported here"),
        ([module("Tanh")], "a Tanh module is not supported here"),
        ([], "the policy has no layers"),
    ]:
        with pytest.raises(InputError, match=words):
            torch_layers(wrong)
