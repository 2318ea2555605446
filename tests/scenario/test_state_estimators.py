"""Tests of state estimators in scenarios: consistent estimates, refused settings, and exact linear models."""

from typing import ClassVar, Literal

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike

from drake_quad import (
    InputError,
    build_tracking_diagram,
    closed_loop,
    laboratory_plant,
    load_scenario,
    simulate_samples,
)
from drake_quad.linear.hover_covariance import linear_hover_error
from drake_quad.linear.step_response import initial_response
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.sensors.aiding import AidingModel
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings

# Components of the measurement, which contain body rates and angles in addition to those of the estimate.
POSITION_AND_VELOCITY = [0, 1, 2, 6, 7, 8]
INERTIAL_SENSORS = [
    {"kind": "gyroscope", "period": 0.005, "noise_density": 1e-4},
    {"kind": "accelerometer", "period": 0.005, "noise_density": 1e-3, "position": [0.02, -0.01, 0.03]},
]
FILTER_WITH_CAMERAS = {
    "vehicle.time_step": 0.005,
    "laboratory.sensors": INERTIAL_SENSORS,
    "laboratory.estimator": {"kind": "error_state_filter", "aiding": {"motion_capture": {}}},
    "laboratory.motion_capture": {
        "period": 0.01,
        "position_noise": 0.002,
        "attitude_noise": 0.004,
        "latency_frames": 1,
    },
}


def with_filter(**changes):
    return load_scenario("hover", {**FILTER_WITH_CAMERAS, "duration": 2.0, **changes})


@pytest.mark.long
@pytest.mark.parametrize("name", ["indoor_flow", "warehouse_uwb"])
def test_the_errors_of_shipped_estimators_have_the_estimated_deviations(name):
    """The position of indoor_flow is better than estimated, because its initial error is zero."""
    flights = simulate_samples(load_scenario(name, {"duration": 6.0}), range(16))
    normalised = []
    for flight in flights:
        error = np.array(flight.record("measurement")) - np.array(flight.record("state"))
        deviation = np.array(flight.record("estimate_deviation"))[:6]
        normalised.append(error[POSITION_AND_VELOCITY] / deviation)
    root_mean_square = np.sqrt(np.square(np.concatenate(normalised, axis=1)).mean(axis=1))
    assert (root_mean_square < 1.3).all()
    assert root_mean_square[3:].min() > 0.6


@pytest.mark.slow
def test_a_scenario_with_lost_frames_and_latencies_flies_alike_in_wired_and_compiled_diagrams():
    scenario = with_filter(**{"laboratory.motion_capture.dropout_rate": 0.2, "duration": 1.0})
    assert_flown_alike(Batch.draw(scenario, [0, 1]))


@pytest.mark.long
def test_lost_frames_do_not_bias_the_estimate():
    """A repeated frame that is used as if it were new would pull the estimate back along the path."""
    override = {"route": {"kind": "figure_eight"}, "duration": 6.0, "laboratory.motion_capture.dropout_rate": 0.5}
    (flight,) = simulate_samples(with_filter(**override), [0])
    error = np.array(flight.record("measurement"))[:3] - np.array(flight.record("state"))[:3]
    assert np.sqrt(np.square(error).sum(axis=0).mean()) < 0.004


@pytest.mark.long
def test_linear_models_contain_the_filter():
    """The response to a small displacement of the vehicle agrees with that of the nonlinear loop."""
    loop = closed_loop(with_filter())
    assert any("estimator.estimate.gyroscope_bias" in name for name in loop.system.states)
    assert not any("covariance" in name or "counters" in name for name in loop.system.states)
    assert np.abs(loop.system.poles()).max() < 1.0
    for row in ("x", "z", "yaw"):
        response = initial_response(loop, {row: 1e-4}, duration=3.0)
        np.testing.assert_allclose(response.nonlinear, response.linear, atol=1e-7)
        assert np.abs(response.linear).max() > 0.5e-4


@pytest.mark.long
def test_hover_has_a_stationary_position_error_without_a_yaw_sensor_but_not_without_a_position_sensor():
    """Without a compass, the yaw drifts, but a small error of the yaw does not act on the position in hover."""
    gnss = {"kind": "gnss", "period": 0.01, "position_noise": [0.1] * 3, "velocity_noise": [0.1] * 3}
    barometer = {"kind": "barometer", "period": 0.01, "height_noise": 0.1}

    def error_with(sensor):
        overrides = {"laboratory.sensors": [*INERTIAL_SENSORS, sensor], "duration": 1.0}
        scenario = with_filter(**overrides, **{"laboratory.estimator": {"kind": "error_state_filter"}})
        return linear_hover_error(scenario)

    assert 0.005 < error_with(gnss).rms < 0.1
    with pytest.raises(InputError, match="an estimator must observe all its states"):
        error_with(barometer)


def test_the_plant_of_a_design_has_the_exact_state_as_its_output():
    period = with_filter().laboratory.command_link.period
    exact = load_scenario("hover", {"vehicle.time_step": 0.005, "laboratory.motion_capture": {"period": period}})
    result, expected = (laboratory_plant(each).system for each in (with_filter(), exact))
    np.testing.assert_array_equal(result.A, expected.A)
    np.testing.assert_array_equal(result.C, expected.C)


def test_a_sensor_that_corrects_estimates_needs_a_measurement_equation():
    class Altimeter(SensorSettings):
        kind: Literal["altimeter"]
        aids: ClassVar = AidingModel("height", (("period",),))

    with pytest.raises(TypeError, match="Altimeter must define aiding_parameters"):
        SENSORS.register(Altimeter)


def test_an_autopilot_on_board_reads_the_estimate():
    diagram = build_tracking_diagram(load_scenario("warehouse_uwb"))
    laboratory = diagram.GetSubsystemByName("laboratory")
    reads = laboratory.GetSubsystemByName("autopilot").GetInputPort("state")
    sources = {
        (target.get_name(), target_port): source.get_name()
        for (target, target_port), (source, _) in laboratory.connection_map().items()
    }
    assert sources["autopilot", reads.get_index()] == "estimator"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"laboratory.sensors": INERTIAL_SENSORS[:1]}, "must contain a sensor of kind accelerometer"),
        (
            {"laboratory.sensors": [INERTIAL_SENSORS[0], {**INERTIAL_SENSORS[1], "period": 0.01}]},
            "laboratory.sensors.1.period.*must be the period of the gyroscope, 0.005",
        ),
        (
            {"laboratory.sensors": [{**INERTIAL_SENSORS[0], "latency_samples": 1}, INERTIAL_SENSORS[1]]},
            "laboratory.sensors.0.latency_samples.*must be 0",
        ),
        (
            {"laboratory.estimator": {"kind": "error_state_filter", "aiding": {"compass": {}}}},
            "laboratory.estimator.aiding.*must not contain compass, .* those are motion_capture",
        ),
        (
            {"laboratory.estimator": {"kind": "error_state_filter"}},
            "laboratory.sensors.*must contain a sensor that corrects the estimate",
        ),
        ({"laboratory.motion_capture.period": 0.0125}, "laboratory.motion_capture.period.*must be a multiple"),
        (
            {"laboratory.motion_capture.position_noise": 0.0},
            "must have noise, or laboratory.estimator.aiding.motion_capture.deviation must be given",
        ),
        (
            {"laboratory.estimator.aiding.motion_capture.deviation": [0.1, 0.1, 0.1]},
            "laboratory.estimator.aiding.motion_capture.deviation.*must be one number or 2 numbers",
        ),
        (
            {"laboratory.motion_capture.latency_frames": {"choice": [0, 1]}},
            "laboratory.estimator.aiding.motion_capture.*has a random latency; give the latency",
        ),
        (
            {"laboratory.sensors": [{**INERTIAL_SENSORS[0], "noise_density": 0.0}, INERTIAL_SENSORS[1]]},
            "sensors.0.noise_density.*must be positive, or laboratory.estimator.gyroscope_noise must be given",
        ),
    ],
)
def test_sensors_that_the_filter_cannot_use_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        with_filter(**changes)
