"""Trains a policy from nothing that hovers and tracks, in the ideal laboratory, and flies it there and in the wind.

It needs Stable-Baselines3: pip install 'drake_quad[learn]'
"""

import sys

from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from drake_quad import load_scenario, mean_interval, run_monte_carlo, simulate
from drake_quad.gym import QuadrotorVectorEnv
from drake_quad.gym.stable_baselines3 import StableVectorEnv, save_trained

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 3_000_000
# So far off a vehicle begins anew: what it learns there is of no use.
CLOSE = {"crash.position_error": 1.0}

if __name__ == "__main__":
    envs = QuadrotorVectorEnv(
        "figure_eight", CLOSE, num_envs=64, action="rates", autoreset_mode=AutoresetMode.SAME_STEP
    )
    model = PPO(
        "MlpPolicy",
        VecNormalize(StableVectorEnv(envs), gamma=0.99),
        n_steps=128,
        batch_size=2048,
        n_epochs=8,
        learning_rate=5e-4,
        gamma=0.99,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
        seed=0,
        device="cpu",
    )
    model.learn(STEPS, progress_bar=False)
    policy = save_trained(model, "out/trained")
    for name in ("figure_eight", "hover"):
        flight = simulate(load_scenario(name, layers=[policy]), compiled=True)
        print(f"RMSE, {name}: {100 * flight.metrics.rmse:.1f} cm")
    windy = run_monte_carlo(load_scenario("laboratory:low_wind", layers=[policy]), 200)
    print(f"RMSE, in low wind: {mean_interval(windy.metrics.rmse).text('.1f', unit='cm', size=0.01)}")
    print(f"crashes there: {windy.metrics.crashed.sum()} of 200")
