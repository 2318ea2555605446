"""Tests that the acceleration output of a vehicle is the time derivative of its motion."""

import numpy as np
import pytest
from all_systems import (
    ATTITUDE_RESPONSE_VEHICLE,
    VEHICLE,
    VEHICLE_WITH_EFFECTS,
    VEHICLE_WITH_PAYLOAD,
    VEHICLE_WITH_THROTTLE,
)
from pydrake.systems.analysis import Simulator

from drake_quad.geometry.kinematics import angular_acceleration, small_rotation
from drake_quad.signals import Attitude, State, VehicleAcceleration
from drake_quad.vehicle.attitude_response import AttitudeResponseQuadrotor
from drake_quad.vehicle.quadrotor import Quadrotor

VEHICLE_TIME_STEP = 1e-4  # s
MOTION_COMPONENTS = ["v_x", "v_y", "v_z", "p", "q", "r"]
INPUT_VALUES = {
    "rotor_speed_command": [222.0, 190.0, 236.0, 205.0],
    "throttle_command": [0.42, 0.35, 0.45, 0.38],
    "attitude_target": [0.0, 0.4, -0.5, 0.9, 0.0, 0.0, 0.0],
    "wind": [3.0, -2.0, 1.0],
}
VEHICLES = {
    "faulty": (Quadrotor, VEHICLE, {"faulty": True}),
    "small angles": (Quadrotor, VEHICLE, {"kinematics": "small_angle"}),
    "slung load and battery": (Quadrotor, VEHICLE_WITH_EFFECTS, {"effects": VEHICLE_WITH_EFFECTS.effects.names}),
    "throttles": (Quadrotor, VEHICLE_WITH_THROTTLE, {"effects": VEHICLE_WITH_THROTTLE.effects.names}),
    # The vehicle carries the payload from 0.9 s to 1.9 s.
    "payload": (Quadrotor, VEHICLE_WITH_PAYLOAD, {"effects": VEHICLE_WITH_PAYLOAD.effects.names}),
    "response": (AttitudeResponseQuadrotor, ATTITUDE_RESPONSE_VEHICLE, {}),
    "response with small angles": (AttitudeResponseQuadrotor, ATTITUDE_RESPONSE_VEHICLE, {"kinematics": "small_angle"}),
}


def fix_inputs(system, context):
    for i in range(system.num_input_ports()):
        port = system.get_input_port(i)
        if port.get_name() in INPUT_VALUES:
            port.FixValue(context, INPUT_VALUES[port.get_name()])
    return context


def motion_and_acceleration_of(system, context):
    state = State(*system.GetOutputPort("state").Eval(context))
    acceleration = VehicleAcceleration(*system.GetOutputPort("acceleration").Eval(context))
    return [getattr(state, name) for name in MOTION_COMPONENTS], list(acceleration)


@pytest.mark.parametrize(("kind", "parameters", "structure"), VEHICLES.values(), ids=VEHICLES)
def test_the_acceleration_of_a_discrete_vehicle_is_the_derivative_of_its_velocity(kind, parameters, structure):
    """The output agrees with central differences over steps of 0.1 ms, from 1 s on."""
    vehicle = kind(time_step=VEHICLE_TIME_STEP, parameters=parameters, **structure)
    simulator = Simulator(vehicle)
    context = fix_inputs(vehicle, simulator.get_mutable_context())
    context.SetTime(1.0)
    simulator.Initialize()
    motions, accelerations = [], []
    for step in range(10, 43):
        simulator.AdvanceTo(1.0 + (step + 0.5) * VEHICLE_TIME_STEP)
        motion, acceleration = motion_and_acceleration_of(vehicle, context)
        motions.append(motion)
        accelerations.append(acceleration)
    rates = (np.array(motions[2:]) - np.array(motions[:-2])) / (2.0 * VEHICLE_TIME_STEP)
    assert np.abs(rates).min(axis=0).max() > 0.1
    np.testing.assert_allclose(np.array(accelerations)[1:-1], rates, rtol=0.0, atol=2e-5 * np.abs(rates).max())


@pytest.mark.parametrize(("kind", "parameters", "structure"), VEHICLES.values(), ids=VEHICLES)
def test_the_acceleration_of_a_continuous_state_is_the_derivative_of_its_velocity(kind, parameters, structure):
    """The output agrees with one small step of Euler's method."""
    vehicle = kind(time_step=0.0, parameters=parameters, **structure)
    context = fix_inputs(vehicle, vehicle.CreateDefaultContext())
    context.SetTime(1.0)
    rng = np.random.default_rng(1)
    state = context.get_continuous_state_vector().CopyToVector()
    context.SetContinuousState(state * rng.uniform(0.9, 1.1, len(state)) + rng.uniform(-0.1, 0.1, len(state)))
    motion, acceleration = motion_and_acceleration_of(vehicle, context)
    derivative = vehicle.EvalTimeDerivatives(context).CopyToVector()
    context.SetContinuousState(context.get_continuous_state_vector().CopyToVector() + 1e-7 * derivative)
    next_motion, _ = motion_and_acceleration_of(vehicle, context)
    rates = (np.array(next_motion) - np.array(motion)) / 1e-7
    np.testing.assert_allclose(acceleration, rates, rtol=0.0, atol=1e-5 * np.abs(rates).max())


@pytest.mark.parametrize("time_step", [0.01, 0.0])
@pytest.mark.parametrize(
    ("kind", "parameters"), [(Quadrotor, VEHICLE), (AttitudeResponseQuadrotor, ATTITUDE_RESPONSE_VEHICLE)]
)
def test_a_vehicle_that_has_crashed_has_no_acceleration(kind, parameters, time_step):
    """The acceleration is zero although the state keeps the velocity and the body rates of the crash."""
    vehicle = kind(num_vehicles=2, time_step=time_step, parameters=parameters)
    context = vehicle.CreateDefaultContext()
    for i in range(vehicle.num_input_ports()):
        port = vehicle.get_input_port(i)
        port.FixValue(context, np.repeat(INPUT_VALUES.get(port.get_name(), [0.0]), 2))
    moving_states = [group.vector(vehicle, context).CopyToVector() + 0.2 for group in vehicle.states.values()]
    for group, parameters in zip(vehicle.states.values(), moving_states, strict=True):
        group.mutable_vector(context).SetFromVector(parameters)
    vehicle.GetInputPort("crashed").FixValue(context, [1.0, 0.0])
    crashed_acceleration, flying_acceleration = vehicle.GetOutputPort("acceleration").Eval(context).reshape(-1, 2).T
    assert not crashed_acceleration.any()
    assert np.abs(flying_acceleration).max() > 0.5


def test_angular_acceleration_is_the_derivative_of_eq_2():
    rng = np.random.default_rng(0)
    angles, rates, accelerations = rng.uniform(-1.2, 1.2, (3, 3))

    def body_rates(time):
        attitude = angles + rates * time + 0.5 * accelerations * time**2
        return np.array(small_rotation(Attitude(*(rates + accelerations * time)), Attitude(*attitude)))

    acceleration = angular_acceleration(Attitude(*accelerations), Attitude(*rates), Attitude(*angles))
    np.testing.assert_allclose(acceleration, (body_rates(1e-5) - body_rates(-1e-5)) / 2e-5, atol=1e-9)
