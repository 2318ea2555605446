"""Fly 1,000 samples of an uncertain vehicle in low wind, estimate its RMSE and crash probability, and plot the RMSE.

`drake-quad study` does the same with more tables and plots.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from drake_quad import load_scenario, mean_interval, run_monte_carlo, simulate
from drake_quad.statistics.estimates import proportion_interval

UNCERTAIN_FIELDS = {
    "vehicle.mass": {"normal": {"mean": 0.68, "standard_deviation": 0.03, "min": 0.5}},  # kg
    "vehicle.rotor_time_constant": {"uniform": {"min": 0.03, "max": 0.09}},  # s
    "laboratory.command_link.delay_ticks": {"choice": [1, 2, 3, 4]},
}

if __name__ == "__main__":  # worker processes import this file
    scenario = load_scenario("laboratory:low_wind", UNCERTAIN_FIELDS)
    study = run_monte_carlo(scenario, num_samples=1000, seed=1)
    crashed, rmse = study.metrics.crashed > 0, study.metrics.rmse
    print(f"RMSE without crashes: {mean_interval(rmse[~crashed]).text(unit='cm', size=0.01)}")
    print(f"crashes: {proportion_interval(int(crashed.sum()), len(crashed)).percent()}")
    worst = int(np.argmax(np.where(crashed, -np.inf, rmse)))
    flight = simulate(scenario, seed=1, sample=worst, compiled=True)  # repeats a single sample
    print(f"sample {worst}: {flight.scenario.vehicle.mass:.3f} kg, {100.0 * flight.metrics.rmse:.2f} cm")
    delays = study.parameters["laboratory.command_link.delay_ticks"]
    for delay in np.unique(delays):
        chosen = ~crashed & (delays == delay)
        lag = study.parameters["vehicle.rotor_time_constant"][chosen]
        plt.semilogy(1000.0 * lag, 100.0 * rmse[chosen], ".", label=f"{20.0 * delay:.0f} ms of delay")
    plt.gca().set(xlabel="time constant of the rotors (ms)", ylabel="RMSE (cm)")
    plt.legend()
    Path("out").mkdir(exist_ok=True)
    plt.savefig("out/monte_carlo_study.png")
