"""Tests of the complementary filter: its time constants, and the limits of its assumptions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad.estimation.complementary_filter import ComplementaryFilter, ComplementaryParameters, TimeConstants
from drake_quad.estimation.corrections import PositionAiding, VelocityAiding, YawAiding
from drake_quad.estimation.error_state_filter import Aiding
from drake_quad.estimation.estimate import Estimate
from drake_quad.geometry.axes import Vector
from drake_quad.geometry.quaternion import NO_ROTATION, Quaternion

H = 0.002  # s, sampling period of the inertial sensors
GRAVITY = 9.81  # m/s²
TIME_CONSTANTS = TimeConstants(tilt=0.5, bias=4.0, rotation=0.3, velocity=0.2, position=0.4)  # s
ZERO = Vector(0.0, 0.0, 0.0)
AT_REST = Estimate(ZERO, ZERO, NO_ROTATION, ZERO, ZERO)
# Readings of the inertial sensors at rest and level, in rad/s and m/s².
LEVEL_READINGS = {"gyroscope": [0.0, 0.0, 0.0], "accelerometer": [0.0, 0.0, GRAVITY]}


def run(start, aiding, parameters, readings, duration, time_constants=TIME_CONSTANTS):
    """Return system and context of a filter after constant readings for a given duration."""
    system = ComplementaryFilter(
        aiding=aiding, period=H, parameters=ComplementaryParameters(time_constants, parameters, start, gravity=GRAVITY)
    )
    context = system.CreateDefaultContext()
    for name, value in readings.items():
        system.GetInputPort(name).FixValue(context, value)
    context.SetTime(H)  # the filter has no update at time zero
    for _ in range(round(duration / H)):
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context).Clone())
    return system, context


def test_a_small_tilt_error_decays_with_its_time_constant():
    """The estimate of the gyroscope's bias changes too slowly to affect the result."""
    start = AT_REST._replace(attitude=Quaternion.of(0.02, -0.01, 0.3))
    system, context = run(start, (), (), LEVEL_READINGS, 0.5, TIME_CONSTANTS._replace(bias=1e6))
    roll, pitch, yaw = system.GetOutputPort("measurement").Eval(context)[3:6]
    np.testing.assert_allclose([roll, pitch], np.array([0.02, -0.01]) * np.exp(-0.5 / TIME_CONSTANTS.tilt), rtol=0.01)
    assert yaw == pytest.approx(0.3, abs=1e-3)


@pytest.mark.slow
def test_the_bias_of_the_gyroscope_is_estimated_except_about_the_vertical():
    system, context = run(AT_REST, (), (), {**LEVEL_READINGS, "gyroscope": [0.02, -0.03, 0.01]}, 60.0)
    bias = system.get_state(context, "estimate").gyroscope_bias
    np.testing.assert_allclose(bias, [0.02, -0.03, 0.0], atol=2e-4)


@pytest.mark.parametrize(
    ("kind", "parameters", "reading", "row", "time"),
    [
        ("velocity", VelocityAiding(1.0, 1.0, 1.0), [0.5, 0.0, 0.0], 6, TIME_CONSTANTS.velocity),
        ("yaw", YawAiding(1.0), [0.5], 5, TIME_CONSTANTS.rotation),
    ],
)
def test_an_error_of_a_measured_quantity_decays_with_its_time_constant(kind, parameters, reading, row, time):
    aiding = (Aiding("other", kind, 5),)
    system, context = run(AT_REST, aiding, (parameters,), {**LEVEL_READINGS, "other": reading}, 10 * 5 * H)
    measured = system.GetOutputPort("measurement").Eval(context)[row]
    assert measured == pytest.approx(0.5 * (1.0 - np.exp(-10 * 5 * H / time)), rel=1e-6)


@pytest.mark.parametrize("duration", [0.2, 0.8, 1.6])
def test_the_position_follows_a_step_as_a_critically_damped_filter(duration):
    """The step response is 1 - (1 - t / T) exp(-t / T) for frequent readings, which overshoots by e^-2."""
    aiding, readings = (Aiding("position", "position", 1),), {**LEVEL_READINGS, "position": [1.0, 0.0, 0.0]}
    system, context = run(AT_REST, aiding, (PositionAiding(1.0, 1.0, 1.0),), readings, duration)
    time = duration / TIME_CONSTANTS.position
    position = system.get_state(context, "estimate").position.x
    assert position == pytest.approx(1.0 - (1.0 - time) * np.exp(-time), abs=0.01)


def test_a_steady_acceleration_tilts_the_estimate():
    """The filter assumes that the specific force is vertical, which is wrong if the vehicle accelerates."""
    R = Rotation.from_euler("x", 0.1).as_matrix()
    force = R.T @ [0.0, -GRAVITY * np.tan(0.1), GRAVITY]
    start = AT_REST._replace(attitude=Quaternion.of(0.1, 0.0, 0.0))
    readings = {"gyroscope": [0.0, 0.0, 0.0], "accelerometer": force}
    system, context = run(start, (), (), readings, 0.5, TIME_CONSTANTS._replace(bias=1e6))
    roll = system.GetOutputPort("measurement").Eval(context)[3]
    assert roll == pytest.approx(0.1 * np.exp(-1.0), rel=0.02)


def test_a_filter_without_an_initial_estimate_starts_with_the_measured_tilt_and_no_yaw():
    force = GRAVITY * Rotation.from_euler("ZYX", [0.9, -0.2, 0.3]).as_matrix()[2]
    system, context = run(None, (), (), {"gyroscope": [0.0, 0.0, 0.0], "accelerometer": force}, H)
    attitude = system.GetOutputPort("measurement").Eval(context)[3:6]
    np.testing.assert_allclose(attitude, [0.3, -0.2, 0.0], atol=1e-9)


def test_parameters_of_another_sensor_are_refused():
    with pytest.raises(ValueError, match="parameters of type YawAiding"):
        run(AT_REST, (Aiding("position", "position"),), (YawAiding(1.0),), LEVEL_READINGS, 0.1)
