"""Tests of predicted flights of a real quadrotor in wind, whose identification did not use its positions."""

import math
import re
import runpy

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.flight.simulation import simulate_samples

# RMS errors of measured positions over six laps, cm (O'Connell et al., Science Robotics 7(66), eabm6597, 2022).
MEASURED_RMSE_CM = {"still": 11.9, "wind_4": 10.7, "wind_8": 16.3, "wind_12": 23.9, "wind_8_sine": 31.2}
SETTLING_TIME = 4.0 * math.pi  # s, duration of the first two laps, which are not evaluated


def measured_rmse(flight):
    """Return the RMS error of the positions that the cameras measure, cm."""
    error = (flight["measurement"] - np.pad(flight["reference"], ((0, 0), (0, 1))))[flight.time >= SETTLING_TIME, :3]
    return 100.0 * math.sqrt(np.mean(np.sum(error**2, axis=1)))


def predicted_rmse(diagrams, name, *overrides):
    scenario = load_scenario(diagrams / "vehicles" / f"neural_fly.yaml:{name}", overrides)
    return measured_rmse(simulate(scenario, compiled=True))


def row_of_page(root, name):
    """Return the values in a row of the first table in the documentation page on real flights."""
    page = (root / "docs" / "background" / "real_flights.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| {name} \| (.*) \|$", page, re.MULTILINE)[1]
    return [float(cell.removesuffix(" %")) for cell in row.split(" | ")]


@pytest.mark.long
def test_simulated_errors_of_neural_fly_agree_with_the_real_flights(diagrams, root):
    """In all winds, the simulated RMS error differs from that of the real flight by at most 20 %.

    The first table of docs/background/real_flights.md contains the measured and the simulated errors.
    """
    rmse = {name: predicted_rmse(diagrams, name) for name in MEASURED_RMSE_CM}
    assert rmse == pytest.approx(MEASURED_RMSE_CM, rel=0.2)
    assert row_of_page(root, "flown") == [*MEASURED_RMSE_CM.values()]
    assert row_of_page(root, "as identified") == pytest.approx(list(rmse.values()), abs=0.051)
    differences = [100.0 * (rmse[name] / real_rmse - 1.0) for name, real_rmse in MEASURED_RMSE_CM.items()]
    assert row_of_page(root, "difference from the flights") == pytest.approx(differences, abs=0.51)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["still", "wind_4", "wind_8", "wind_12"])
def test_a_model_with_isotropic_drag_and_the_nominal_thrust_curve_underestimates_the_errors(diagrams, name):
    isotropic = [
        "vehicle.body_drag=null",
        "vehicle.rotor_aerodynamics=null",
        "vehicle.linear_drag=0.357",
        "vehicle.quadratic_drag=0.0732",
        "vehicle.motors={kind: throttle, curve: [0.0, 14.27, 0.0]}",
    ]
    assert predicted_rmse(diagrams, name, *isotropic) < 0.75 * MEASURED_RMSE_CM[name]


@pytest.mark.long
def test_errors_with_noise_and_turbulence_agree_with_the_real_flights(diagrams, root):
    """Means are over 16 samples of the shipped scenarios. Their standard error is below 2 %."""
    rmse = {}
    for name in MEASURED_RMSE_CM:
        flights = simulate_samples(load_scenario(diagrams / f"neural_fly.yaml:{name}"), range(16), compiled=True)
        assert not any(flight.metrics.crashed for flight in flights)
        rmse[name] = np.mean([measured_rmse(flight) for flight in flights])
    assert rmse == pytest.approx(MEASURED_RMSE_CM, rel=0.2)
    assert row_of_page(root, "with noise and turbulence, 16 flights") == pytest.approx(list(rmse.values()), abs=0.051)


@pytest.mark.slow
def test_the_error_depends_on_the_phase_of_the_wind(diagrams):
    against, along = (
        predicted_rmse(diagrams, "wind_8_sine", f"laboratory.wind.1.phase={phase}") for phase in (1.57, 1.57 + math.pi)
    )
    assert against > 1.5 * along


@pytest.mark.slow
def test_the_amplitude_and_phase_of_the_wind_are_identified_from_a_log(root, diagrams, tmp_path, monkeypatch):
    """The result does not depend on the phase of the path at the start of the log."""
    monkeypatch.syspath_prepend(root / "tests" / "identification")
    from neural_fly_flight import write_flight

    script = runpy.run_path(str(root / "scripts" / "development" / "predict_flights.py"))
    wind = ["laboratory.wind.1.phase=4.1", "laboratory.wind.1.velocity=[-1.7, 0.0, 0.0]", "route.phase=[0.6, 0.0, 1.2]"]
    scenario = load_scenario(diagrams / "vehicles" / "neural_fly.yaml:wind_8_sine", wind)
    amplitude, phase = script["sine_in_log"](write_flight(tmp_path / "flight.csv", scenario))
    assert amplitude == pytest.approx(1.7, rel=0.05)
    assert phase == pytest.approx(4.1 - 0.6, abs=0.05)
