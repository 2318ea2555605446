"""Tests that the equations of motion agree with Drake's plants, the paper and conservation laws."""

import numpy as np
import pytest
from pydrake.examples import QuadrotorPlant
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, Propeller, PropellerInfo
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder
from rigid_body import rigid_body_derivative

from drake_quad.signals import RotorSpeed, State, Wind, Wrench
from drake_quad.vehicle.attitude_kinematics import RIGID_KINEMATICS, SMALL_ANGLE_KINEMATICS
from drake_quad.vehicle.dynamics import (
    RotorAction,
    drag,
    hover_rotor_speeds,
    rotor_action,
    target_rotor_speed,
)
from drake_quad.vehicle.effects import NO_EFFECTS
from drake_quad.vehicle.faults import SpeedFactors
from drake_quad.vehicle.parameters import CentreOfMass, QuadrotorParameters
from drake_quad.vehicle.rotors import Rotor, Rotors
from drake_quad.vehicle.stepping import VehicleState, quadrotor_derivatives

PAPER_VEHICLE = QuadrotorParameters()
NO_WIND = Wind(0.0, 0.0, 0.0)  # m/s
NO_WRENCH = Wrench(0.0, 0.0, 0.0, 0.0)  # N and N m


def random_states(count, seed):
    """Return positions, attitudes within 1.2 rad, velocities, body rates and rotor speeds, one state per row."""
    rng = np.random.default_rng(seed)
    attitude = rng.uniform(-1.2, 1.2, (count, 3)) * [1.0, 1.0, 2.5]
    return np.hstack(
        [rng.normal(size=(count, 3)), attitude, rng.normal(size=(count, 6)) * 3.0, rng.uniform(60.0, 300.0, (count, 4))]
    )


def body_derivative(state, parameters, wind=NO_WIND, kinematics=RIGID_KINEMATICS):
    rotors = rotor_action(RotorSpeed(*state[12:]), parameters)
    return np.array(rigid_body_derivative(State(*state[:12]), rotors, wind, parameters, kinematics))


def assert_close(actual, expected):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-12 * scale)


@pytest.fixture(scope="module")
def parameters_without_drag(asymmetric_vehicle):
    """Return asymmetric parameters without rotor inertia and drag, which Drake's plants do not model."""
    return asymmetric_vehicle._replace(rotor_inertia=0.0, linear_drag=0.0, quadratic_drag=0.0)


def test_accelerations_agree_with_the_quadrotor_plant_of_drake(parameters_without_drag):
    """The rotors of Drake's plant are equal, and its centre of mass is in their middle."""
    b, d, arm = 4.15e-5, 1.1e-6, 0.165
    rotors = Rotors.plus(length=2.0 * arm, width=2.0 * arm, thrust_factor=b, drag_factor=d)
    parameters = parameters_without_drag._replace(rotors=rotors, centre_of_mass=CentreOfMass(), gravity=9.81)
    plant = QuadrotorPlant(
        m_arg=parameters.mass,
        L_arg=arm,
        I_arg=np.diag(parameters.inertia),
        kF_arg=b,
        kM_arg=d,
    )
    context = plant.CreateDefaultContext()
    for state in random_states(300, seed=1):
        our_derivative = body_derivative(state, parameters)
        euler = RollPitchYaw(state[3:6])
        rates = euler.CalcRpyDtFromAngularVelocityInChild(state[9:12])
        context.SetContinuousState(np.concatenate([state[:6], state[6:9], rates]))
        # The second rotor of Drake's plant is at +y, where the paper has the fourth.
        squares = state[[12, 15, 14, 13]] ** 2
        plant.get_input_port().FixValue(context, squares)
        drake_derivative = plant.EvalTimeDerivatives(context).CopyToVector()
        assert_close(our_derivative[0:6], drake_derivative[0:6])
        assert_close(our_derivative[6:9], drake_derivative[6:9])
        euler_acceleration = euler.CalcRpyDDtFromAngularAccelInChild(rates, our_derivative[9:12])
        assert_close(euler_acceleration, drake_derivative[9:12])


def multibody_plant(parameters):
    """Return a MultibodyPlant of a free body with four propellers."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    inertia = UnitInertia(*(np.array(parameters.inertia) / parameters.mass))
    body = plant.AddRigidBody("vehicle", SpatialInertia(parameters.mass, [0.0, 0.0, 0.0], inertia))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -parameters.gravity])
    plant.Finalize()
    centre = np.array([*parameters.centre_of_mass, 0.0])
    # A rotor that turns clockwise, seen from above, turns the body anticlockwise, around +z.
    infos = [
        PropellerInfo(body.index(), RigidTransform(np.array([x, y, z]) - centre), b, -turns * d)
        for x, y, z, turns, b, d in parameters.rotors
    ]
    propellers = builder.AddSystem(Propeller(infos))
    builder.Connect(propellers.get_spatial_forces_output_port(), plant.get_applied_spatial_force_input_port())
    builder.Connect(plant.get_body_poses_output_port(), propellers.get_body_poses_input_port())
    builder.ExportInput(propellers.get_command_input_port(), "squared_rotor_speed")
    return builder.Build(), plant, body


def random_rotors(rng):
    """Return four rotors with random positions and directions of rotation."""
    return Rotors(
        *(
            Rotor(*rng.normal(size=3) * 0.2, rng.choice([-1.0, 1.0]), rng.uniform(2e-5, 6e-5), rng.uniform(4e-7, 2e-6))
            for _ in range(4)
        )
    )


def assert_accelerates_as_multibody(parameters, states):
    diagram, plant, body = multibody_plant(parameters)
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    for state in states:
        R_WB = RollPitchYaw(state[3:6]).ToRotationMatrix()
        plant.SetFreeBodyPose(context, body, RigidTransform(R_WB, state[0:3]))
        w_W = R_WB @ state[9:12]
        plant.SetFreeBodySpatialVelocity(context, body, SpatialVelocity(w_W, state[6:9]))
        diagram.get_input_port().FixValue(root, state[12:] ** 2)
        acceleration = plant.EvalBodySpatialAccelerationInWorld(context, body)
        our_derivative = body_derivative(state, parameters)
        assert_close(our_derivative[6:9], acceleration.translational())
        assert_close(our_derivative[9:12], R_WB.inverse() @ acceleration.rotational())


def test_accelerations_agree_with_a_multibody_plant_with_propellers(parameters_without_drag):
    assert_accelerates_as_multibody(parameters_without_drag, random_states(300, seed=2))


@pytest.mark.slow
def test_accelerations_of_a_hundred_layouts_agree_with_multibody_plants(parameters_without_drag):
    rng = np.random.default_rng(12)
    for seed in range(100):
        parameters = parameters_without_drag._replace(
            rotors=random_rotors(rng), centre_of_mass=CentreOfMass(*rng.normal(size=2) * 0.05)
        )
        assert_accelerates_as_multibody(parameters, random_states(5, seed=seed))


def test_rotors_in_a_plus_agree_with_eqs_4_and_5():
    b, d, length, speeds = 4.13e-5, 8.5e-7, 0.17, RotorSpeed(210.0, 190.0, 205.0, 180.0)
    w_1, w_2, w_3, w_4 = speeds
    action = rotor_action(speeds, PAPER_VEHICLE)
    assert action.residual == pytest.approx(-w_1 + w_2 - w_3 + w_4)
    assert action.wrench.thrust == pytest.approx(b * (w_1**2 + w_2**2 + w_3**2 + w_4**2))
    assert action.wrench.tau_x == pytest.approx(length * b * (w_4**2 - w_2**2))
    assert action.wrench.tau_y == pytest.approx(length * b * (w_3**2 - w_1**2))
    assert action.wrench.tau_z == pytest.approx(d * (w_1**2 - w_2**2 + w_3**2 - w_4**2))


def test_the_total_angular_momentum_of_body_and_rotors_is_constant(parameters_without_drag):
    """The vector R_WB (I w + J_r w_r z) is constant if the rotors have constant speed and no thrust."""
    parameters = parameters_without_drag._replace(rotor_inertia=1e-3)
    residual = rotor_action(RotorSpeed(100.0, 300.0, 120.0, 280.0), parameters).residual
    assert residual == 360.0
    state = np.array([0.0] * 3 + [0.1, -0.2, 0.3] + [0.0] * 3 + [1.0, -2.0, 0.5])

    def momentum(state):
        R_WB = RollPitchYaw(state[3:6]).ToRotationMatrix().matrix()
        body = np.array(parameters.inertia) * state[9:12] + [0.0, 0.0, parameters.rotor_inertia * residual]
        return R_WB @ body

    def derivative(state):
        rotors = RotorAction(NO_WRENCH, residual)
        return np.array(rigid_body_derivative(State(*state), rotors, NO_WIND, parameters, RIGID_KINEMATICS))

    start = momentum(state)
    step = 1e-4
    for _ in range(3000):
        k_1 = derivative(state)
        k_2 = derivative(state + 0.5 * step * k_1)
        k_3 = derivative(state + 0.5 * step * k_2)
        k_4 = derivative(state + step * k_3)
        state = state + step / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
    assert np.abs(state[9:12] - [1.0, -2.0, 0.5]).max() > 0.5, "the body rates should change"
    np.testing.assert_allclose(momentum(state), start, rtol=0.0, atol=1e-12)


def test_gyroscopic_torques_have_the_signs_of_the_paper(asymmetric_vehicle):
    """Eq (3) contains -J_r θ' w_r in roll and +J_r φ' w_r in pitch."""
    parameters = asymmetric_vehicle._replace(linear_drag=0.0, quadratic_drag=0.0)
    (i_xx, i_yy, i_zz), rotor_inertia = parameters.inertia, parameters.rotor_inertia
    state = State(*[0.0] * 9, p=2.0, q=3.0, r=0.0)
    rotors = RotorAction(NO_WRENCH, 50.0)
    slope = rigid_body_derivative(state, rotors, NO_WIND, parameters, SMALL_ANGLE_KINEMATICS)
    assert slope.p == pytest.approx(-rotor_inertia * 3.0 * 50.0 / i_xx)
    assert slope.q == pytest.approx(rotor_inertia * 2.0 * 50.0 / i_yy)
    assert slope.r == pytest.approx((i_xx - i_yy) * 2.0 * 3.0 / i_zz)


def test_small_angle_kinematics_agree_with_exact_kinematics_to_second_order(asymmetric_vehicle):
    direction = np.random.default_rng(3).normal(size=16)
    direction[:3] = direction[6:9] = 0.0

    def largest_difference(size):
        state = size * direction
        state[12:] += 200.0
        kinematics = RIGID_KINEMATICS, SMALL_ANGLE_KINEMATICS
        exact, approximate = (body_derivative(state, asymmetric_vehicle, NO_WIND, each) for each in kinematics)
        return np.abs(exact - approximate).max()

    ratios = [largest_difference(size) / largest_difference(size / 2.0) for size in (1e-2, 1e-3, 1e-4)]
    np.testing.assert_allclose(ratios, 4.0, rtol=2e-2)


def test_a_vehicle_at_hover_speeds_has_no_acceleration():
    speeds = hover_rotor_speeds(PAPER_VEHICLE)
    assert speeds == pytest.approx([200.9] * 4, abs=0.05)
    state = VehicleState(State(*[0.0] * 12), speeds)
    body, rotors, *_ = quadrotor_derivatives(
        state, speeds, NO_WIND, None, PAPER_VEHICLE, None, NO_EFFECTS, 0.0, RIGID_KINEMATICS
    )
    np.testing.assert_allclose([*body, *rotors], 0.0, atol=1e-14)


def test_the_energy_changes_by_the_power_of_thrust_torques_and_drag(asymmetric_vehicle):
    parameters = asymmetric_vehicle._replace(linear_drag=0.2, quadratic_drag=0.05)
    wind = Wind(1.0, -2.0, 0.5)
    for state in random_states(100, seed=4):
        slope = body_derivative(state, parameters, wind)
        velocity, rates = state[6:9], state[9:12]
        energy_rate = (
            parameters.mass * velocity @ slope[6:9]
            + rates @ (np.array(parameters.inertia) * slope[9:12])
            + parameters.mass * parameters.gravity * slope[2]
        )
        thrust, *torque = rotor_action(RotorSpeed(*state[12:]), parameters).wrench
        z_B = RollPitchYaw(state[3:6]).ToRotationMatrix().matrix()[:, 2]
        force = np.array(drag(Wind(*np.subtract(wind, velocity)), 0.2, 0.05))
        power = thrust * z_B @ velocity + np.array(torque) @ rates + force @ velocity
        assert energy_rate == pytest.approx(power, rel=1e-12, abs=1e-12)


def test_rotor_speed_commands_are_clipped_and_multiplied_by_fault_factors(asymmetric_vehicle):
    """The command of each rotor is in turn too large, too small, NaN and feasible. Each rotor has its own factor."""
    low, high = asymmetric_vehicle.min_rotor_speed, asymmetric_vehicle.max_rotor_speed
    commands, limited, factors = [1e4, -1e4, np.nan, 250.0], [high, low, low, 250.0], [1.0, 0.9, 0.8, 0.7]
    for shift in range(4):
        command = RotorSpeed(*np.roll(commands, shift).tolist())
        speeds = target_rotor_speed(command, asymmetric_vehicle, SpeedFactors(*factors))
        np.testing.assert_allclose(speeds, factors * np.roll(limited, shift), rtol=1e-15)


def test_drag_is_parallel_to_the_airspeed():
    force = np.array(drag(Wind(-3.0, 4.0, 0.0), 0.2, 0.01))
    assert np.linalg.norm(force) == pytest.approx(0.2 * 5.0 + 0.01 * 25.0)
    np.testing.assert_allclose(force / np.linalg.norm(force), [-0.6, 0.8, 0.0])
    assert drag(NO_WIND, 0.2, 0.01) == (0.0, 0.0, 0.0)


def test_a_vehicle_that_moves_with_the_air_has_no_drag(asymmetric_vehicle, parameters_without_drag):
    state = random_states(1, seed=8)[0]
    parameters = asymmetric_vehicle._replace(rotor_inertia=0.0)
    still_air = body_derivative(state, parameters_without_drag, NO_WIND)
    np.testing.assert_allclose(body_derivative(state, parameters, Wind(*state[6:9])), still_air, rtol=1e-12)
