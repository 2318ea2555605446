"""Fly a PD with and without an adaptive type-2 fuzzy network in low wind, and compare both on 200 paired samples.

The controllers are those of Kayacan and Maslim (2016), with gains from the replication of their paper. The network
learns during the flight.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from drake_quad import compare_studies, load_scenario, run_monte_carlo, simulate

CONTROLLERS = {"PD": "controllers/calibrated:pd", "PD and T2FNN": "controllers/calibrated:pd_t2fnn"}

if __name__ == "__main__":  # worker processes import this file
    studies = {}
    for name, layer in CONTROLLERS.items():
        scenario = load_scenario("laboratory:low_wind", layers=[layer])
        flight = simulate(scenario, compiled=True)
        print(f"{name}: RMSE {100.0 * flight.metrics.rmse:.1f} cm, peak {100.0 * flight.metrics.peak_error:.1f} cm")
        plt.plot(flight.time, 100.0 * flight.euclidean_error, label=name)
        studies[name] = run_monte_carlo(scenario, num_samples=200, seed=1)  # equal wind and noise for both controllers
    fraction = compare_studies(studies["PD and T2FNN"], studies["PD"]).ratio
    print(f"error with the network, relative to the PD: {fraction.percent()}")
    plt.gca().set(xlabel="time (s)", ylabel="position error (cm)")
    plt.legend()
    Path("out").mkdir(exist_ok=True)
    plt.savefig("out/type2_network_beside_pd.png")
