"""A vector environment as Stable-Baselines3 wants one."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from drake_quad.errors import InputError
from drake_quad.gym.real_numbers import single_precision
from drake_quad.gym.vector_env import QuadrotorVectorEnv


class StableVectorEnv(VecEnv):
    """A `QuadrotorVectorEnv` as a `VecEnv` of Stable-Baselines3.

    Args:
        envs: the environment, whose vehicles begin anew in the last step of an episode (`AutoresetMode.SAME_STEP`).

    Raises:
        InputError: they begin anew otherwise, or it is no `QuadrotorVectorEnv`.
    """

    def __init__(self, envs: QuadrotorVectorEnv) -> None:
        if not isinstance(envs, QuadrotorVectorEnv):
            raise InputError(f"a {type(envs).__name__} is no QuadrotorVectorEnv")
        if envs.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise InputError("autoreset_mode must be AutoresetMode.SAME_STEP: Stable-Baselines3 knows no other")
        self.envs = envs
        self.render_mode = envs.render_mode
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._actions: np.ndarray | None = None

    def reset(self) -> np.ndarray:
        """Lets all vehicles begin anew, and returns the (N, rows) observation."""
        seeds = [seed for seed in self._seeds if seed is not None]
        observation, _ = self.envs.reset(seed=seeds[0] if seeds else None)
        self._reset_seeds()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the (N, rows) actions of a step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Flies the step.

        Returns:
            The (N, rows) observation, (N,) rewards, (N,) whether episodes are over, and for each vehicle a mapping with
            what Stable-Baselines3 asks for, and the `flight` of Gymnasium's infos.
        """
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
        return seen, single_precision(rewards), over, infos

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
