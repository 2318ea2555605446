"""Vector environment for Stable-Baselines3, and a function that saves trained policies as controllers."""

from drake_quad.extras import import_extra

import_extra("stable_baselines3", "learn")

from drake_quad.gym.stable_baselines3.saving import save_trained  # noqa: E402 - import_extra explains a missing library first
from drake_quad.gym.stable_baselines3.vector_env import StableVectorEnv  # noqa: E402

__all__ = ["StableVectorEnv", "save_trained"]
