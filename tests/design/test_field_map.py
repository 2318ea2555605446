"""Tests of maps of flight metrics over two fields, by comparison with single flights."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.design.field_map import field_map

ROLL, RATE = "initial.attitude.0", "initial.body_rates.0"
# Medians of the distributions that the map does not vary.
MEDIANS_OF_OTHER_FIELDS = {
    "initial.position": [0.0, 0.0, 0.0],
    "initial.velocity": [0.0, 0.0, 0.0],
    "initial.rotor_speeds": [0.6, 0.6, 0.6, 0.6],
}


def scenario_of_throw(overrides=(), **fields):
    """Return a scenario with a short flight of a thrown vehicle, which must recover early and must not fall too far."""
    short = {
        "duration": 2.0,
        "requirements.recovers": {"always": {"signal": "position_error", "below": 0.6}, "after": 1.0},
        "crash.position_error": 1.5,
        **fields,
    }
    return load_scenario("upset", [short, *overrides])


def ranges(roll=3.0, rate=8.0):
    return [f"{path}={{uniform: {{min: {-end}, max: {end}}}}}" for path, end in ((ROLL, roll), (RATE, rate))]


@pytest.mark.long
def test_each_cell_of_the_map_is_a_flight_with_the_other_random_fields_at_their_medians():
    result = field_map(scenario_of_throw(ranges()), ROLL, RATE, size=3)
    np.testing.assert_allclose(result.x, [-2.0, 0.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(result.y, [-16.0 / 3.0, 0.0, 16.0 / 3.0], atol=1e-12)
    assert 0 < result.metrics.crashed.sum() < 9
    for row, column in ((0, 1), (1, 2), (2, 0)):
        initial = {"initial.attitude": [result.x[column], 0.0, 0.0], "initial.body_rates": [result.y[row], 0.0, 0.0]}
        flight = simulate(scenario_of_throw(**MEDIANS_OF_OTHER_FIELDS, **initial), sample=0)
        for name in ("rmse", "largest_tilt", "recovers", "crash_time"):
            assert getattr(result.metrics, name)[row, column] == pytest.approx(
                getattr(flight.metrics, name), rel=1e-6, nan_ok=True
            )


@pytest.mark.slow
def test_flights_that_crash_or_violate_a_requirement_are_not_satisfactory():
    result = field_map(scenario_of_throw(ranges()), ROLL, RATE, size=4)
    violated = result.metrics.recovers < 0.0
    np.testing.assert_array_equal(result.satisfied, ~result.metrics.crashed & ~violated)
    assert (~result.metrics.crashed & violated).any()
    assert result.satisfied.any()


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        (ROLL, ROLL, "both axes of the map are initial.attitude.0; name two different fields"),
        (ROLL, "vehicle.mass", "vehicle.mass is not a distribution of upset; its distributions are initial.position.0"),
    ],
)
def test_invalid_axes_of_a_map_are_refused(x, y, message):
    with pytest.raises(InputError, match=message):
        field_map(scenario_of_throw(), x, y, size=2)
