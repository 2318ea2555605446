"""Tests of the shipped vehicles with gains that are designed for each of them."""

from pathlib import Path

import pytest

from drake_quad import load_scenario, run_monte_carlo, simulate
from drake_quad.design.cascade import design_cascade, with_gains
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.shipped import shipped_scenarios

FOLDER = Path(__file__).parent.parent / "diagrams" / "vehicles"
# Largest RMSE, m. A Crazyflie without its own attitude control responds within a third of a second.
MAX_RMSE = {
    "paper": 0.02,
    "paper_with_drag": 0.4,
    "crazyflie": 1.3,
    "crazyflie_onboard": 0.06,
    "hummingbird": 0.2,
    "racer": 0.02,
}


def test_every_vehicle_is_flown_here_or_compared_with_real_flights():
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {*MAX_RMSE, "neural_fly"}


# Largest share of 200 samples that crash. A Crazyflie without its own attitude control has rotors with a lag of 80 to
# 220 ms, and a radio link with a delay of 20 to 60 ms.
MAX_CRASH_SHARE = {
    "crazyflie": 0.05,
    "crazyflie_onboard": 0.005,
    "hummingbird": 0.005,
    "neural_fly": 0.005,
    "racer": 0.005,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MAX_CRASH_SHARE)
def test_a_vehicle_flies_a_bad_day_with_the_controller_designed_for_it(name):
    metrics = run_monte_carlo(load_scenario(f"bad_day:{name}"), 200, num_workers=1).metrics
    assert metrics.crashed.mean() <= MAX_CRASH_SHARE[name]


def test_every_vehicle_except_the_papers_has_a_bad_day():
    others = {*MAX_RMSE, "neural_fly"} - {"paper", "paper_with_drag"}
    shipped = {name for name in shipped_scenarios() if name.startswith("bad_day:")}
    assert shipped == {f"bad_day:{name}" for name in others}


@pytest.mark.slow
@pytest.mark.parametrize("name", MAX_RMSE)
def test_a_vehicle_flies_with_gains_designed_for_it(name):
    scenario = load_undesigned(FOLDER / f"{name}.yaml")
    metrics = simulate(with_gains(scenario, design_cascade(scenario).gains()), compiled=True).metrics
    assert not metrics.crashed
    assert metrics.rmse < MAX_RMSE[name]


def test_the_papers_vehicle_is_the_default():
    paper = load_undesigned(FOLDER / "paper.yaml")
    assert (paper.nominal, paper.vehicle.model_dump()) == (type(paper.nominal)(), type(paper.vehicle)().model_dump())
