"""Tests of the position controller: PD, integral, feed-forward, and the correction of a network."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from drake_quad.control.disturbance.estimator import DisturbanceEstimator, EstimatorParameters
from drake_quad.control.disturbance.laws import IncrementalLaw
from drake_quad.control.disturbance.response import AxisCommand
from drake_quad.control.integral import IntegralCorrection, IntegralGains
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, Reference, State

K_P = np.array([1.0, 2.0, 3.0])  # 1/s²
K_D = np.array([0.5, 0.6, 0.7])  # 1/s
MEASUREMENT = State(*np.arange(12.0) / 10.0)  # distinct values of all components
REFERENCE = Reference(*np.arange(11.0)[::-1] / 3.0)  # distinct values of all components
POSITION_ERROR = np.subtract([REFERENCE.x, REFERENCE.y, REFERENCE.z], [MEASUREMENT.x, MEASUREMENT.y, MEASUREMENT.z])
VELOCITY = np.array([MEASUREMENT.v_x, MEASUREMENT.v_y, MEASUREMENT.v_z])


def signals(num_vehicles=1, **structure):
    gains = PdGains(PerAxis(*K_P), PerAxis(*K_D))
    pd = ProportionalDerivative(num_vehicles=num_vehicles, parameters=gains, **structure)
    diagram = build_position_controller(pd)
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("measurement").FixValue(context, np.repeat(MEASUREMENT, num_vehicles))
    diagram.GetInputPort("reference").FixValue(context, np.repeat(REFERENCE, num_vehicles))
    names = (diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports()))
    return {name: diagram.GetOutputPort(name).Eval(context).reshape(3, num_vehicles) for name in names}


def test_the_integral_and_an_external_correction_are_both_subtracted():
    gains = IntegralGains(PerAxis(0.3, 0.2, 1.5), 0.6)
    pd = ProportionalDerivative(feeds_forward=True, parameters=PdGains(PerAxis(*K_P), PerAxis(*K_D)))
    integral = IntegralCorrection(parameters=gains)
    diagram = build_position_controller(pd, integral=integral, takes_correction=True)
    context = diagram.CreateDefaultContext()
    for name, rows in (("measurement", MEASUREMENT), ("reference", REFERENCE), ("correction", (0.4, -0.2, 0.1))):
        diagram.GetInputPort(name).FixValue(context, rows)
    integral.set_state(integral.GetMyMutableContextFromRoot(context), "correction", Acceleration(-0.5, 0.3, 0.2))
    outputs = {name: diagram.GetOutputPort(name).Eval(context) for name in ("pd", "correction", "acceleration_command")}
    np.testing.assert_allclose(outputs["correction"], [-0.1, 0.1, 0.3], atol=1e-15)
    fed = [REFERENCE.a_x, REFERENCE.a_y, REFERENCE.a_z]
    np.testing.assert_allclose(outputs["acceleration_command"], outputs["pd"] + fed - outputs["correction"], atol=1e-14)


def test_the_pd_on_the_tracking_error_is_eq_8():
    result = signals()
    rate = [REFERENCE.v_x, REFERENCE.v_y, REFERENCE.v_z] - VELOCITY
    np.testing.assert_allclose(result["error"][:, 0], POSITION_ERROR)
    np.testing.assert_allclose(result["error_rate"][:, 0], rate)
    np.testing.assert_allclose(result["pd"][:, 0], K_P * POSITION_ERROR + K_D * rate)
    np.testing.assert_allclose(result["correction"], 0.0)
    np.testing.assert_allclose(result["acceleration_command"], result["pd"])


def test_the_derivative_of_the_measurement_is_minus_the_velocity():
    result = signals(derivative="measurement")
    np.testing.assert_allclose(result["error_rate"][:, 0], -VELOCITY)
    np.testing.assert_allclose(result["pd"][:, 0], K_P * POSITION_ERROR - K_D * VELOCITY)


def test_feed_forward_adds_the_acceleration_of_the_reference():
    result = signals(feeds_forward=True)
    acceleration = [REFERENCE.a_x, REFERENCE.a_y, REFERENCE.a_z]
    np.testing.assert_allclose(result["acceleration_command"][:, 0], result["pd"][:, 0] + acceleration)


def test_the_position_controller_agrees_for_fleets_and_single_vehicles():
    one, fleet = signals(feeds_forward=True), signals(num_vehicles=3, feeds_forward=True)
    for name, rows in fleet.items():
        np.testing.assert_array_equal(rows, np.repeat(one[name], 3, axis=1))


def test_the_estimator_models_the_command_plus_the_correction():
    """Otherwise, the estimator would also estimate the part of the disturbance that the correction compensates."""
    lags = (AxisCommand(0.2, 0.05), AxisCommand(0.3, 0.06), AxisCommand(0.4, 0.07))
    estimator = DisturbanceEstimator(
        parameters=EstimatorParameters((IncrementalLaw(5.0),) * 3, lags, 10.0, PerAxis(0.0, 0.0, 0.0))
    )
    pd = ProportionalDerivative(parameters=PdGains(PerAxis(*K_P), PerAxis(*K_D)), feeds_forward=True)
    diagram = build_position_controller(pd, disturbance=estimator, takes_correction=True)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("measurement").FixValue(context, MEASUREMENT)
    diagram.GetInputPort("reference").FixValue(context, REFERENCE)
    correction = np.array([0.7, -0.4, 0.2])
    diagram.GetInputPort("correction").FixValue(context, correction)

    def output(name):
        return diagram.GetOutputPort(name).Eval(context)

    forward = np.array([REFERENCE.a_x, REFERENCE.a_y, REFERENCE.a_z])
    disturbance, command = output("disturbance"), output("acceleration_command")
    assert np.abs(disturbance).min() > 0.01
    np.testing.assert_allclose(command, output("pd") + forward - correction - disturbance)
    simulator.AdvancePendingEvents()
    modelled_response = estimator.get_state(estimator.GetMyContextFromRoot(context), "modelled_response")
    for axis, (followed, lag) in enumerate(zip(modelled_response, lags, strict=True)):
        feedback = command[axis] + correction[axis] - forward[axis]
        assert followed.feedback == pytest.approx(feedback * (1.0 - math.exp(-0.02 / lag.feedback)), rel=1e-12)
        assert followed.feed_forward == pytest.approx(forward[axis] * (1.0 - math.exp(-0.02 / lag.feed_forward)))
