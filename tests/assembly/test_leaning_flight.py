"""Tests of a vehicle that leans against the wind under linear-quadratic-Gaussian control."""

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.flight.simulation import simulate_batch
from drake_quad.scenario.batch import Batch


@pytest.mark.long
def test_noise_of_the_measured_height_does_not_shift_a_leaning_vehicle_sideways(diagrams):
    """The noise changes the thrust of a vehicle that is tilted by 30°.

    The controller must not interpret these changes as rotations.
    """
    x_positions = []
    for noise in (0.001, 1e-6):
        scenario = load_scenario(
            f"{diagrams}/neural_fly.yaml:wind_12",
            [
                "route={kind: hover, position: [0, 0, 1], duration: 12}",
                "metrics={start: 0}",
                f"laboratory.motion_capture.position_noise={noise}",
            ],
            layers=[f"{diagrams}/controllers/designed/neural_fly.yaml:lqg"],
        )
        flights = simulate_batch(Batch.draw(scenario, range(8)), compiled=True)
        mean_state = np.mean([flight["state"][flight.time > 6.0] for flight in flights], axis=(0, 1))
        _, _, height, _, pitch, *_ = mean_state
        assert pitch > np.radians(25.0)
        assert abs(height - 1.0) < 0.002
        x_positions.append(mean_state[0])
    assert abs(x_positions[0] - x_positions[1]) < 0.01
