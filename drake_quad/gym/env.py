"""Gymnasium environment with one vehicle."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from drake_quad.flight.flight import Flight
from drake_quad.gym.episodes import Episode
from drake_quad.gym.vector_env import QuadrotorVectorEnv
from drake_quad.reference.plan import Plan
from drake_quad.scenario.files.loading import Overrides
from drake_quad.scenario.models import Scenario


class QuadrotorEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Gymnasium environment with one vehicle, simulated in machine code; see also `QuadrotorVectorEnv`.

    Args:
        scenario: scenario, or the file or name of one; see `QuadrotorVectorEnv`.
        overrides: overrides for `load_scenario`.
        record: True to record actions, so that `flight` can return an episode.
        options: further arguments of `QuadrotorVectorEnv`, except `num_envs` and `autoreset_mode`.

    Raises:
        InputError: if an argument is invalid, or the scenario cannot be compiled.
    """

    metadata: dict[str, Any] = {"render_modes": QuadrotorVectorEnv.metadata["render_modes"]}  # noqa: RUF012

    def __init__(
        self,
        scenario: Scenario | str | Path = "figure_eight",
        overrides: Overrides = (),
        *,
        record: bool = True,
        **options: Any,
    ) -> None:
        self._vector = QuadrotorVectorEnv(
            scenario, overrides, num_envs=1, record=record, autoreset_mode=AutoresetMode.DISABLED, **options
        )
        self.metadata = {**self.metadata, "render_fps": self._vector.metadata["render_fps"]}
        self.render_mode = self._vector.render_mode
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    @property
    def scenario(self) -> Scenario:
        """Scenario that defines the task."""
        return self._vector.scenario

    @property
    def plan(self) -> Plan:
        """Plan from which the reference of all flights is computed."""
        return self._vector.plan

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start the next episode, or the first episode for a given seed.

        Args:
            seed: seed of this episode and of the following ones; the current seed if not given.
            options: ignored.

        Returns:
            The observation (components,) and an empty dictionary.

        Raises:
            InputError: if the seed is negative, too large, or not a whole number.
        """
        observation, infos = self._vector.reset(seed=None if seed is None else [seed])
        super().reset(seed=None if seed is None else int(seed))
        return observation[0], infos

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Simulate one tick for an action (components,), and return the results that Gymnasium defines.

        Raises:
            InputError: if `QuadrotorVectorEnv.step` raises it.
        """
        observation, rewards, terminations, truncations, infos = self._vector.step([action])
        info = {}
        if infos:
            flight = infos["flight"]
            info["flight"] = {name: flight[name][0].item() for name in flight if not name.startswith("_")}
        return observation[0], float(rewards[0]), bool(terminations[0]), bool(truncations[0]), info

    def render(self) -> Any:
        """Return an image of the vehicle, (height, width, 3) uint8; None without a render mode."""
        frames = self._vector.render()
        return None if frames is None else frames[0]

    def episode(self) -> Episode:
        """Return the seed and sample of the current episode."""
        return self._vector.episode()

    def flight(self) -> Flight:
        """Return the current episode, or the previous one directly after a reset; see `QuadrotorVectorEnv.flight`."""
        return self._vector.flight()
