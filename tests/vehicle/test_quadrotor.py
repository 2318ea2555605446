"""Tests of the quadrotor as a system: time steps, fleets, scalar types, parameters and initial conditions."""

import math
from contextlib import nullcontext as does_not_raise

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff
from pydrake.symbolic import Evaluate, MakeVectorVariable
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator, Simulator_
from pydrake.systems.primitives import Linearize

from drake_quad.signals import RotorSpeed, State
from drake_quad.vehicle.dynamics import hover_rotor_speeds
from drake_quad.vehicle.parameters import CentreOfMass, Inertia, QuadrotorParameters
from drake_quad.vehicle.quadrotor import HoverPose, Quadrotor, QuadrotorConfig
from drake_quad.vehicle.rotors import Rotors

ROTOR_SPEED_COMMAND = np.array([200.0, 215.0, 205.0, 198.0])  # rad/s
ASYMMETRIC_VEHICLE = QuadrotorParameters(
    mass=0.7,
    inertia=Inertia(0.0071, 0.0079, 0.0131),
    rotors=Rotors.plus().with_thrust_factors(4.15e-5, 4.02e-5, 4.17e-5, 4.12e-5),
    linear_drag=0.2,
    quadratic_drag=0.05,
    centre_of_mass=CentreOfMass(-0.001, 0.002),
)


def quadrotor(parameters=ASYMMETRIC_VEHICLE, start=HoverPose(), **structure):
    return Quadrotor(parameters=QuadrotorConfig(parameters=parameters, start=start), **structure)


def final_state(vehicle, duration, command=ROTOR_SPEED_COMMAND, wind=(1.0, 0.5, -0.2), crashed=None, accuracy=1e-11):
    """Return the (16, N) states of body and rotors after a flight with constant inputs."""
    n = vehicle.num_vehicles
    context = vehicle.CreateDefaultContext()
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, np.broadcast_to(command, (n, 4)).T.ravel())
    vehicle.GetInputPort("wind").FixValue(context, np.repeat(wind, n))
    if crashed is not None:
        vehicle.GetInputPort("crashed").FixValue(context, crashed)
    simulator = Simulator(vehicle, context)
    ResetIntegratorFromFlags(simulator, "runge_kutta5", 0.1).set_target_accuracy(accuracy)
    simulator.AdvanceTo(duration)
    simulator.AdvancePendingEvents()
    outputs = [vehicle.GetOutputPort(name).Eval(context) for name in ("state", "rotor_speed")]
    return np.concatenate(outputs).reshape(16, n)


def test_discrete_steps_converge_to_the_continuous_vehicle_with_fourth_order():
    exact = final_state(quadrotor(time_step=0.0), 0.32)
    errors = [np.abs(final_state(quadrotor(time_step=step), 0.32) - exact).max() for step in (0.02, 0.01)]
    assert errors[1] < 1e-6
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.25)


def test_rotors_of_a_discrete_vehicle_follow_the_exact_solution_of_their_lag():
    final = final_state(Quadrotor(), 0.1)[12:, 0]
    hover = np.array(hover_rotor_speeds(QuadrotorParameters()))
    np.testing.assert_allclose(
        final, ROTOR_SPEED_COMMAND + (hover - ROTOR_SPEED_COMMAND) * np.exp(-0.1 / 0.05), rtol=1e-13
    )


@pytest.mark.parametrize("time_step", [0.0, 0.01])
@pytest.mark.parametrize("shift", range(4))
def test_commands_beyond_the_limits_are_clipped(time_step, shift, asymmetric_vehicle):
    """Each rotor in turn has a command that is too large, too small, NaN and feasible."""
    command, limited = (np.roll(x, shift) for x in ([1e4, -1e4, np.nan, 250.0], [290.0, 70.0, 70.0, 250.0]))
    vehicle = quadrotor(asymmetric_vehicle, time_step=time_step)
    final, hover = final_state(vehicle, 0.08, command=command, accuracy=1e-7), hover_rotor_speeds(asymmetric_vehicle)
    np.testing.assert_allclose(final[12:, 0], limited + (hover - limited) * np.exp(-2.0), rtol=1e-6)


def test_each_vehicle_of_a_fleet_has_the_flight_of_a_single_vehicle():
    masses = np.array([0.6, 0.68, 0.75])
    commands = ROTOR_SPEED_COMMAND + np.array([[0.0], [3.0], [-4.0]])
    fleet = final_state(quadrotor(ASYMMETRIC_VEHICLE._replace(mass=masses), num_vehicles=3), 0.6, command=commands)
    for i, mass in enumerate(masses):
        single_state = final_state(quadrotor(ASYMMETRIC_VEHICLE._replace(mass=float(mass))), 0.6, command=commands[i])
        np.testing.assert_allclose(fleet[:, i], single_state[:, 0], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("time_step", [0.0, 0.01])
def test_a_crashed_vehicle_stops_and_others_are_not_affected(time_step):
    vehicle = quadrotor(QuadrotorParameters(), HoverPose(1.0, 2.0, 3.0), num_vehicles=2, time_step=time_step)
    flying_states = final_state(vehicle, 0.2, accuracy=1e-8)
    states_with_crash = final_state(vehicle, 0.2, crashed=[1.0, 0.0], accuracy=1e-8)
    start = np.array([1.0, 2.0, 3.0] + [0.0] * 9 + [*hover_rotor_speeds(QuadrotorParameters())])
    np.testing.assert_allclose(states_with_crash[:, 0], start, rtol=1e-15)
    np.testing.assert_allclose(
        states_with_crash[:, 1], flying_states[:, 1], rtol=0.0, atol=1e-6 if time_step == 0.0 else 1e-14
    )


def test_autodiff_derivatives_of_a_step_agree_with_finite_differences():
    def after_a_step(state, vehicle, simulator_class):
        context = vehicle.CreateDefaultContext()
        vehicle.GetInputPort("rotor_speed_command").FixValue(context, ROTOR_SPEED_COMMAND)
        vehicle.GetInputPort("wind").FixValue(context, [1.0, 0.0, 0.0])
        context.SetDiscreteState(0, state[:12])
        context.SetDiscreteState(1, state[12:])
        simulator = simulator_class(vehicle, context)
        simulator.AdvanceTo(0.01)
        simulator.AdvancePendingEvents()
        return np.concatenate([vehicle.GetOutputPort(name).Eval(context) for name in ("state", "rotor_speed")])

    vehicle = quadrotor()
    state = np.concatenate([np.random.default_rng(1).normal(size=12) * 0.3, ROTOR_SPEED_COMMAND + 5.0])
    differentiable = vehicle.ToAutoDiffXd()
    start = InitializeAutoDiff(state)[:, 0]
    gradient = ExtractGradient(after_a_step(start, differentiable, Simulator_[AutoDiffXd]))
    step = 1e-6
    columns = [
        (after_a_step(state + step * e, vehicle, Simulator) - after_a_step(state - step * e, vehicle, Simulator))
        / (2.0 * step)
        for e in np.eye(16)
    ]
    np.testing.assert_allclose(gradient, np.array(columns).T, atol=2e-8)


@pytest.mark.parametrize("num_vehicles", [1, 2])
def test_the_symbolic_derivative_has_the_values_of_the_numeric_one(num_vehicles):
    vehicle = quadrotor(num_vehicles=num_vehicles, time_step=0.0)
    symbolic = vehicle.ToSymbolic()
    context, symbolic_context = vehicle.CreateDefaultContext(), symbolic.CreateDefaultContext()
    rng = np.random.default_rng(2)
    state = rng.normal(size=16 * num_vehicles) * 0.3 + np.repeat([0.0] * 12 + [200.0] * 4, num_vehicles)
    command = rng.uniform(0.0, 400.0, 4 * num_vehicles)
    variables = MakeVectorVariable(16 * num_vehicles, "x")
    symbolic_context.SetContinuousState(variables)
    context.SetContinuousState(state)
    for system, system_context in ((vehicle, context), (symbolic, symbolic_context)):
        system.GetInputPort("rotor_speed_command").FixValue(system_context, command)
    expected = vehicle.EvalTimeDerivatives(context).CopyToVector()
    expressions = symbolic.EvalTimeDerivatives(symbolic_context).CopyToVector()
    values = Evaluate(expressions, dict(zip(variables, state, strict=True)))[:, 0]
    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)


def test_parameters_of_a_vehicle_are_stored_in_the_context():
    vehicle = quadrotor(QuadrotorParameters(mass=np.array([0.68, 0.7])), num_vehicles=2)
    context = vehicle.CreateDefaultContext()
    heavier = QuadrotorParameters(mass=np.array([0.68, 0.9]))
    vehicle.set_parameter(context, "parameters", heavier)
    old_parameters = vehicle.get_parameter(context, "parameters")
    np.testing.assert_array_equal(old_parameters.mass, [0.68, 0.9])
    # Parameters that are equal for all vehicles are written once and read for each vehicle.
    np.testing.assert_array_equal(old_parameters.rotors.rotor_1.x, [0.17, 0.17])
    # Parameters that were read can be changed and written back.
    vehicle.set_parameter(context, "parameters", old_parameters._replace(quadratic_drag=0.1))
    new_parameters = vehicle.get_parameter(context, "parameters")
    np.testing.assert_array_equal(old_parameters.quadratic_drag, 0.0)
    np.testing.assert_array_equal(new_parameters.quadratic_drag, 0.1)
    for new, old in zip(
        new_parameters._replace(quadratic_drag=old_parameters.quadratic_drag), old_parameters, strict=True
    ):
        np.testing.assert_array_equal(new, old)
    vehicle.set_hover(context, HoverPose(0.0, 0.0, 1.0, 0.5))
    speeds = RotorSpeed(*vehicle.GetOutputPort("rotor_speed").Eval(context).reshape(4, 2))
    np.testing.assert_allclose(speeds.rotor_1, [200.9, np.sqrt(0.9 * 9.81 / (4 * 4.13e-5))], rtol=1e-3)
    np.testing.assert_allclose(State(*vehicle.GetOutputPort("state").Eval(context).reshape(12, 2)).yaw, 0.5)


def test_each_vehicle_of_a_fleet_has_its_own_parameters():
    """Parameters of each vehicle can be changed later, even if all vehicles are equal at first."""
    fleet = quadrotor(QuadrotorParameters(), num_vehicles=2)
    context = fleet.CreateDefaultContext()
    rows = fleet.parameters["parameters"].layout.flatten(QuadrotorParameters())
    assert context.get_numeric_parameter(0).size() == 2 * len(rows)
    fleet.set_parameter(context, "parameters", QuadrotorParameters(inertia=Inertia(i_yy=np.array([0.006, 0.008]))))
    np.testing.assert_array_equal(fleet.get_parameter(context, "parameters").inertia.i_yy, [0.006, 0.008])
    np.testing.assert_array_equal(fleet.get_parameter(context, "parameters").inertia.i_xx, 0.007)


def test_parameters_for_too_many_vehicles_are_rejected():
    parameters = QuadrotorParameters(mass=np.array([0.68, 0.7, 0.8]))
    with pytest.raises(ValueError, match=r"\(3,\)"):
        quadrotor(parameters, num_vehicles=2)
    fleet = quadrotor(QuadrotorParameters(), num_vehicles=2)
    context = fleet.CreateDefaultContext()
    with pytest.raises(ValueError, match=r"\(3,\)"):
        fleet.set_parameter(context, "parameters", parameters)
    np.testing.assert_array_equal(fleet.get_parameter(context, "parameters").mass, 0.68)


@pytest.mark.parametrize("time_step", [0.0, 0.01])
def test_set_hover_uses_the_parameters_of_the_context(time_step):
    vehicle = quadrotor(num_vehicles=2, time_step=time_step)
    context = vehicle.CreateDefaultContext()
    masses = np.array([0.65, 0.8])
    vehicle.set_parameter(context, "parameters", ASYMMETRIC_VEHICLE._replace(mass=masses))
    vehicle.set_hover(context, HoverPose(1.0, np.array([2.0, -2.0]), 3.0, 0.5))
    state = vehicle.GetOutputPort("state").Eval(context).reshape(12, 2)
    np.testing.assert_array_equal(state[:, 0], [1.0, 2.0, 3.0, 0.0, 0.0, 0.5] + [0.0] * 6)
    np.testing.assert_array_equal(state[:, 1], [1.0, -2.0, 3.0, 0.0, 0.0, 0.5] + [0.0] * 6)
    speeds = vehicle.GetOutputPort("rotor_speed").Eval(context).reshape(4, 2)
    np.testing.assert_allclose(speeds, hover_rotor_speeds(ASYMMETRIC_VEHICLE._replace(mass=masses)), rtol=1e-14)


def test_the_linear_model_in_hover_agrees_with_the_textbook_model():
    from pydrake.systems.primitives import Linearize

    vehicle = Quadrotor(time_step=0.0)
    context = vehicle.CreateDefaultContext()
    hover = vehicle.GetOutputPort("rotor_speed").Eval(context)[0]
    command = vehicle.GetInputPort("rotor_speed_command")
    command.FixValue(context, [hover] * 4)
    system = Linearize(vehicle, context, command.get_index(), vehicle.GetOutputPort("state").get_index())
    expected = np.zeros((16, 16))
    expected[0:3, 6:9] = expected[3:6, 9:12] = np.eye(3)
    expected[6, 4], expected[7, 3] = 9.81, -9.81
    b, d, length = 4.13e-5, 8.5e-7, 0.17
    slope = 2.0 * b * hover
    expected[8, 12:] = slope / 0.68
    expected[9, 12:] = np.array([0.0, -1.0, 0.0, 1.0]) * length * slope / 0.007
    expected[10, 12:] = np.array([-1.0, 0.0, 1.0, 0.0]) * length * slope / 0.007
    expected[11, 12:] = np.array([1.0, -1.0, 1.0, -1.0]) * 2.0 * d * hover / 0.012
    expected[12:, 12:] = -np.eye(4) / 0.05
    np.testing.assert_allclose(system.A(), expected, atol=1e-12)


def test_a_vehicle_hovers_level_at_the_origin_unless_another_position_is_given():
    vehicle = quadrotor()
    np.testing.assert_array_equal(vehicle.GetOutputPort("state").Eval(vehicle.CreateDefaultContext()), 0.0)


def test_a_slung_load_cannot_be_combined_with_a_payload():
    with pytest.raises(ValueError, match="the effects payload and slung_load cannot be combined"):
        quadrotor(effects=("payload", "slung_load"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass": -1.0}, "parameters.parameters.mass is -1 kg, but must be larger than 0"),
        ({"mass": math.nan}, "parameters.parameters.mass is nan kg, but must be larger than 0"),
        ({"inertia": Inertia(0.007, -0.1, 0.012)}, "parameters.parameters.inertia.i_yy is -0.1 kg m², but must be at"),
        (
            {"linear_drag": np.array([0.1, -0.2])},
            "parameters.parameters.linear_drag is -0.2 N s/m, but must be at least",
        ),
        (
            {"rotors": Rotors.plus(thrust_factor=-4e-5)},
            "parameters.parameters.rotors.rotor_1.thrust_factor is -4e-05 N s², but must be larger than 0",
        ),
    ],
)
def test_impossible_parameters_are_rejected(change, words):
    with pytest.raises(ValueError, match=words):
        Quadrotor(num_vehicles=2, parameters=QuadrotorConfig(QuadrotorParameters(**change)))
    Quadrotor(parameters=QuadrotorConfig(QuadrotorParameters(linear_drag=0.0, rotor_inertia=0.0, min_rotor_speed=0.0)))


def test_linearize_accepts_only_a_vehicle_without_a_time_step():
    """Drake raises SystemExit for a vehicle with a time step, as `docs/how_to/plain_drake.md` says."""
    hover = [float(speed) for speed in hover_rotor_speeds(ASYMMETRIC_VEHICLE)]
    for time_step, expected in ((0.0, does_not_raise()), (0.01, pytest.raises(SystemExit))):
        vehicle = quadrotor(time_step=time_step)
        context, command = vehicle.CreateDefaultContext(), vehicle.GetInputPort("rotor_speed_command")
        command.FixValue(context, hover)
        with expected:
            model = Linearize(vehicle, context, command.get_index(), vehicle.GetOutputPort("state").get_index())
            assert model.A().shape == (16, 16)
