"""Tests that a vehicle with a second-order attitude response agrees with closed forms and a `Quadrotor`."""

import numpy as np
import pytest
import scipy
from pydrake.systems.analysis import Simulator

from drake_quad.signals import AttitudeTarget, RotorSpeed
from drake_quad.vehicle.aerodynamics import (
    BodyDrag,
    CentreOfPressure,
    GroundEffect,
    LinearDrag,
    QuadraticDrag,
    RotorAerodynamics,
)
from drake_quad.vehicle.attitude_response import (
    ATTITUDE_RESPONSE_EFFECTS,
    AttitudeResponse,
    AttitudeResponseConfig,
    AttitudeResponseQuadrotor,
    DampingRatios,
    NaturalFrequencies,
)
from drake_quad.vehicle.battery import Battery
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.motors import SpinDown, ThrustCurve
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import HoverPose, Quadrotor, QuadrotorConfig
from drake_quad.vehicle.rotors import Rotors

NATURAL_FREQUENCIES = np.array([6.8, 6.1, 3.0])  # rad/s
DAMPING_RATIOS = np.array([0.45, 1.0, 1.4])  # of roll, pitch and yaw
RESPONSE = AttitudeResponse(NaturalFrequencies(*NATURAL_FREQUENCIES), DampingRatios(*DAMPING_RATIOS))
TARGET = AttitudeTarget(0.0, 0.3, -0.2, 0.5, 9.0, 9.0, 9.0)


def attitude_response_vehicle(parameters=QuadrotorParameters(), start=HoverPose(), faults=RotorFaults(), **structure):
    return AttitudeResponseQuadrotor(
        parameters=AttitudeResponseConfig(QuadrotorConfig(parameters, faults, start), RESPONSE), **structure
    )


def context_after(vehicle, end, target=TARGET, speed=200.0, **inputs):
    """Return the context of a vehicle after some time with constant inputs."""
    simulator = Simulator(vehicle)
    context = simulator.get_mutable_context()
    if vehicle.HasInputPort("attitude_target"):
        inputs["attitude_target"] = list(target)
    for name, values in {"rotor_speed_command": [speed] * 4, **inputs}.items():
        vehicle.GetInputPort(name).FixValue(context, values)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.AdvanceTo(end)
    simulator.AdvancePendingEvents()
    return context


def lag_response(omega, zeta, target, start, end):
    """Return angle and rate of a second-order lag with a constant command, by a matrix exponential."""
    A = np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]])
    return target + (scipy.linalg.expm(A * end) @ [start - target, 0.0])[0], (
        scipy.linalg.expm(A * end) @ [start - target, 0.0]
    )[1]


@pytest.mark.slow
@pytest.mark.parametrize("time_step", [0.01, 0.0])
def test_each_angle_follows_its_command_with_its_own_lag(time_step):
    """The yaw turns from 3 rad to -3 rad in the shorter direction. Thrust and rates of the target have no effect."""
    vehicle = attitude_response_vehicle(start=HoverPose(yaw=3.0), time_step=time_step)
    for end in (0.1, 0.5):
        context = context_after(vehicle, end, TARGET._replace(yaw=-3.0))
        state = vehicle.GetOutputPort("state").Eval(context)
        targets = [0.3, -0.2, 2.0 * np.pi - 3.0]
        angles, rates = zip(
            *(
                lag_response(*config, end)
                for config in zip(NATURAL_FREQUENCIES, DAMPING_RATIOS, targets, [0.0, 0.0, 3.0], strict=True)
            ),
            strict=True,
        )
        np.testing.assert_allclose(state[3:6], angles, atol=2e-6)
        # Body rates follow from the rates of the angles by eq (2).
        (s_r, s_p, _), (c_r, c_p, _) = np.sin(angles), np.cos(angles)
        to_body = np.array([[1.0, 0.0, -s_p], [0.0, c_r, s_r * c_p], [0.0, -s_r, c_r * c_p]])
        np.testing.assert_allclose(state[9:12], to_body @ rates, atol=2e-5)


def test_body_rates_equal_the_angle_rates_under_small_angle_kinematics():
    vehicle = attitude_response_vehicle(kinematics="small_angle")
    state = vehicle.GetOutputPort("state").Eval(context_after(vehicle, 0.2))
    config = zip(NATURAL_FREQUENCIES, DAMPING_RATIOS, [0.3, -0.2, 0.5], [0.0] * 3, strict=True)
    np.testing.assert_allclose(state[9:12], [lag_response(*each, 0.2)[1] for each in config], atol=2e-5)


def test_the_translation_of_a_vehicle_with_an_attitude_response_agrees_with_a_quadrotor(asymmetric_vehicle):
    """Both vehicles are level, with equal thrusts of all rotors and in wind, so no torque acts on them."""
    equal_rotors = asymmetric_vehicle._replace(
        rotors=Rotors.plus(), centre_of_mass=QuadrotorParameters().centre_of_mass
    )
    level = AttitudeTarget(*[0.0] * 7)
    outputs = []
    for vehicle in (attitude_response_vehicle(equal_rotors), Quadrotor(parameters=QuadrotorConfig(equal_rotors))):
        context = context_after(vehicle, 1.0, level, 220.0, wind=[3.0, -2.0, 1.0])
        outputs.append([vehicle.GetOutputPort(name).Eval(context).copy() for name in ("state", "rotor_speed")])
    for actual, expected in zip(*outputs, strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-13, atol=1e-15)
    assert np.abs(outputs[0][0][0:3]).min() > 0.05


@pytest.mark.parametrize("time_step", [0.01, 0.0])
def test_effects_accelerate_a_vehicle_with_an_attitude_response_as_they_accelerate_a_quadrotor(time_step):
    """Both vehicles are level near the ground. Drag acts at the centre of mass, so no torque acts on them."""
    effects = Effects(
        body_drag=BodyDrag(LinearDrag(0.2, 0.1, 0.3), QuadraticDrag(0.02, 0.03, 0.01), CentreOfPressure(0.0, 0.0, 0.0)),
        rotor_aerodynamics=RotorAerodynamics(0.02, -0.1, 1e-5, 2e-5),
        ground_effect=GroundEffect(0.1, 0.0),
        spin_down=SpinDown(0.09),
        thrust_curve=ThrustCurve(0.1, 1.0, 2.8),
        loads=(RotorAerodynamics(0.01, 0.05, 2e-5, 1e-5),),
    )
    assert effects.names == ATTITUDE_RESPONSE_EFFECTS
    config = QuadrotorConfig(start=HoverPose(0.3, 0.2, 0.25), effects=effects)
    structure = {"time_step": time_step, "effects": effects.names}
    vehicles = (
        AttitudeResponseQuadrotor(parameters=AttitudeResponseConfig(config, RESPONSE), **structure),
        Quadrotor(parameters=config, **structure),
    )
    outputs = []
    for vehicle in vehicles:
        simulator = Simulator(vehicle)
        simulator.get_mutable_integrator().set_target_accuracy(1e-7)
        context = simulator.get_mutable_context()
        inputs = {"throttle_command": [0.51] * 4, "wind": [3.0, -2.0, 0.5], "attitude_target": [0.0] * 7}
        for name, values in inputs.items():
            if vehicle.HasInputPort(name):
                vehicle.GetInputPort(name).FixValue(context, values)
        simulator.AdvanceTo(0.3)
        simulator.AdvancePendingEvents()
        outputs.append([vehicle.GetOutputPort(name).Eval(context).copy() for name in ("state", "rotor_speed")])
    for actual, expected in zip(*outputs, strict=True):
        np.testing.assert_allclose(
            actual, expected, rtol=1e-9 if time_step else 1e-6, atol=1e-12 if time_step else 1e-6
        )
    assert np.abs(outputs[0][0][0:2] - [0.3, 0.2]).min() > 0.01


def test_an_unsupported_effect_is_rejected():
    effects = Effects(battery=Battery(12.6, 10.2, 1.0, 0.04, 0.6))
    config = AttitudeResponseConfig(QuadrotorConfig(effects=effects), RESPONSE)
    with pytest.raises(ValueError, match="does not support these effects: battery"):
        AttitudeResponseQuadrotor(parameters=config, effects=("battery",))


def test_only_the_sum_of_the_rotor_thrusts_acts_on_the_vehicle(asymmetric_vehicle):
    """Different rotors and a displaced centre of mass do not rotate the vehicle."""
    vehicle = attitude_response_vehicle(asymmetric_vehicle)
    context = context_after(vehicle, 0.5, AttitudeTarget(*[0.0] * 7))
    state = vehicle.GetOutputPort("state").Eval(context)
    np.testing.assert_array_equal(state[[3, 4, 5, 9, 10, 11]], 0.0)
    speeds = RotorSpeed(*vehicle.GetOutputPort("rotor_speed").Eval(context))
    initial = RotorSpeed(*vehicle.GetOutputPort("rotor_speed").Eval(vehicle.CreateDefaultContext()))
    expected = [200.0 + (w - 200.0) * np.exp(-0.5 / 0.04) for w in initial]
    np.testing.assert_allclose(speeds, expected, rtol=1e-12)


def test_a_crashed_vehicle_with_an_attitude_response_stops():
    for time_step in (0.01, 0.0):
        vehicle = attitude_response_vehicle(start=HoverPose(1.0, 2.0, 3.0, 0.4), time_step=time_step)
        context = context_after(vehicle, 0.3, crashed=[1.0])
        initial_context = vehicle.CreateDefaultContext()
        for name in ("state", "rotor_speed"):
            port = vehicle.GetOutputPort(name)
            np.testing.assert_array_equal(port.Eval(context), port.Eval(initial_context))


def test_battery_sag_reduces_the_rotor_speeds():
    """The rotors turn at 90 % of the commanded speed after one second."""
    vehicle = attitude_response_vehicle(faulty=True, faults=RotorFaults(battery_sag=0.1))
    context = context_after(vehicle, 1.0, AttitudeTarget(*[0.0] * 7))
    np.testing.assert_allclose(vehicle.GetOutputPort("rotor_speed").Eval(context), 200.0 * 0.9, rtol=0.02)
    assert "faults" not in attitude_response_vehicle().parameters
