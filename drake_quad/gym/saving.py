"""Saving of a trained policy as a controller file for scenarios."""

import re
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ruamel.yaml import YAML

from drake_quad.control.policy.network import Activation, Dense, Network, evaluate_network
from drake_quad.errors import InputError
from drake_quad.files import output_folder
from drake_quad.framework.symbols import Matrix
from drake_quad.gym.env import QuadrotorEnv
from drake_quad.gym.vector_env import QuadrotorVectorEnv
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.models import NAME, Scenario

# Name of the activation in the file of a policy, for each PyTorch module.
_ACTIVATIONS: dict[str, Activation] = {
    "Tanh": "tanh",
    "ReLU": "relu",
    "Sigmoid": "sigmoid",
    "ELU": "elu",
    "SiLU": "silu",
    "LeakyReLU": "leaky_relu",
    "GELU": "gelu",
}
# Attribute of a PyTorch module that contains the parameter of its activation.
_PARAMETER_ATTRIBUTES = {"ELU": "alpha", "LeakyReLU": "negative_slope"}
# PyTorch modules that are the identity for a one-dimensional observation, except during training.
_IDENTITY_MODULES = ("Flatten", "Identity", "Dropout")


class Layer(NamedTuple):
    """Dense layer of a network.

    Attributes:
        weights: (outputs, inputs) weights.
        biases: (outputs,) biases.
        activation: name of the activation, as in `control.policy` of the scenario language.
        alpha: parameter of the activation; None for the default value, or if the activation has no parameter.
    """

    weights: np.ndarray
    biases: np.ndarray
    activation: Activation = "identity"
    alpha: float | None = None


def save_policy(
    env: QuadrotorVectorEnv | QuadrotorEnv,
    layers: Sequence[Layer],
    path: Path | str,
    *,
    offset: np.ndarray | None = None,
    scale: np.ndarray | None = None,
    limit: float | None = None,
) -> Path:
    """Write a network as a controller file, which `load_scenario(..., layers=[path])` combines with a scenario.

    The first layer receives the input x = clip((o - offset) * scale, -limit, limit), where o is the observation.

    Args:
        env: environment in which the network was trained. It defines the observations and actions.
        layers: layers of the network, starting at the observation.
        path: path of the .yaml file, whose name becomes the name of the controller. The arrays of the network are
            written to an .npz file in the same folder.
        offset: (components,) offsets; zero if not given.
        scale: (components,) factors; one if not given.
        limit: largest absolute value of x; unlimited if not given.

    Returns:
        The path.

    Raises:
        InputError: if the files cannot be written, or the network does not match the observations and actions of the
            environment. If the network does not match, existing files are not changed.
    """
    arrays_given = {"offset": offset, "scale": scale, "limit": limit}
    arrays: dict[str, Any] = {name: np.asarray(each) for name, each in arrays_given.items() if each is not None}
    for k, layer in enumerate(layers):
        weights, biases, activation, alpha = Layer(*layer)
        arrays |= {f"weights_{k}": weights, f"biases_{k}": biases, f"activation_{k}": np.array(activation)}
        arrays |= {} if alpha is None else {f"alpha_{k}": np.array(alpha)}

    scenario = scenario_of_env(env)
    fields = scenario.control.model_dump(mode="json", exclude={"policy"})
    target = Path(path)
    if target.suffix != ".yaml" or not re.match(NAME, target.stem):
        raise InputError(f"a policy must be written to a .yaml file with a name of letters and digits, not to {target}")
    output_folder(target.parent)
    try:
        return _write_checked(arrays, fields, scenario, target)
    except OSError as error:
        raise InputError(
            f"the policy cannot be written to {target}: {(error.strerror or str(error)).lower()}"
        ) from None


def _write_checked(arrays: dict[str, Any], fields: dict[str, Any], scenario: Scenario, target: Path) -> Path:
    """Write a policy to a temporary folder, check that it can be loaded, and move it to its path."""
    with tempfile.TemporaryDirectory(dir=target.parent) as temporary:
        controller, task = Path(temporary) / target.name, Path(temporary) / "task.yml"
        network = controller.with_suffix(".npz")
        np.savez(network, **arrays)
        YAML().dump({target.stem: {"control": {**fields, "policy": network.name}}}, controller)
        save_scenario(scenario, task)
        try:
            load_scenario(task, layers=[controller])
        except InputError as error:
            reason = str(error).replace(temporary, str(target.parent))
            raise InputError(f"the network cannot be saved: {reason}") from None
        network.replace(target.with_suffix(".npz"))
        return controller.replace(target)


def torch_layers(modules: Iterable[Any]) -> list[Layer]:
    """Return the layers of a PyTorch network.

    Args:
        modules: sequence of modules, such as a `torch.nn.Sequential`. Each Linear may be followed by a Tanh, ReLU,
            Sigmoid, ELU, SiLU, LeakyReLU or GELU.

    Raises:
        InputError: if the network contains a module of another type.
    """
    layers: list[Layer] = []
    for module in modules:
        name = type(module).__name__
        if name == "Linear":
            weights = module.weight.detach().cpu().numpy()
            biases = np.zeros(len(weights)) if module.bias is None else module.bias.detach().cpu().numpy()
            layers.append(Layer(weights, biases))
        elif name in _ACTIVATIONS and layers and layers[-1].activation == "identity":
            activation = _ACTIVATIONS[name]
            if name == "GELU" and getattr(module, "approximate", "none") == "tanh":
                activation = "gelu_tanh"
            alpha = float(getattr(module, _PARAMETER_ATTRIBUTES[name])) if name in _PARAMETER_ATTRIBUTES else None
            layers[-1] = layers[-1]._replace(activation=activation, alpha=alpha)
        elif name not in _IDENTITY_MODULES:
            raise InputError(
                f"a {name} module is not supported here; use Linear modules, each followed by at most one"
                f" {' or '.join(_ACTIVATIONS)}"
            )
    if not layers:
        raise InputError("the policy has no layers")
    return layers


def evaluate_layers(
    layers: Sequence[Layer],
    observations: np.ndarray,
    *,
    offset: np.ndarray | None = None,
    scale: np.ndarray | None = None,
    limit: float | None = None,
) -> np.ndarray:
    """Return the actions of a network, saturated at ±1.

    Args:
        layers: layers of the network; see `save_policy`.
        observations: (k, components) observations.
        offset: see `save_policy`.
        scale: see `save_policy`.
        limit: see `save_policy`.

    Returns:
        (k, components) actions.
    """
    first, factor = (None if each is None else tuple(np.ravel(each).tolist()) for each in (offset, scale))
    specified = [Layer(*each) for each in layers]
    neurons = tuple([Dense(Matrix(each.weights, each.biases), each.activation, each.alpha) for each in specified])
    network = Network(neurons, observations.shape[1], first, factor, limit)
    return np.clip(np.transpose(evaluate_network(network, [*observations.T], ()).output), -1.0, 1.0)


def scenario_of_env(env: Any) -> Scenario:
    """Return the scenario of an environment of this package. Gymnasium's wrappers may wrap the environment.

    Raises:
        InputError: if the environment is not an environment of this package.
    """
    unwrapped = getattr(env, "unwrapped", env)
    if not isinstance(unwrapped, QuadrotorEnv | QuadrotorVectorEnv):
        raise InputError(f"env is a {type(unwrapped).__name__}, but must be an environment of drake_quad.gym")
    return unwrapped.scenario
