"""Training by Stable-Baselines3: a vector environment as it wants one, and its policies as controllers."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from drake_quad.errors import InputError
from drake_quad.extras import needed
from drake_quad.gym.saving import Neurons, save_policy
from drake_quad.gym.vector_env import QuadrotorVectorEnv

needed("stable_baselines3", "learn")
from stable_baselines3.common.vec_env import VecEnv, VecNormalize  # noqa: E402 - a sentence first if it is missing

# Modules of PyTorch by the names that they have in a policy's file.
_ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu", "Sigmoid": "sigmoid", "ELU": "elu", "SiLU": "silu"}


class StableVectorEnv(VecEnv):
    """A `QuadrotorVectorEnv` as a `VecEnv` of Stable-Baselines3.

    Args:
        envs: the environment, whose vehicles begin anew in the last step of an episode (`AutoresetMode.SAME_STEP`).

    Raises:
        InputError: they begin anew otherwise.
    """

    def __init__(self, envs: QuadrotorVectorEnv) -> None:
        if envs.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise InputError("autoreset_mode must be AutoresetMode.SAME_STEP: Stable-Baselines3 knows no other")
        self.envs = envs
        self.render_mode = envs.render_mode
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._actions: np.ndarray | None = None

    def reset(self) -> np.ndarray:
        """Lets all vehicles begin anew."""
        seeds = [seed for seed in self._seeds if seed is not None]
        observation, _ = self.envs.reset(seed=seeds[0] if seeds else None)
        self._reset_seeds()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions of a step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Flies the step; infos have what Stable-Baselines3 asks for, and the `flight` of Gymnasium's."""
        assert self._actions is not None
        seen, rewards, terminations, truncations, found = self.envs.step(self._actions)
        over = terminations | truncations
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(over).tolist():
            flight = {name: values[i] for name, values in found["flight"].items() if not name.startswith("_")}
            infos[i] = {
                "terminal_observation": found["final_obs"][i],
                "TimeLimit.truncated": bool(truncations[i]),
                "flight": flight,
            }
        return seen, rewards.astype(np.float32), over, infos

    def close(self) -> None:
        """Closes the environment."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """A frame for each vehicle."""
        return self.envs.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the environment, once for each vehicle."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute of the environment, which all vehicles have in common."""
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Calls a method of the environment, once."""
        result = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """None is."""
        return [False] * len(list(self._get_indices(indices)))

    def _get_indices(self, indices: Any) -> Iterable[int]:
        return range(self.num_envs) if indices is None else [indices] if isinstance(indices, int) else indices


def save_trained(model: Any, folder: Path | str) -> Path:
    """Writes the mean of a model's policy as a controller, see `save_policy`.

    Args:
        model: with an `MlpPolicy`, such as a PPO, whose environment is a `StableVectorEnv`, perhaps within a
            `VecNormalize`.
        folder: to write to.

    Raises:
        InputError: the policy has layers that are not known here, or as `save_policy`.
    """
    modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    layers: list[Neurons] = []
    for module in modules:
        name = type(module).__name__
        if name == "Linear":
            layers.append(Neurons(*(each.detach().cpu().numpy() for each in (module.weight, module.bias))))
        elif name in _ACTIVATIONS and layers:
            layers[-1] = layers[-1]._replace(activation=_ACTIVATIONS[name])
        else:
            raise InputError(f"the policy has a {name}, but can have layers Linear and {', '.join(_ACTIVATIONS)}")
    envs, seen = model.get_env(), {}
    if isinstance(envs, VecNormalize):
        known = envs.obs_rms
        seen = {"offset": known.mean, "scale": 1.0 / np.sqrt(known.var + envs.epsilon), "limit": envs.clip_obs}
        envs = envs.venv
    return save_policy(envs.envs, layers, folder, **seen)
