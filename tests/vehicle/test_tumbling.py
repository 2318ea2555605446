"""Tests that vehicles that pitch through 90° agree with integrations without a singularity at this pitch."""

import itertools
import math

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator, Simulator_
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from scipy.spatial.transform import Rotation
from tumbling import Tumbles, degrees_apart, integrate_tumbles, random_tumbles, rotations

from drake_quad.compilation.compile_diagram import compile_diagram, compiled_part
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import ROW, layout_of
from drake_quad.geometry.axes import BodyAxes, Vector, times
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.signals import Attitude, AttitudeTarget
from drake_quad.vehicle.attitude_kinematics import IntegratedQuaternion
from drake_quad.vehicle.attitude_response import (
    AttitudeResponse,
    AttitudeResponseConfig,
    AttitudeResponseQuadrotor,
    DampingRatios,
    NaturalFrequencies,
)
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig
from drake_quad.vehicle.slung_load import SlungLoad, rod_from_swing, swing_from_rod

TIME_STEPS = (0.01, 0.005, 0.0025, 0.00125)  # s


def final_states_and_swings(parameters, tumbles, time_step, duration, load=None, swings=None):
    """Return the (N, 12) states and (N, 4) swings of a fleet at the end of its tumbles."""
    effects = Effects(slung_load=load)
    vehicle = Quadrotor(
        num_vehicles=tumbles.count,
        time_step=time_step,
        effects=effects.names,
        parameters=QuadrotorConfig(parameters, effects=effects),
    )
    context = vehicle.CreateDefaultContext()
    context.SetDiscreteState(0, tumbles.states.T.ravel())
    context.SetDiscreteState(1, tumbles.speeds.T.ravel())
    if swings is not None:
        context.SetDiscreteState(2, swings.T.ravel())
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, tumbles.commands.T.ravel())
    vehicle.GetInputPort("wind").FixValue(context, tumbles.winds.T.ravel())
    simulator = Simulator(vehicle, context)
    simulator.AdvanceTo(duration)
    simulator.AdvancePendingEvents()
    state = vehicle.GetOutputPort("state").Eval(context).reshape(12, -1).T
    swing = None if load is None else vehicle.GetOutputPort("swing").Eval(context).reshape(4, -1).T
    return state, swing


@pytest.mark.slow
def test_random_tumbles_are_integrated_with_fourth_order(asymmetric_vehicle):
    """Vehicles pass pitches of ±90° at up to 10 rad/s. Errors are below 0.002° with the default time step."""
    tumbles = random_tumbles(40, seed=0)
    position, rotation, velocity, rates, *_ = integrate_tumbles(asymmetric_vehicle, tumbles, 2.0)
    errors = []
    for step in TIME_STEPS:
        states, _ = final_states_and_swings(asymmetric_vehicle, tumbles, step, 2.0)
        errors.append(degrees_apart(states[:, 3:6], rotation).max())
        assert np.abs(states[:, 4]).max() <= 0.5 * np.pi
        assert np.abs(states[:, 3]).max() <= np.pi
    assert errors[0] < 2e-3
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 16.0, rtol=0.15)
    np.testing.assert_allclose(states[:, :3], position, atol=1e-8)
    np.testing.assert_allclose(states[:, 6:9], velocity, atol=1e-8)
    np.testing.assert_allclose(states[:, 9:12], rates, atol=1e-7)


FLIP_PARAMETERS = QuadrotorParameters(rotor_inertia=0.0)


def flip_at(yaw_rate):
    """Return a single hovering vehicle that pitches at 6 rad/s and turns at a yaw rate, rad/s."""
    states = np.zeros((1, 12))
    states[0, 10:] = 6.0, yaw_rate
    hover = np.full((1, 4), 200.0)
    return Tumbles(states, speeds=hover, commands=hover, winds=np.zeros((1, 3)))


@pytest.mark.parametrize("yaw_rate", [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 0.01, 0.02, 0.05, 0.1, 0.3])
def test_a_flip_is_correct_however_close_it_passes_to_a_pitch_of_90_degrees(yaw_rate):
    """The vehicle pitches at 6 rad/s for 0.6 s. Roll and yaw jump by 180° near a pitch of 90°."""
    flip = flip_at(yaw_rate)
    final_state, _ = final_states_and_swings(FLIP_PARAMETERS, flip, 0.01, 0.6)
    _, rotation, *_ = integrate_tumbles(FLIP_PARAMETERS, flip, 0.6)
    assert degrees_apart(final_state[:, 3:6], rotation) < 1e-5
    assert np.cos(final_state[0, 3]) < -0.9, "the vehicle should turn over"


@pytest.mark.slow
def test_energy_and_angular_momentum_are_constant_in_tumbles_without_torque(asymmetric_vehicle):
    """The rotors stand still. The errors of both quantities are of fourth order in the time step."""
    parameters = asymmetric_vehicle._replace(min_rotor_speed=0.0, linear_drag=0.0, quadratic_drag=0.0)
    tumbles = random_tumbles(20, seed=1, rates=(5.0, 10.0))
    tumbles = tumbles._replace(speeds=np.zeros((20, 4)), commands=np.zeros((20, 4)))
    inertia = np.array(parameters.inertia)

    def energy_and_momentum(states):
        momentum = rotations(states[:, 3:6]).apply(inertia * states[:, 9:12])
        return 0.5 * (states[:, 9:12] * inertia * states[:, 9:12]).sum(axis=1), momentum

    energy, momentum = energy_and_momentum(tumbles.states)
    errors = []
    for step in TIME_STEPS[:3]:
        energy_after, momentum_after = energy_and_momentum(final_states_and_swings(parameters, tumbles, step, 2.0)[0])
        momentum_error = np.linalg.norm(momentum_after - momentum, axis=1) / np.linalg.norm(momentum, axis=1)
        errors.append(momentum_error.max())
        assert np.abs(energy_after / energy - 1.0).max() < 1e-6
    assert errors[0] < 1e-5
    assert errors[0] / errors[1] > 12.0
    assert errors[1] / errors[2] > 12.0


def test_roll_pitch_and_yaw_represent_any_rotation():
    """The rotation agrees to rounding at any distance from a pitch of ±90° and at ±90°."""
    rng = np.random.default_rng(2)
    for distance in [0.0, *10.0 ** np.arange(-17.0, 0.0)]:
        for sign in (-1.0, 1.0):
            roll, yaw = rng.uniform(-math.pi, math.pi, 2)
            matrix = rotations([roll, sign * (0.5 * math.pi - distance), yaw]).as_matrix()
            angles = BodyAxes(*(Vector(*column) for column in matrix.T.tolist())).angles()
            np.testing.assert_allclose(rotations(angles).as_matrix(), matrix, rtol=0.0, atol=2e-15)
    straight_up = BodyAxes(Vector(0.0, 0.0, 1.0), Vector(-1.0, 0.0, 0.0), Vector(0.0, -1.0, 0.0))
    assert straight_up.angles() == (0.5 * math.pi, -0.5 * math.pi, 0.0)


@pytest.mark.parametrize("max_angle", [1e-9, 0.01, 0.12, 0.13, 0.5, 3.0])
def test_the_angles_at_the_end_of_a_step_represent_the_rotated_attitude(max_angle):
    """The test covers floats, arrays and compiled code, arbitrary attitudes, and rotations of different sizes."""

    def attitude_after(roll, pitch, yaw, w, x, y, z):
        return IntegratedQuaternion.of(Attitude(roll, pitch, yaw)).attitude(Quaternion(w, x, y, z))

    rng = np.random.default_rng(3)
    initial_angles = rng.uniform([-math.pi, -0.5 * math.pi, -7.0], [math.pi, 0.5 * math.pi, 7.0], (500, 3))
    initial_angles[:100, :2] *= 0.1
    initial_angles[100:110, 1] = 0.5 * math.pi
    initial_angles[110:120, 0] = math.pi
    steps = Rotation.from_rotvec(rng.uniform(-max_angle, max_angle, (500, 3)) / math.sqrt(3.0))
    final_rotation = rotations(initial_angles) * steps
    rows = [*initial_angles.T, *np.roll(steps.as_quat(), 1, axis=1).T]
    compiled = np.empty((3, len(initial_angles)))
    kernel(attitude_after, (ROW,) * 7, (layout_of(Attitude),), single_vehicle=False)(
        len(initial_angles), 0.0, compiled, *map(np.array, rows)
    )
    angles_of_floats = np.array([attitude_after(*vehicle) for vehicle in np.transpose(rows).tolist()])
    for angles in (angles_of_floats, np.transpose(attitude_after(*rows)), compiled.T):
        np.testing.assert_allclose(rotations(angles).as_matrix(), final_rotation.as_matrix(), rtol=0.0, atol=3e-15)
        assert np.abs(angles[:, 0]).max() <= math.pi
        assert np.abs(angles[:, 1]).max() <= 0.5 * math.pi
        assert np.abs(angles[:, 2] - initial_angles[:, 2]).max() <= math.pi
        np.testing.assert_allclose(np.cos(angles), np.cos(angles_of_floats), rtol=0.0, atol=1e-7)


def test_yaw_counts_whole_turns_and_does_not_drift():
    """One vehicle makes eight turns at 4 rad/s. The other is pitched and does not turn, so its yaw is constant."""
    parameters = QuadrotorParameters(rotor_inertia=0.0, min_rotor_speed=0.0)
    tumbles = random_tumbles(2, seed=0)
    zero_speeds = np.zeros((2, 4))
    states = np.zeros((2, 12))
    states[0, 11] = 4.0
    states[1, 4:6] = 0.4, 0.7
    tumbles_without_rotors = tumbles._replace(
        states=states, speeds=zero_speeds, commands=zero_speeds, winds=np.zeros((2, 3))
    )
    final_states, _ = final_states_and_swings(parameters, tumbles_without_rotors, 0.01, 4.0 * math.pi)
    assert final_states[0, 5] == pytest.approx(16.0 * math.pi, abs=0.05)
    assert (final_states[1, 3], final_states[1, 5]) == (0.0, 0.7)
    assert final_states[1, 4] == pytest.approx(0.4, abs=1e-13)


def test_the_linear_model_of_a_step_in_hover_agrees_with_the_runge_kutta_method(asymmetric_vehicle):
    """The matrix is I + hA + (hA)²/2 + (hA)³/6 + (hA)⁴/24, apart from the rows and columns of the rotors."""
    config = QuadrotorConfig(asymmetric_vehicle)
    continuous, stepping = Quadrotor(time_step=0.0, parameters=config), Quadrotor(parameters=config)
    A = jacobian(continuous, lambda system, context: system.EvalTimeDerivatives(context).CopyToVector())[:12, :12]

    def after_a_step(system, context):
        simulator = Simulator_[AutoDiffXd](system, context)
        simulator.AdvanceTo(0.01)
        simulator.AdvancePendingEvents()
        return system.GetOutputPort("state").Eval(context)

    linear_model = jacobian(stepping, after_a_step)[:12, :12]
    hA = 0.01 * A
    expected = sum(np.linalg.matrix_power(hA, k) / math.factorial(k) for k in range(5))
    np.testing.assert_allclose(linear_model, expected, rtol=0.0, atol=1e-15)


def jacobian(vehicle, function):
    """Return the derivative of a function of a vehicle in hover with respect to its state, by AutoDiffXd."""
    hover = vehicle.CreateDefaultContext()
    values = [vehicle.GetOutputPort(name).Eval(hover) for name in ("state", "rotor_speed")]
    state = InitializeAutoDiff(np.concatenate(values))[:, 0]
    converted = vehicle.ToAutoDiffXd()
    context = converted.CreateDefaultContext()
    converted.GetInputPort("rotor_speed_command").FixValue(context, values[1])
    if vehicle.time_step == 0.0:
        context.SetContinuousState(state)
    else:
        context.SetDiscreteState(0, state[:12])
        context.SetDiscreteState(1, state[12:])
    return ExtractGradient(function(converted, context))


def test_derivatives_are_finite_at_a_pitch_of_90_degrees():
    """The derivatives of roll and yaw are not defined at this attitude, but must not be NaN."""
    angles = InitializeAutoDiff(np.array([0.3, -0.5 * math.pi, 0.7]))[:, 0]
    gradient = ExtractGradient(np.array(BodyAxes.of(*angles).angles()))
    assert np.isfinite(gradient).all()
    assert gradient[0].any()


@pytest.mark.parametrize("integrator", ["default", "of a flight"])
@pytest.mark.parametrize("yaw_rate", [0.0, 1e-9, 1e-6, 1e-3, 0.1])
def test_a_continuous_state_turns_over_correctly_or_its_integrator_raises_an_error(integrator, yaw_rate):
    """An integrator with error control either resolves the half-turns of roll and yaw, or raises an error."""
    flip = flip_at(yaw_rate)
    vehicle = Quadrotor(time_step=0.0, parameters=QuadrotorConfig(FLIP_PARAMETERS))
    simulator = Simulator(vehicle)
    context = simulator.get_mutable_context()
    context.SetContinuousState(np.concatenate([flip.states[0], flip.speeds[0]]))
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, flip.commands[0])
    if integrator != "default":
        ResetIntegratorFromFlags(simulator, "runge_kutta5", 0.1).set_target_accuracy(1e-8)
        simulator.get_mutable_integrator().set_requested_minimum_step_size(1e-5)
    try:
        simulator.AdvanceTo(0.6)
    except RuntimeError as error:
        assert integrator != "default"
        assert 1e-9 < yaw_rate < 0.1
        assert "smaller than minimum allowed" in str(error)
        return
    final_state = vehicle.GetOutputPort("state").Eval(context)[None, :]
    _, rotation, *_ = integrate_tumbles(FLIP_PARAMETERS, flip, 0.6)
    assert degrees_apart(final_state[:, 3:6], rotation) < 1e-3


def test_compiled_and_interpreted_vehicles_tumble_equally(asymmetric_vehicle):
    """Their states are equal, for single vehicles and fleets, even if angles jump only for some vehicles of a fleet."""
    tumbles = random_tumbles(11, seed=3)
    wired_states, _ = final_states_and_swings(asymmetric_vehicle, tumbles, 0.01, 1.0)
    builder = DiagramBuilder()
    vehicle = builder.AddNamedSystem(
        "vehicle", Quadrotor(num_vehicles=11, parameters=QuadrotorConfig(asymmetric_vehicle))
    )
    for name, rows in (("rotor_speed_command", tumbles.commands), ("wind", tumbles.winds)):
        source = builder.AddNamedSystem(name, ConstantVectorSource(rows.T.ravel()))
        builder.Connect(source.get_output_port(), vehicle.GetInputPort(name))
    builder.ExportOutput(vehicle.GetOutputPort("state"), "state")
    diagram = builder.Build()
    initial_context = diagram.CreateDefaultContext()
    vehicle_context = vehicle.GetMyMutableContextFromRoot(initial_context)
    vehicle_context.SetDiscreteState(0, tumbles.states.T.ravel())
    vehicle_context.SetDiscreteState(1, tumbles.speeds.T.ravel())
    simulator = Simulator(compile_diagram(diagram))
    part = compiled_part(simulator.get_system())
    part.read(part.GetMyMutableContextFromRoot(simulator.get_mutable_context()), initial_context)
    simulator.AdvanceTo(1.0)
    simulator.AdvancePendingEvents()
    compiled_states = simulator.get_system().GetOutputPort("state").Eval(simulator.get_context()).reshape(12, -1).T
    np.testing.assert_array_equal(compiled_states, wired_states)
    for i in range(3):
        state_alone, _ = final_states_and_swings(
            asymmetric_vehicle, type(tumbles)(*(rows[i : i + 1] for rows in tumbles)), 0.01, 1.0
        )
        np.testing.assert_array_equal(state_alone[0], wired_states[i])


def test_the_attitude_of_a_vehicle_with_an_attitude_response_is_the_integral_of_its_body_rates():
    """The pitch passes 90°. Body rates by eq (2), integrated as a rotation, give the same attitude."""
    response = AttitudeResponse(NaturalFrequencies(6.8, 6.1, 3.0), DampingRatios(0.45, 1.0, 1.4))
    vehicle = AttitudeResponseQuadrotor(
        time_step=1e-3, parameters=AttitudeResponseConfig(QuadrotorConfig(QuadrotorParameters()), response)
    )
    simulator = Simulator(vehicle)
    context = simulator.get_mutable_context()
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, [200.0] * 4)
    target = AttitudeTarget(0.0, 0.5, 2.8, -1.0, 0.0, 0.0, 0.0)
    vehicle.GetInputPort("attitude_target").FixValue(context, list(target))
    states = []
    for tick in range(1001):
        simulator.AdvanceTo(1e-3 * tick)
        simulator.AdvancePendingEvents()
        states.append(vehicle.GetOutputPort("state").Eval(context).copy())
    states = np.array(states)
    assert states[-1, 4] > 2.5
    rotation = rotations(states[0, 3:6])
    for before, after in itertools.pairwise(states):
        rotation = rotation * type(rotation).from_rotvec(0.5e-3 * (before[9:12] + after[9:12]))
    assert degrees_apart(states[-1:, 3:6], rotation) < 1e-3


SLUNG_LOAD = SlungLoad(mass=0.17, length=0.8)  # kg and m


@pytest.mark.slow
def test_a_load_around_a_tumbling_vehicle_is_integrated_with_fourth_order(asymmetric_vehicle):
    """The states agree with two masses and a rod of constant length. Some rods start along X, where α̇ is infinite."""
    tumbles = random_tumbles(20, seed=4, rates=(2.0, 6.0))
    rng = np.random.default_rng(5)
    swings = np.column_stack([rng.uniform(-3.0, 3.0, (20, 2)), rng.uniform(-4.0, 4.0, (20, 2))])
    swings[:3, 1], swings[:3, 2] = 0.5 * np.pi, 0.0
    swings[3:6, 1] = 0.5 * np.pi - 1e-4
    rods = [rod_from_swing(swing) for swing in swings]
    initial_rods = np.array([rod.direction for rod in rods]), np.array([rod.rate for rod in rods])
    position, rotation, velocity, _, load_position, load_velocity = integrate_tumbles(
        asymmetric_vehicle, tumbles, 1.0, SLUNG_LOAD, initial_rods
    )
    directions, rates = (load_position - position) / SLUNG_LOAD.length, (load_velocity - velocity) / SLUNG_LOAD.length
    assert np.abs(directions[:, 0]).max() > 0.9
    errors = []
    for step in TIME_STEPS[:3]:
        states, swings_after = final_states_and_swings(asymmetric_vehicle, tumbles, step, 1.0, SLUNG_LOAD, swings)
        final_rods = [rod_from_swing(swing) for swing in swings_after]
        errors.append(np.abs(np.array([rod.direction for rod in final_rods]) - directions).max())
        assert degrees_apart(states[:, 3:6], rotation).max() < 1e-3
        np.testing.assert_allclose([rod.rate for rod in final_rods], rates, atol=1e3 * step**3)
        np.testing.assert_allclose(states[:, :3], position, atol=1e2 * step**3)
    assert errors[0] < 1e-4
    assert errors[0] / errors[1] > 12.0
    assert errors[1] / errors[2] > 12.0


def test_a_rod_of_a_slung_load_is_recovered_from_its_swing_angles():
    """The direction of the rod and its rate are recovered up to rounding, even if the rod is almost parallel to X."""
    rng = np.random.default_rng(6)
    for distance in 10.0 ** np.arange(-8.0, 1.0):
        direction = np.array([rng.choice([-1.0, 1.0]), *(distance * rng.normal(size=2))])
        direction /= np.linalg.norm(direction)
        rate = np.cross(rng.normal(size=3), direction)
        rod = rod_from_swing(swing_from_rod(type(rod_from_swing((0.0,) * 4))(Vector(*direction), Vector(*rate))))
        np.testing.assert_allclose(rod.direction, direction, atol=1e-15)
        np.testing.assert_allclose(rod.rate, rate, atol=1e-15 / min(distance, 1.0) + 1e-15)


def test_the_length_of_a_rod_does_not_change_its_swing():
    rng = np.random.default_rng(7)
    x, y = rng.normal(scale=0.5, size=2)
    rod = rod_from_swing((x, y, *rng.normal(size=2)))
    doubled = rod._replace(direction=times(2.0, rod.direction), rate=times(2.0, rod.rate))
    assert swing_from_rod(doubled) == pytest.approx(swing_from_rod(rod), rel=1e-12)
