"""Vector environment with the interface of Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from drake_quad.errors import InputError
from drake_quad.gym.real_numbers import single_precision
from drake_quad.gym.vector_env import QuadrotorVectorEnv


class StableVectorEnv(VecEnv):
    """Adapter from a `QuadrotorVectorEnv` to the interface `VecEnv` of Stable-Baselines3.

    Args:
        envs: environment that resets vehicles in the last step of an episode (`AutoresetMode.SAME_STEP`).

    Raises:
        InputError: if `envs` is not a `QuadrotorVectorEnv`, or uses another mode of resets.
    """

    def __init__(self, envs: QuadrotorVectorEnv) -> None:
        if not isinstance(envs, QuadrotorVectorEnv):
            raise InputError(f"envs is a {type(envs).__name__}, but must be a QuadrotorVectorEnv")
        if envs.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise InputError(
                "autoreset_mode must be AutoresetMode.SAME_STEP, the only mode that Stable-Baselines3 supports"
            )
        self.envs = envs
        self.render_mode = envs.render_mode
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._actions: np.ndarray | None = None

    def reset(self) -> np.ndarray:
        """Start new episodes of all vehicles, and return the observations (N, components)."""
        seeds = [seed for seed in self._seeds if seed is not None]
        observation, _ = self.envs.reset(seed=seeds[0] if seeds else None)
        self._reset_seeds()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Set the actions (N, components) of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Simulate the step with the actions of `step_async`.

        Returns:
            Observations (N, components), rewards (N,), Booleans (N,) that are True if an episode has ended, and a
            dictionary for each vehicle. The dictionary contains the infos that Stable-Baselines3 defines, and `flight`
            from Gymnasium's infos.
        """
        assert self._actions is not None
        observations, rewards, terminations, truncations, vector_infos = self.envs.step(self._actions)
        over = terminations | truncations
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(over).tolist():
            flight = {name: values[i] for name, values in vector_infos["flight"].items() if not name.startswith("_")}
            infos[i] = {
                "terminal_observation": vector_infos["final_obs"][i],
                "TimeLimit.truncated": bool(truncations[i]),
                "flight": flight,
            }
        return observations, single_precision(rewards), over, infos

    def close(self) -> None:
        """Close the environment."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return an image of each vehicle."""
        return self.envs.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the environment, repeated for each vehicle."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environment, which all vehicles share."""
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call a method of the environment once, and return the result repeated for each vehicle."""
        result = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each vehicle, since single vehicles cannot be wrapped."""
        return [False] * len(list(self._get_indices(indices)))
