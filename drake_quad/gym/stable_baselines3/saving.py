"""Saving of a policy of Stable-Baselines3 as a controller."""

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
from drake_quad.gym.saving import Layer, evaluate_layers, save_policy, torch_layers
from drake_quad.gym.stable_baselines3.vector_env import StableVectorEnv

# Wrappers that change neither observations nor actions, for vector environments and for single environments.
_TRANSPARENT_VECTOR_WRAPPERS = (VecMonitor, VecCheckNan)
_TRANSPARENT_WRAPPERS = (Monitor.__name__, "TimeLimit", "OrderEnforcing", "PassiveEnvChecker")
# Number of random observations for which the actions of the saved network are compared with those of the model.
_NUM_TEST_OBSERVATIONS = 64
# Tolerance on the compared actions in [-1, 1]. The model computes them in single precision.
_ACTION_TOLERANCE = 1e-3


def save_trained(model: Any, path: Path | str) -> Path:
    """Write the network that computes the mean action of a model's policy as a controller file.

    Args:
        model: model of PPO, A2C, SAC, TD3 or DDPG with an `MlpPolicy`. Its environment must be a `StableVectorEnv`, or
            a `DummyVecEnv` with environments of this package. A `VecNormalize` may wrap the environment.
        path: path of the .yaml file; see `save_policy`.

    Raises:
        InputError: if the environment is not an environment of this package, if the type of the policy or of a wrapper
            is not supported, or under the conditions of `save_policy`.
    """
    envs = model.get_env()
    if envs is None:
        raise InputError("the model has no environment, so its observations are not defined; load it with env=...")
    normalizer, env = _unwrapped(envs)
    layers, normalization = _layers_of(model.policy), _normalization(normalizer)
    size = layers[0].weights.shape[1]
    observations = np.random.default_rng(0).normal(size=(_NUM_TEST_OBSERVATIONS, size))
    if normalizer is not None:
        observations = normalizer.obs_rms.mean + observations * np.sqrt(normalizer.obs_rms.var)
    inputs = observations if normalizer is None else normalizer.normalize_obs(observations)
    expected, _ = model.predict(np.asarray(inputs, dtype=np.float32), deterministic=True)
    if not np.allclose(
        evaluate_layers(layers, observations, **normalization), expected, rtol=0.0, atol=_ACTION_TOLERANCE
    ):
        raise InputError("the policy cannot be saved: its dense layers do not reproduce its actions")
    return save_policy(env, layers, path, **normalization)


def _unwrapped(envs: Any) -> tuple[Any, Any]:
    """Return the `VecNormalize` that normalises observations, or None, and the environment of this package."""
    normalizer = None
    while isinstance(envs, VecEnvWrapper):
        if isinstance(envs, VecNormalize) and envs.norm_obs:
            if normalizer is not None:
                raise InputError(
                    "two VecNormalize wrappers normalise the observations of the environment; use only one"
                )
            normalizer = envs
        elif not isinstance(envs, (*_TRANSPARENT_VECTOR_WRAPPERS, VecNormalize)):
            raise InputError(f"the environment is wrapped in a {type(envs).__name__}, which is not supported")
        envs = envs.venv
    if isinstance(envs, StableVectorEnv):
        return normalizer, envs.envs
    if not isinstance(envs, DummyVecEnv):
        raise InputError(f"the environment is a {type(envs).__name__}, but must be a StableVectorEnv or a DummyVecEnv")
    env = envs.envs[0]
    while env is not env.unwrapped:
        if type(env).__name__ not in _TRANSPARENT_WRAPPERS:
            raise InputError(f"the environment is wrapped in a {type(env).__name__}, which is not supported")
        env = env.env
    return normalizer, env


def _normalization(normalizer: Any) -> dict[str, Any]:
    """Return the normalisation of observations, as arguments of `save_policy`."""
    if normalizer is None:
        return {}
    statistics = normalizer.obs_rms
    scale = 1.0 / np.sqrt(statistics.var + normalizer.epsilon)
    return {"offset": statistics.mean, "scale": scale, "limit": normalizer.clip_obs}


def _layers_of(policy: Any) -> Sequence[Layer]:
    """Return the layers of the network that computes a policy's mean action."""
    match policy:
        case ActorCriticPolicy():
            layers, squashed = torch_layers([*policy.mlp_extractor.policy_net, policy.action_net]), policy.squash_output
        case SACPolicy():
            layers, squashed = torch_layers([*policy.actor.latent_pi, policy.actor.mu]), True
        case TD3Policy():
            layers, squashed = torch_layers(policy.actor.mu), False
        case _:
            raise InputError(
                f"the policy is a {type(policy).__name__}, but must be a policy of PPO, A2C, SAC, TD3 or DDPG"
            )
    return [*layers[:-1], layers[-1]._replace(activation="tanh")] if squashed else layers
