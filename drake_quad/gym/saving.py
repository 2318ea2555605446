"""A policy that was trained in an environment, as a controller for scenarios."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ruamel.yaml import YAML

from drake_quad.errors import InputError
from drake_quad.files import output_folder
from drake_quad.gym.env import QuadrotorEnv
from drake_quad.gym.vector_env import QuadrotorVectorEnv
from drake_quad.scenario import Scenario, load_scenario, save_scenario


class Neurons(NamedTuple):
    """A layer of a network.

    Attributes:
        weights: (outputs, inputs).
        biases: (outputs,).
        activation: as in `control.policy` of the scenario language.
    """

    weights: np.ndarray
    biases: np.ndarray
    activation: str = "identity"


def save_policy(
    env: QuadrotorVectorEnv | QuadrotorEnv,
    layers: Sequence[Neurons],
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
    for k, (weights, biases, activation) in enumerate(layers):
        arrays |= {f"weights_{k}": weights, f"biases_{k}": biases, f"activation_{k}": np.array(activation)}

    scenario = task_in(env)
    fields = scenario.control.model_dump(mode="json", exclude={"policy"}, exclude_none=True)
    target = output_folder(Path(folder))
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


def task_in(env: Any) -> Scenario:
    """The scenario of an environment of ours, perhaps within wrappers of Gymnasium.

    Raises:
        InputError: it is none of ours.
    """
    own = getattr(env, "unwrapped", env)
    if not isinstance(own, QuadrotorEnv | QuadrotorVectorEnv):
        raise InputError(f"a {type(own).__name__} is no environment of drake_quad.gym")
    return own.scenario
