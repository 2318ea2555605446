"""Tests of Kalman filters whose statistics vary from vehicle to vehicle."""

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.scenario.batch import Batch

POSITION = "control.position"
OBSERVER_OVERRIDES = [
    f"{POSITION}={{kind: disturbance_observer, k_p: [1.0, 1.2, 4.7], k_d: [3.5, 3.3, 6.0], position_noise: 0.001,"
    " response: {kind: tilt, delay_ticks: 1, lag: 0.137}, deviation: [2.2, 1.9, 0.1], time_constant: [15, 12, 3.6]}",
    "duration=2",
]


@pytest.mark.long
def test_each_vehicle_of_a_fleet_has_a_filter_for_its_own_statistics(diagrams):
    scenario = load_scenario(diagrams / "laboratory.yaml:high_wind", OBSERVER_OVERRIDES)
    varying = {
        f"{POSITION}.deviation.0": np.array([0.3, 4.0]),
        f"{POSITION}.time_constant.1": np.array([0.5, 30.0]),
    }
    batch = Batch.draw(scenario, [3, 4]).with_varying(varying)
    together = StudyFleet(scenario, plan_route(scenario), 2).fly_batch(batch)
    for vehicle in (0, 1):
        alone = StudyFleet(batch.vehicle_scenario(vehicle), plan_route(batch.vehicle_scenario(vehicle)), 1).fly(
            [vehicle + 3]
        )
        assert float(together.rmse[vehicle]) == pytest.approx(float(alone.rmse[0]), rel=1e-9)
    same = StudyFleet(scenario, plan_route(scenario), 2).fly([3, 4])
    assert abs(float(together.rmse[0] - same.rmse[0])) > 1e-4
