"""Train a policy that hovers and tracks, and fly it in the ideal laboratory and in the wind.

The script needs Stable-Baselines3: pip install 'drake_quad[learn]'. Its optional arguments are the number of steps, the
laboratory, and the path of the policy's file.
"""

import sys

from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from drake_quad import load_scenario, mean_interval, run_monte_carlo, simulate
from drake_quad.gym import QuadrotorVectorEnv
from drake_quad.gym.stable_baselines3 import StableVectorEnv, save_trained

# Training episodes end at this distance from the reference (m), since a policy learns nothing useful farther away.
CRASH_LIMIT = {"crash.position_error": 1.0}
# Training uses the seeds 0 to 63, so the test uses another one.
TEST_SEED = 1000

if __name__ == "__main__":  # worker processes import this file
    steps, laboratory, path = [*sys.argv[1:], *["1000000", "figure_eight", "out/trained.yaml"][len(sys.argv) - 1 :]]
    envs = QuadrotorVectorEnv(
        laboratory,
        CRASH_LIMIT,
        num_envs=64,
        action="rates",
        observation={"history": 5},
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    model = PPO(
        "MlpPolicy",
        VecNormalize(StableVectorEnv(envs), gamma=0.99),
        n_steps=128,
        batch_size=2048,
        n_epochs=8,
        learning_rate=lambda left: 5e-4 * left,
        gamma=0.99,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
        seed=0,
        device="cpu",
    )
    policy = save_trained(model.learn(int(steps)), path)
    for name in ("figure_eight", "hover"):
        flight = simulate(load_scenario(name, layers=[policy]))
        print(f"RMSE, {name}: {100 * flight.metrics.rmse:.1f} cm")
    windy = run_monte_carlo(load_scenario("laboratory:low_wind", layers=[policy]), 200, TEST_SEED).metrics
    print(f"crashes in low wind: {windy.crashed.sum()} of 200")
    if windy.crashed.sum() < 199:
        without_crashes = mean_interval(windy.rmse[~windy.crashed])
        print(f"RMSE in low wind without crashes: {without_crashes.text(unit='cm', size=0.01)}")
