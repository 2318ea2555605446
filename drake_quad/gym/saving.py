"""A policy that was trained in an environment, as a controller for scenarios."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ruamel.yaml import YAML

from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_whole
from drake_quad.gym.vector_env import QuadrotorVectorEnv
from drake_quad.scenario import load_scenario


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
    env: QuadrotorVectorEnv,
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
        InputError: the folder cannot be written to, or the network is not one of this environment.
    """
    target = output_folder(Path(folder))
    given = {"offset": offset, "scale": scale, "limit": limit}
    arrays: dict[str, Any] = {name: np.asarray(each) for name, each in given.items() if each is not None}
    for k, (weights, biases, activation) in enumerate(layers):
        arrays |= {f"weights_{k}": weights, f"biases_{k}": biases, f"activation_{k}": np.array(activation)}

    def write_arrays(path: Path) -> None:
        with path.open("wb") as file:
            np.savez(file, **arrays)

    def write_scenario(path: Path) -> None:
        control: Any = env.scenario.control
        fields = control.model_dump(mode="json", exclude={"policy"}, exclude_none=True)
        YAML().dump({"policy": {"control": {**fields, "policy": "policy.npz"}}}, path)

    write_whole(target / "policy.npz", write_arrays)
    path = write_whole(target / "policy.yaml", write_scenario)
    try:
        load_scenario("figure_eight", layers=[path])
    except InputError as error:
        raise InputError(f"the network cannot be flown: {error}") from None
    return path
