"""Tests of flights of a vehicle whose rotors cannot exert the commanded thrust."""

from typing import get_args

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.flight.simulation import simulate_samples
from drake_quad.vehicle.allocation import Priority


def overloaded(priority):
    """Return the flight of a vehicle with more than twice its nominal weight and a centre of mass 0.5 mm off centre.

    To hold the position, the controller commands the largest permitted thrust, which the rotors cannot produce.
    """
    overrides = {
        "vehicle.mass": 1.5,
        "vehicle.centre_of_mass": [0.0, 0.0005],
        "control.thrust_vectoring.max_thrust": 2.3,
        "laboratory.allocation.priority": priority,
        "crash": {"position_error": 1000.0, "height": -1000.0},
        "duration": 3.0,
    }
    return simulate(load_scenario("hover", overrides), compiled=True)


@pytest.mark.slow
def test_an_overloaded_vehicle_sinks_level_if_roll_and_pitch_have_priority():
    """The final torque of the rotors is the thrust times the offset of the centre of mass."""
    flight = overloaded("roll_pitch")
    assert not flight.metrics.crashed
    state, shortfall = flight.record("state"), flight.record("shortfall")
    assert np.max(np.abs([state.roll, state.pitch])) < np.radians(10.0)
    assert state.z[-1] < state.z[0] - 1.0
    assert shortfall.thrust[-1] > 0.0
    np.testing.assert_array_equal(shortfall.tau_x, 0.0)
    produced = np.subtract(flight["wrench"], flight["shortfall"])[-1]
    assert produced[1] == pytest.approx(produced[0] * 0.0005, rel=0.05)


@pytest.mark.slow
def test_an_overloaded_vehicle_tips_over_if_thrust_has_priority():
    """All rotors turn at their top speed, which leaves no torque to balance the offset of the centre of mass."""
    flight = overloaded("thrust")
    assert flight.metrics.crashed
    assert np.max(np.abs(flight.record("state").roll)) > np.radians(60.0)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["x", "rotors"])
@pytest.mark.parametrize("priority", get_args(Priority))
def test_saturation_is_the_same_in_compiled_fleets_and_single_flights(layout, priority):
    """Only some of the vehicles in a vector register saturate at some times."""
    rotors = [
        {"position": [0.14, -0.11, 0.02], "turns": "clockwise"},
        {"position": [-0.09, -0.13, 0.01], "turns": "anticlockwise", "thrust_factor": 4.1e-5},
        {"position": [-0.13, 0.10, 0.0], "turns": "clockwise", "drag_factor": 1.2e-6},
        {"position": [0.11, 0.14, 0.03], "turns": "anticlockwise"},
    ]
    overrides = {
        "nominal.layout": {"kind": "x"} if layout == "x" else {"kind": "rotors", "rotors": rotors},
        "nominal.min_rotor_speed": 175.0,
        "nominal.max_rotor_speed": 235.0,
        "laboratory.motion_capture.attitude_noise": 0.2,
        "laboratory.allocation.priority": priority,
        "duration": 0.6,
    }
    scenario = load_scenario("hover", overrides)
    fleet = simulate_samples(scenario, range(5), compiled=True)
    saturated = np.array([np.any(flight["shortfall"] != 0.0, axis=1) for flight in fleet])
    assert np.any(saturated.any(axis=0) & ~saturated.all(axis=0))
    alone = simulate(scenario, sample=3, compiled=False)
    for name in ("shortfall", "rotor_speed_command", "state"):
        np.testing.assert_array_equal(fleet[3][name], alone[name], err_msg=name)
