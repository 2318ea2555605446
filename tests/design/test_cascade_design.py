"""Tests of a cascade's plants: their inputs and outputs, and when two plants count as equal."""

from dataclasses import replace

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.design.cascade import (
    _has_equal_response,
    _impulse_response,
    attitude_plant,
    hover_offset,
    position_plant,
)
from drake_quad.design.gains import AxisPdGains
from drake_quad.linear.closed_loop import laboratory_plant
from drake_quad.linear.sampled_system import SampledSystem


def delay_plant(ticks, gain=1.0):
    """Return a plant that delays its input by a number of ticks."""
    A, B, C = np.eye(ticks, k=1), np.zeros((ticks, 1)), np.zeros((1, ticks))
    B[-1], C[0, 0] = 1.0, gain
    return SampledSystem(A, B, C, np.zeros((1, 1)), 0.02, tuple(map(str, range(ticks))), ("u",), ("y",))


def test_the_compared_impulse_response_has_twice_as_many_samples_as_states():
    plant = replace(delay_plant(3), A=np.diag([0.5, 0.25, 2.0]), B=np.ones((3, 1)), C=np.array([[1.0, 2.0, 3.0]]))
    expected = [0.5**k + 2.0 * 0.25**k + 3.0 * 2.0**k for k in range(6)]
    np.testing.assert_allclose(_impulse_response(plant)[:, 0, 0], expected)
    np.testing.assert_array_equal(_impulse_response(delay_plant(3))[:, 0, 0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def test_plants_with_equal_impulse_responses_count_as_equal():
    plant = replace(delay_plant(2), A=np.array([[0.5, 1.0], [0.0, -0.3]]))
    transformed = plant.transformed([0, 1], np.array([[1.0, 2.0], [-3.0, 1.0]]), ["a", "b"])
    assert _has_equal_response(plant, transformed)
    assert not _has_equal_response(delay_plant(2), delay_plant(3))
    for fraction, is_equal in ((1e-10, True), (1e-8, False)):
        assert _has_equal_response(plant, replace(plant, C=(1.0 + fraction) * plant.C)) == is_equal
        large = replace(plant, C=1e6 * plant.C)
        assert _has_equal_response(large, replace(large, C=(1.0 + fraction) * large.C)) == is_equal
    # The responses of these two plants differ only in the last of four samples.
    different = replace(delay_plant(2), A=np.array([[0.0, 1.0], [0.5, 0.0]]))
    assert _has_equal_response(delay_plant(2), delay_plant(2))
    assert not _has_equal_response(delay_plant(2), different)


@pytest.fixture(scope="module")
def plants():
    scenario = load_scenario(
        "diagrams/laboratory.yaml:nominal", ["nominal.mass=0.75", "nominal.inertia=[0.0065, 0.0085, 0.0126]"]
    )
    return scenario, laboratory_plant(scenario)


def test_the_outputs_of_a_plant_are_a_value_and_its_rate(plants):
    """At low frequencies, each plant is a double integrator for any inertia. Only the height plant has drag."""
    scenario, laboratory = plants
    s = 1j * 0.05
    for axis, rate in (("roll", "p"), ("pitch", "q"), ("yaw", "r"), ("z", "v_z")):
        plant = attitude_plant(laboratory, scenario, axis)
        assert (plant.inputs, plant.outputs) == (
            ("acceleration_command",),
            (f"measurement.{axis}", f"measurement.{rate}"),
        )
        drag = 0.1 / 0.75 if axis == "z" else 0.0
        value, slope = plant.response(np.array([np.exp(s * 0.02)]))[0, :, 0]
        assert value == pytest.approx(1.0 / (s * (s + drag)), rel=0.02)
        assert slope == pytest.approx(s * value, rel=0.02)


def test_the_position_responds_to_a_commanded_acceleration_through_the_tilt(plants):
    """A positive pitch accelerates the vehicle along x, and a positive roll against the direction of y.

    The tilt loop is much faster than the tested frequencies.
    """
    scenario, laboratory = plants
    s, gains = 1j * 0.05, AxisPdGains(6.0, 4.0)
    for axis in "xy":
        plant = position_plant(laboratory, scenario, axis, gains)
        assert plant.outputs == (f"measurement.{axis}", f"measurement.v_{axis}")
        value, rate = plant.response(np.array([np.exp(s * 0.02)]))[0, :, 0]
        assert value == pytest.approx(1.0 / (s * (s + 0.1 / 0.75)), rel=0.06)
        assert rate == pytest.approx(s * value, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("centre", [(0.0004, 0.0), (0.0, -0.0006), (0.0003, 0.0004)])
def test_a_vehicle_hovers_at_the_offset_that_its_displaced_centre_of_mass_predicts(diagrams, centre):
    """The offset is measured from the position at which a vehicle without such a displacement hovers."""
    overrides = [
        "laboratory.autopilot={kind: attitude, k_attitude: [6, 5, 3], k_rate: [14, 12, 8]}",
        "control.position={kind: pd, k_p: [1.5, 1.2, 4], k_d: [1.7, 1.5, 3], feed_forward: acceleration}",
        "route={kind: hover, duration: 20}",
    ]
    scenario, ideal = (
        load_scenario(diagrams / "onboard.yaml", [*overrides, f"vehicle.centre_of_mass={list(centre_of_mass)}"])
        for centre_of_mass in (centre, (0.0, 0.0))
    )
    states = [simulate(each, compiled=True)["state"][-200:, :2].mean(axis=0) for each in (scenario, ideal)]
    assert hover_offset(scenario) == pytest.approx(np.linalg.norm(states[0] - states[1]), rel=0.02)
    assert hover_offset(ideal) == 0.0
