"""Tests that each shipped vehicle flies with gains designed for it, and rarely crashes in its bad-day scenario."""

from pathlib import Path

import pytest

from drake_quad import load_scenario, run_monte_carlo, simulate
from drake_quad.design.cascade import design_cascade, with_gains
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.shipped import shipped_scenarios

FOLDER = Path(__file__).parent.parent / "diagrams" / "vehicles"
# Largest accepted RMSE, m. The limit is wide for `crazyflie`, which has no onboard attitude control: its attitude takes
# a third of a second to respond.
MAX_RMSE = {
    "paper": 0.02,
    "paper_with_drag": 0.4,
    "crazyflie": 1.3,
    "crazyflie_onboard": 0.06,
    "hummingbird": 0.2,
    "racer": 0.3,
}


def test_every_shipped_vehicle_is_tested_here_except_the_one_compared_with_real_flights():
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {*MAX_RMSE, "neural_fly"}


# Largest accepted fraction of crashed flights among 200 samples. The limit is wide for `crazyflie`, which has no
# onboard attitude control: a radio link delays its commands by 20 to 60 ms, and its rotors lag by 80 to 220 ms.
MAX_CRASH_FRACTION = {
    "crazyflie": 0.05,
    "crazyflie_onboard": 0.005,
    "hummingbird": 0.005,
    "neural_fly": 0.005,
    "racer": 0.005,
}


@pytest.mark.long
@pytest.mark.parametrize("name", MAX_CRASH_FRACTION)
def test_a_vehicle_rarely_crashes_in_its_bad_day_scenario(name):
    metrics = run_monte_carlo(load_scenario(f"bad_day:{name}"), 200, num_workers=1).metrics
    assert metrics.crashed.mean() <= MAX_CRASH_FRACTION[name]


def test_every_vehicle_except_the_paper_s_has_a_bad_day_scenario():
    vehicles = {*MAX_RMSE, "neural_fly"} - {"paper", "paper_with_drag"}
    shipped = {name for name in shipped_scenarios() if name.startswith("bad_day:")}
    assert shipped == {f"bad_day:{name}" for name in vehicles}


@pytest.mark.long
@pytest.mark.parametrize("name", MAX_RMSE)
def test_a_vehicle_flies_with_gains_designed_for_it(name):
    scenario = load_undesigned(FOLDER / f"{name}.yaml")
    metrics = simulate(with_gains(scenario, design_cascade(scenario).gains()), compiled=True).metrics
    assert not metrics.crashed
    assert metrics.rmse < MAX_RMSE[name]


def test_the_default_vehicle_is_that_of_the_paper():
    paper = load_undesigned(FOLDER / "paper.yaml")
    assert (paper.nominal, paper.vehicle.model_dump()) == (type(paper.nominal)(), type(paper.vehicle)().model_dump())
