"""Gymnasium environments for training policies on fleets that are simulated in machine code.

This example creates 64 environments:

    import gymnasium
    import drake_quad.gym

    envs = gymnasium.make_vec("drake_quad/Track-v0", num_envs=64, scenario="laboratory:low_wind", action="rates")
"""

from drake_quad.extras import import_extra

gymnasium = import_extra("gymnasium", "gym")

from drake_quad.gym.env import QuadrotorEnv  # noqa: E402 - import_extra explains a missing Gymnasium first
from drake_quad.gym.function_policy import FunctionPolicy  # noqa: E402
from drake_quad.gym.rewards import TrackingReward, Transition, has_crashed  # noqa: E402
from drake_quad.gym.saving import Layer, save_policy, torch_layers  # noqa: E402
from drake_quad.gym.vector_env import QuadrotorVectorEnv  # noqa: E402

__all__ = [
    "FunctionPolicy",
    "Layer",
    "QuadrotorEnv",
    "QuadrotorVectorEnv",
    "TrackingReward",
    "Transition",
    "has_crashed",
    "save_policy",
    "torch_layers",
]

gymnasium.register(
    id="drake_quad/Track-v0",
    entry_point="drake_quad.gym:QuadrotorEnv",
    vector_entry_point="drake_quad.gym:QuadrotorVectorEnv",
)
