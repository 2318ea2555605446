"""Flights of a real quadrotor in wind, predicted from what was identified of it, but not from its positions."""

import re

import pytest

from drake_quad import load_scenario, simulate
from drake_quad.studies.comparison import fly_samples

# RMS errors over six laps that were flown, cm (O'Connell et al., Science Robotics 7(66), eabm6597, 2022).
FLOWN = {"still": 11.9, "wind_4": 10.7, "wind_8": 16.3, "wind_12": 23.9, "wind_8_sine": 31.2}


def predicted(diagrams, name, *overrides):
    scenario = load_scenario(diagrams / "vehicles" / f"neural_fly.yaml:{name}", overrides)
    return 100.0 * simulate(scenario, compiled=True).metrics.rmse


@pytest.mark.slow
def test_the_vehicle_of_neural_fly_flies_here_as_it_flew_there(diagrams, root):
    """Within 25 % in all winds, and as the page of real flights says."""
    found = {name: predicted(diagrams, name) for name in FLOWN}
    assert found == pytest.approx(FLOWN, rel=0.25)
    page = (root / "docs" / "background" / "real_flights.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| as identified \| (.*) \|$", page, re.MULTILINE)
    assert [float(cell) for cell in row.split(" | ")] == pytest.approx(list(found.values()), abs=0.051)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["still", "wind_4", "wind_8", "wind_12"])
def test_with_drag_from_all_sides_and_the_thrust_that_is_believed_it_does_not(diagrams, name):
    isotropic = [
        "vehicle.body_drag=null",
        "vehicle.rotor_aerodynamics=null",
        "vehicle.linear_drag=0.357",
        "vehicle.quadratic_drag=0.0732",
        "vehicle.motors={kind: throttle, curve: [0.0, 14.27, 0.0]}",
    ]
    assert predicted(diagrams, name, *isotropic) < 0.75 * FLOWN[name]


@pytest.mark.slow
def test_with_noise_and_turbulence_it_still_does(diagrams):
    """The mean of 16 samples in the laboratory where controllers are compared; its standard error is below 2 %."""
    for name, flown in FLOWN.items():
        found = fly_samples(load_scenario(diagrams / f"neural_fly.yaml:{name}"), range(16))
        assert not found.crashed.any()
        assert 100.0 * found.rmse.mean() == pytest.approx(flown, rel=0.25), name
