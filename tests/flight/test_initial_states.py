"""Tests of initial states of the vehicle."""

import math

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, run_monte_carlo, simulate, simulate_samples
from drake_quad.assembly.laboratory import vehicle_parameters
from drake_quad.flight.remarks import flight_remarks
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.signals import SIGNALS
from drake_quad.vehicle.dynamics import hover_rotor_speeds

INITIAL_STATE = {
    "position": [0.3, -0.2, 0.1],
    "velocity": [1.0, -2.0, 0.5],
    "attitude": [math.pi - 0.2, -0.4, 0.3],
    "body_rates": [2.0, -3.0, 1.0],
    "rotor_speeds": [0.5, 0.6, 0.0, 1.0],
}
HIGH_HOVER = {"route.position": [1.0, 2.0, 8.0], "route.yaw": 0.5, "crash.tilt": None, "duration": 1.0}


def started(initial, name="hover", **fields):
    """Return a scenario with an initial state, high above the ground."""
    overrides = {**HIGH_HOVER, **fields}
    return load_scenario(name, [{"initial": initial}, *({key: value} for key, value in overrides.items())])


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("frame", ["reference", "world"])
def test_a_flight_begins_in_the_initial_state(frame, compiled):
    scenario = started({**INITIAL_STATE, "frame": frame})
    flight = simulate(scenario, compiled=compiled)
    origin, yaw = ([1.0, 2.0, 8.0], 0.5) if frame == "reference" else ([0.0, 0.0, 0.0], 0.0)
    position = np.add(INITIAL_STATE["position"], origin)
    attitude = np.add(INITIAL_STATE["attitude"], [0.0, 0.0, yaw])
    expected = [*position, *attitude, *INITIAL_STATE["velocity"], *INITIAL_STATE["body_rates"]]
    assert flight["state"][0] == pytest.approx(expected, abs=1e-12)
    hover = hover_rotor_speeds(vehicle_parameters(scenario.vehicle))
    assert flight["rotor_speed"][0] == pytest.approx(np.multiply(hover, INITIAL_STATE["rotor_speeds"]), rel=1e-12)


def test_a_thrown_vehicle_falls_freely_while_its_rotors_stand_still():
    initial_state = {"velocity": [1.0, 0.0, 3.0], "rotor_speeds": [0.0, 0.0, 0.0, 0.0]}
    scenario = started(initial_state, **{"vehicle.rotor_time_constant": 1000.0, "duration": 0.5})
    flight = simulate(scenario)
    time, state = flight.time, flight["state"]
    assert state[:, 0] == pytest.approx(1.0 + time, abs=1e-3)
    assert state[:, 2] == pytest.approx(8.0 + 3.0 * time - 0.5 * 9.81 * time**2, abs=1e-3)


def test_a_vehicle_with_a_continuous_state_begins_in_the_given_initial_state():
    scenario = started(INITIAL_STATE, **{"vehicle.time_step": 0.0, "duration": 0.2})
    stepping = simulate(started(INITIAL_STATE, duration=0.2), compiled=False)
    assert simulate(scenario)["state"][0] == pytest.approx(stepping["state"][0], abs=1e-9)


@pytest.mark.slow
def test_initial_states_are_drawn_for_each_sample_of_a_study():
    initial = {
        "velocity": [{"uniform": {"min": -1.0, "max": 1.0}}, 0.0, 0.0],
        "attitude": [{"choice": [0.2, 0.4]}, 0, 0],
    }
    scenario = started(initial)
    study = run_monte_carlo(scenario, 6, num_workers=1, batch_size=4)
    flights = simulate_samples(scenario, range(6))
    v_x, roll = (SIGNALS["state"]._fields.index(name) for name in ("v_x", "roll"))
    for i, flight in enumerate(flights):
        assert flight["state"][0, v_x] == study.parameters["initial.velocity.0"][i]
        assert flight["state"][0, roll] == study.parameters["initial.attitude.0"][i]
        assert study.metrics.rmse[i] == flight.metrics.rmse
    assert len(np.unique(study.parameters["initial.velocity.0"])) == 6


@pytest.mark.slow
def test_a_vehicle_with_an_identified_attitude_response_has_its_initial_body_rates():
    scenario = load_scenario(
        "neural_fly:still", [{"initial": {"attitude": [0.3, 0.2, 0.1], "body_rates": [1.0, 2.0, 3.0]}}]
    )
    flight = simulate(scenario, until=0.1)
    assert flight["state"][0, 9:] == pytest.approx([1.0, 2.0, 3.0], rel=1e-9)


def test_linear_models_apply_to_hover_and_not_to_the_initial_state():
    thrown, hovering = started(INITIAL_STATE), started({})
    assert np.array_equal(closed_loop(thrown).system.A, closed_loop(hovering).system.A)


def test_the_overshoot_is_the_largest_error_opposite_to_the_initial_error():
    offset = np.array([0.4, 0.3, 0.0])
    metrics = {"metrics.additional": {"overshoot": {}}, "duration": 6.0, "control.position.k_d": [0.5, 0.5, 3.0]}
    flight = simulate(started({"position": offset.tolist()}, **metrics))
    error = flight["state"][:, :3] - flight["reference"][:, :3]
    along = error @ offset / 0.5
    assert flight.metrics.overshoot == pytest.approx(-along.min(), rel=1e-12)
    assert flight.metrics.overshoot > 0.05


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ({"attitude": [0.0, 2.0, 0.0]}, r"initial\.attitude\.1"),
        ({"attitude": [4.0, 0.0, 0.0]}, r"initial\.attitude\.0"),
        ({"rotor_speeds": [-0.1, 1.0, 1.0, 1.0]}, r"initial\.rotor_speeds\.0"),
        ({"frame": "body"}, r"initial\.frame"),
    ],
)
def test_invalid_initial_states_are_refused(initial, message):
    with pytest.raises(InputError, match=message):
        started(initial)


@pytest.mark.parametrize(
    ("overrides", "remark"),
    [
        ({"crash.height": 1.0}, "crash.height is 1 m, but the reference flies as low as 1 m"),
        ({"initial.attitude": [1.5, 0.0, 0.0]}, "initial.attitude is a tilt of 1.5 rad, but crash.tilt is 1.4 rad"),
    ],
)
def test_a_remark_warns_of_a_crash_at_the_beginning_of_a_flight(overrides, remark):
    (actual,) = flight_remarks(load_scenario("hover", overrides))
    assert remark in actual
    assert not flight_remarks(load_scenario("hover"))


def test_a_remark_warns_if_a_thrown_vehicle_has_the_route_of_a_laboratory(tmp_path):
    """The scenario `upset` counts a vehicle at height 0 as crashed, and the route of the laboratory begins there."""
    path = tmp_path / "mixed.yaml"
    path.write_text("mixed: {extends: [upset, laboratory:nominal]}\n")
    assert any("crash.height is 0 m" in sentence for sentence in flight_remarks(load_scenario(path)))
