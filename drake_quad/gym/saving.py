"""A policy that was trained in an environment, as a controller for scenarios."""

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ruamel.yaml import YAML

from drake_quad.control.policy.network import Activation, Dense, Network, passed
from drake_quad.errors import InputError
from drake_quad.files import output_folder
from drake_quad.framework.symbols import Matrix
from drake_quad.gym.env import QuadrotorEnv
from drake_quad.gym.vector_env import QuadrotorVectorEnv
from drake_quad.scenario import Scenario, load_scenario, save_scenario

# Modules of PyTorch by the names that they have in a policy's file.
_ACTIVATIONS: dict[str, Activation] = {
    "Tanh": "tanh",
    "ReLU": "relu",
    "Sigmoid": "sigmoid",
    "ELU": "elu",
    "SiLU": "silu",
}
# Those that do nothing to an observation, or nothing when no one learns.
_SILENT = ("Flatten", "Identity", "Dropout")


class Layer(NamedTuple):
    """A layer of neurons.

    Attributes:
        weights: (outputs, inputs).
        biases: (outputs,).
        activation: as in `control.policy` of the scenario language.
    """

    weights: np.ndarray
    biases: np.ndarray
    activation: Activation = "identity"


def save_policy(
    env: QuadrotorVectorEnv | QuadrotorEnv,
    layers: Sequence[Layer],
    folder: Path | str,
    *,
    offset: np.ndarray | None = None,
    scale: np.ndarray | None = None,
    limit: float | None = None,
) -> Path:
    """Writes a network as a controller, which is laid over scenarios: `load_scenario(..., layers=[path])`.

    Args:
        env: in which it was trained, and which says what it sees and does.
        layers: of the network, from the observation on.
        folder: to write policy.npz and policy.yaml to.
        offset: (rows,) that is taken from the observation, if any.
        scale: (rows,) by which it is multiplied then, if any.
        limit: to which it is held then, on both sides of zero, if any.

    Returns:
        The path of policy.yaml.

    Raises:
        InputError: the folder cannot be written to, or the network is not one of this environment; what was in the
            folder is there still.
    """
    given = {"offset": offset, "scale": scale, "limit": limit}
    arrays: dict[str, Any] = {name: np.asarray(each) for name, each in given.items() if each is not None}
    for k, layer in enumerate(layers):
        weights, biases, activation = Layer(*layer)
        arrays |= {f"weights_{k}": weights, f"biases_{k}": biases, f"activation_{k}": np.array(activation)}

    scenario = task_in(env)
    fields = scenario.control.model_dump(mode="json", exclude={"policy"})
    target = output_folder(Path(folder))
    try:
        return _written(arrays, fields, scenario, target)
    except OSError as error:
        raise InputError(
            f"the policy cannot be written to {target}: {(error.strerror or str(error)).lower()}"
        ) from None


def _written(arrays: dict[str, Any], fields: dict[str, Any], scenario: Scenario, target: Path) -> Path:
    """Writes a policy where it is tried first, and then to its folder."""
    with tempfile.TemporaryDirectory(dir=target) as temporary:
        network, controller, task = (Path(temporary) / name for name in ("policy.npz", "policy.yaml", "task.yaml"))
        np.savez(network, **arrays)
        YAML().dump({"policy": {"control": {**fields, "policy": network.name}}}, controller)
        save_scenario(scenario, task)
        try:
            load_scenario(task, layers=[controller])
        except InputError as error:
            raise InputError(f"the network cannot be flown: {str(error).replace(temporary, str(target))}") from None
        network.replace(target / network.name)
        return controller.replace(target / controller.name)


def torch_layers(modules: Iterable[Any]) -> list[Layer]:
    """The layers of a network of PyTorch.

    Args:
        modules: one after another, as a `torch.nn.Sequential` has them: Linear, and Tanh, ReLU, Sigmoid, ELU or SiLU
            behind it.

    Raises:
        InputError: there is another module, or an ELU with an alpha other than 1.
    """
    layers: list[Layer] = []
    for module in modules:
        name = type(module).__name__
        if name == "Linear":
            weights = module.weight.detach().cpu().numpy()
            biases = np.zeros(len(weights)) if module.bias is None else module.bias.detach().cpu().numpy()
            layers.append(Layer(weights, biases))
        elif name in _ACTIVATIONS and layers and layers[-1].activation == "identity":
            if getattr(module, "alpha", 1.0) != 1.0:
                raise InputError(f"the policy has an {name} with an alpha of {module.alpha:g}, but can have 1")
            layers[-1] = layers[-1]._replace(activation=_ACTIVATIONS[name])
        elif name not in _SILENT:
            raise InputError(f"the policy has a {name}, but can have Linear, and {', '.join(_ACTIVATIONS)} behind it")
    if not layers:
        raise InputError("the policy has no layers")
    return layers


def acted(
    layers: Sequence[Layer],
    observations: np.ndarray,
    *,
    offset: np.ndarray | None = None,
    scale: np.ndarray | None = None,
    limit: float | None = None,
) -> np.ndarray:
    """The (k, rows) actions, from -1 to 1, of a network for (k, rows) observations; arguments as for `save_policy`."""
    first, factor = (None if each is None else tuple(np.ravel(each).tolist()) for each in (offset, scale))
    neurons = tuple([Dense(Matrix(weights, biases), activation) for weights, biases, activation in layers])
    network = Network(neurons, observations.shape[1], first, factor, limit)
    return np.clip(np.transpose(passed(network, [*observations.T], ()).output), -1.0, 1.0)


def task_in(env: Any) -> Scenario:
    """The scenario of an environment of ours, perhaps within wrappers of Gymnasium.

    Raises:
        InputError: it is none of ours.
    """
    own = getattr(env, "unwrapped", env)
    if not isinstance(own, QuadrotorEnv | QuadrotorVectorEnv):
        raise InputError(f"a {type(own).__name__} is no environment of drake_quad.gym")
    return own.scenario
