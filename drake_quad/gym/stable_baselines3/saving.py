"""Policies of Stable-Baselines3 as controllers."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecEnvWrapper, VecMonitor, VecNormalize
from stable_baselines3.sac.policies import SACPolicy
from stable_baselines3.td3.policies import TD3Policy

from drake_quad.errors import InputError
from drake_quad.gym.saving import Layer, acted, save_policy, torch_layers
from drake_quad.gym.stable_baselines3.vector_env import StableVectorEnv

# What stands around an environment and changes neither what is seen nor what is done.
_CHANGE_NOTHING = (VecMonitor, VecCheckNan)
_OF_GYMNASIUM = (Monitor.__name__, "TimeLimit", "OrderEnforcing", "PassiveEnvChecker")
# How many observations are tried, and how far actions of single precision may be from each other.
_TRIED, _ACCURACY = 64, 1e-3


def save_trained(model: Any, path: Path | str) -> Path:
    """Writes the mean of a model's policy as a controller, see `save_policy`.

    Args:
        model: with an `MlpPolicy`, of PPO, A2C, SAC, TD3 or DDPG, and its environment: a `StableVectorEnv`, or
            environments of ours in a `DummyVecEnv`, perhaps within a `VecNormalize`.
        path: as for `save_policy`.

    Raises:
        InputError: the environment is none of ours, something around it or in the policy is not known here, or as
            `save_policy`.
    """
    envs = model.get_env()
    if envs is None:
        raise InputError("the model has no environment, which says what its policy sees; load it with env=...")
    normalizer, env = _unwrapped(envs)
    layers, prepared = _layers_of(model.policy), _prepared(normalizer)
    size = layers[0].weights.shape[1]
    seen = np.random.default_rng(0).normal(size=(_TRIED, size))
    if normalizer is not None:
        seen = normalizer.obs_rms.mean + seen * np.sqrt(normalizer.obs_rms.var)
    shown = seen if normalizer is None else normalizer.normalize_obs(seen)
    expected, _ = model.predict(np.asarray(shown, dtype=np.float32), deterministic=True)
    if not np.allclose(acted(layers, seen, **prepared), expected, rtol=0.0, atol=_ACCURACY):
        raise InputError("the policy does more than its layers of neurons, so it cannot be saved")
    return save_policy(env, layers, path, **prepared)


def _unwrapped(envs: Any) -> tuple[Any, Any]:
    """The `VecNormalize`, if one normalises observations, and the environment of ours."""
    normalizer = None
    while isinstance(envs, VecEnvWrapper):
        if isinstance(envs, VecNormalize) and envs.norm_obs:
            if normalizer is not None:
                raise InputError("the environment stands in two VecNormalize, but can stand in one")
            normalizer = envs
        elif not isinstance(envs, (*_CHANGE_NOTHING, VecNormalize)):
            raise InputError(f"the environment stands in a {type(envs).__name__}, which is not known here")
        envs = envs.venv
    if isinstance(envs, StableVectorEnv):
        return normalizer, envs.envs
    if not isinstance(envs, DummyVecEnv):
        raise InputError(f"the environment is a {type(envs).__name__}, but must be a StableVectorEnv or a DummyVecEnv")
    env = envs.envs[0]
    while env is not env.unwrapped:
        if type(env).__name__ not in _OF_GYMNASIUM:
            raise InputError(f"the environment stands in a {type(env).__name__}, which is not known here")
        env = env.env
    return normalizer, env


def _prepared(normalizer: Any) -> dict[str, Any]:
    """What is done to observations before the layers, as arguments of `save_policy`."""
    if normalizer is None:
        return {}
    known = normalizer.obs_rms
    scale = 1.0 / np.sqrt(known.var + normalizer.epsilon)
    return {"offset": known.mean, "scale": scale, "limit": normalizer.clip_obs}


def _layers_of(policy: Any) -> Sequence[Layer]:
    """The layers of a policy's mean."""
    match policy:
        case ActorCriticPolicy():
            layers, squashed = torch_layers([*policy.mlp_extractor.policy_net, policy.action_net]), policy.squash_output
        case SACPolicy():
            layers, squashed = torch_layers([*policy.actor.latent_pi, policy.actor.mu]), True
        case TD3Policy():
            layers, squashed = torch_layers(policy.actor.mu), False
        case _:
            raise InputError(f"the policy is a {type(policy).__name__}, but must be one of PPO, A2C, SAC, TD3 or DDPG")
    return [*layers[:-1], layers[-1]._replace(activation="tanh")] if squashed else layers
