"""Tests that effects on a vehicle agree with forces at points, with a MultibodyPlant and with energy balances."""

import math

import numpy as np
import pytest
from oracle.effects import Forces, accelerations
from oracle.vehicle import rotation
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BallRpyJoint, PrismaticJoint, SpatialInertia, UnitInertia, UniversalJoint
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

from drake_quad.signals import Swing
from drake_quad.vehicle.aerodynamics import (
    BodyDrag,
    CentreOfPressure,
    GroundEffect,
    LinearDrag,
    QuadraticDrag,
    RotorAerodynamics,
    ground_effect,
)
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.motors import SpinDown
from drake_quad.vehicle.parameters import Inertia
from drake_quad.vehicle.payload import Payload, PayloadPosition
from drake_quad.vehicle.quadrotor import HoverPose, Quadrotor, QuadrotorConfig
from drake_quad.vehicle.rotors import Rotors
from drake_quad.vehicle.slung_load import SlungLoad

DRAG = BodyDrag(LinearDrag(0.1, 0.2, 0.3), QuadraticDrag(0.04, 0.05, 0.06), CentreOfPressure(0.01, -0.02, 0.03))
ROTOR_AERODYNAMICS = RotorAerodynamics(lift=0.03, climb=0.11, drag=2e-4, inflow=3e-4)
GROUND_EFFECT = GroundEffect(rotor_radius=0.21, ground_height=-0.4)  # m
PAYLOAD = Payload(0.23, PayloadPosition(0.04, -0.03, -0.09), Inertia(2e-4, 3e-4, 5e-4))
EFFECTS = {
    "body drag": Effects(body_drag=DRAG),
    "rotor aerodynamics": Effects(rotor_aerodynamics=ROTOR_AERODYNAMICS),
    "ground effect": Effects(ground_effect=GROUND_EFFECT),
    "reaction torque": Effects(reaction_torque=ReactionTorque(9.0e-5)),
    "spin down": Effects(spin_down=SpinDown(0.07), reaction_torque=ReactionTorque(9.0e-5)),
    "payload": Effects(payload=PAYLOAD),
    "all": Effects(DRAG, ROTOR_AERODYNAMICS, GROUND_EFFECT, ReactionTorque(9.0e-5), SpinDown(0.07), payload=PAYLOAD),
}


class RandomFlightState:
    """Random vehicle state, command and wind."""

    def __init__(self, rng):
        attitude = rng.uniform(-1.2, 1.2, 3) * [1.0, 1.0, 2.5]
        self.state = np.concatenate([rng.normal(size=3), attitude, 3.0 * rng.normal(size=6)])
        self.speeds, self.command = rng.uniform(80.0, 280.0, (2, 4))
        self.wind = 3.0 * rng.normal(size=3)


def samples(count, seed):
    rng = np.random.default_rng(seed)
    return [RandomFlightState(rng) for _ in range(count)]


def derivative_of(vehicle, context, sample, *more_states):
    """Return the derivative of the continuous state of a vehicle."""
    context.SetContinuousState(np.concatenate([sample.state, sample.speeds, *more_states]))
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, sample.command)
    vehicle.GetInputPort("wind").FixValue(context, sample.wind)
    return vehicle.EvalTimeDerivatives(context).CopyToVector()


def continuous_vehicle(parameters, effects, **structure):
    config = QuadrotorConfig(parameters, effects=effects)
    vehicle = Quadrotor(time_step=0.0, effects=effects.names, parameters=config, **structure)
    return vehicle, vehicle.CreateDefaultContext()


def rotor_rates(sample, parameters, effects):
    time_constant_up = parameters.rotor_time_constant
    time_constant_down = time_constant_up if effects.spin_down is None else effects.spin_down.time_constant
    return (sample.command - sample.speeds) / np.where(
        sample.command > sample.speeds, time_constant_up, time_constant_down
    )


def added_bodies(effects):
    if effects.payload is None:
        return []
    return [(effects.payload.mass, np.array(effects.payload.position), np.diag(effects.payload.inertia))]


def assert_close(actual, expected, tolerance=1e-12):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance * scale)


def with_scattered_rotors(parameters):
    """Return parameters with rotors at irregular positions, whose mean is not the origin of the layout."""
    positions = (0.16, -0.02, 0.03), (-0.01, -0.15, 0.0), (-0.12, 0.03, 0.01), (0.04, 0.18, 0.04)
    rotors = zip(parameters.rotors, positions, strict=True)
    return parameters._replace(rotors=Rotors._make(rotor._replace(x=x, y=y, z=z) for rotor, (x, y, z) in rotors))


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("layout", ["plus", "scattered"])
def test_air_loads_agree_with_forces_at_their_points(asymmetric_vehicle, layout, name):
    effects = EFFECTS[name]
    parameters = asymmetric_vehicle if layout == "plus" else with_scattered_rotors(asymmetric_vehicle)
    vehicle, context = continuous_vehicle(parameters, effects)
    vehicle_without_effects, context_without_effects = continuous_vehicle(parameters, Effects())
    forces = Forces(parameters, effects)
    max_difference = 0.0
    for sample in samples(100, seed=1):
        derivative, derivative_without_effects = (
            derivative_of(vehicle, context, sample),
            derivative_of(vehicle_without_effects, context_without_effects, sample),
        )
        rates = rotor_rates(sample, parameters, effects)
        pairs, torque = forces.at(sample.state, sample.speeds, sample.wind, rates)
        expected = accelerations(parameters, sample.state, sample.speeds, pairs, torque, added_bodies(effects))
        assert_close(derivative[6:12], expected)
        assert_close(derivative[12:], rates)
        np.testing.assert_array_equal(derivative[:6], derivative_without_effects[:6])
        max_difference = max(max_difference, np.abs(derivative[6:12] - derivative_without_effects[6:12]).max())
    assert max_difference > 0.1, "the effect should change the accelerations"


def test_effects_with_default_parameters_change_nothing(asymmetric_vehicle):
    effects = Effects(BodyDrag(), RotorAerodynamics())
    vehicle, context = continuous_vehicle(asymmetric_vehicle, effects)
    vehicle_without_effects, context_without_effects = continuous_vehicle(asymmetric_vehicle, Effects())
    for sample in samples(20, seed=5):
        assert_close(
            derivative_of(vehicle, context, sample),
            derivative_of(vehicle_without_effects, context_without_effects, sample),
        )


def test_an_effect_without_parameters_is_rejected():
    with pytest.raises(ValueError, match="no parameters are given for the effect body_drag"):
        Quadrotor(
            effects=("ground_effect", "body_drag"),
            parameters=QuadrotorConfig(effects=Effects(ground_effect=GROUND_EFFECT)),
        )


@pytest.mark.parametrize("name", ["body drag", "rotor aerodynamics"])
def test_drag_only_dissipates_in_still_air(asymmetric_vehicle, name):
    """The forces act at the centre of mass, so they do no work on the rotation.

    The test sets the coefficient of lift to zero, since lift can add power.
    """
    drag = DRAG._replace(centre_of_pressure=CentreOfPressure())
    effects = (
        Effects(body_drag=drag)
        if name == "body drag"
        else Effects(rotor_aerodynamics=ROTOR_AERODYNAMICS._replace(lift=0.0))
    )
    vehicle, context = continuous_vehicle(asymmetric_vehicle, effects)
    vehicle_without_effects, context_without_effects = continuous_vehicle(asymmetric_vehicle, Effects())
    for sample in samples(100, seed=2):
        sample.wind = np.zeros(3)
        change = (
            derivative_of(vehicle, context, sample)[6:9]
            - derivative_of(vehicle_without_effects, context_without_effects, sample)[6:9]
        )
        assert change @ sample.state[6:9] < 0.0


def test_a_vehicle_that_moves_with_the_air_has_no_air_load(asymmetric_vehicle):
    vehicle, context = continuous_vehicle(asymmetric_vehicle, Effects(DRAG, ROTOR_AERODYNAMICS))
    vehicle_without_effects, context_without_effects = continuous_vehicle(asymmetric_vehicle, Effects())
    for sample in samples(5, seed=3):
        sample.wind = sample.state[6:9]
        assert_close(
            derivative_of(vehicle, context, sample),
            derivative_of(vehicle_without_effects, context_without_effects, sample),
        )


def test_equal_body_drag_on_all_axes_is_isotropic_drag(asymmetric_vehicle):
    c_1, c_2 = 0.31, 0.07
    drag = BodyDrag(LinearDrag(c_1, c_1, c_1), QuadraticDrag(c_2, c_2, c_2))
    without_drag = asymmetric_vehicle._replace(linear_drag=0.0, quadratic_drag=0.0)
    vehicle, context = continuous_vehicle(without_drag, Effects(body_drag=drag))
    with_isotropic_drag = asymmetric_vehicle._replace(linear_drag=c_1, quadratic_drag=c_2)
    isotropic_vehicle, isotropic_context = continuous_vehicle(with_isotropic_drag, Effects())
    for sample in samples(20, seed=4):
        assert_close(
            derivative_of(vehicle, context, sample), derivative_of(isotropic_vehicle, isotropic_context, sample)
        )


def test_ground_effect_has_the_ratio_of_cheeseman_and_bennett():
    """The ratio is 16/15 at the height R and 64/63 at 2 R. It approaches 1 as 1 / z², and is constant below R / 2."""
    ground = GroundEffect(rotor_radius=0.2, ground_height=1.0)
    assert ground_effect(1.2, ground) == pytest.approx(16.0 / 15.0, rel=1e-14)
    assert ground_effect(1.4, ground) == pytest.approx(64.0 / 63.0, rel=1e-14)
    assert (ground_effect(101.0, ground) - 1.0) / (ground_effect(201.0, ground) - 1.0) == pytest.approx(4.0, rel=1e-5)
    for height in (1.1, 1.05, 1.0, 0.0, -50.0):
        assert ground_effect(height, ground) == pytest.approx(4.0 / 3.0, rel=1e-14)
    assert ground_effect(1.1001, ground) < 4.0 / 3.0 - 1e-4


def apply_forces(plant, context, body, R_WB, pairs, torque):
    """Apply forces at points and a torque to a body, all in B."""
    force = ExternallyAppliedSpatialForce()
    force.body_index, force.p_BoBq_B = body.index(), np.zeros(3)
    total_force = sum(force for _, force in pairs)
    total_torque = torque + sum(np.cross(position, point_force) for position, point_force in pairs)
    force.F_Bq_W = SpatialForce(R_WB @ total_torque, R_WB @ total_force)
    plant.get_applied_spatial_force_input_port().FixValue(context, Value[list[ExternallyAppliedSpatialForce]]([force]))


def test_a_payload_agrees_with_a_multibody_plant(asymmetric_vehicle):
    parameters = asymmetric_vehicle._replace(rotor_inertia=0.0)
    plant = MultibodyPlant(time_step=0.0)
    inertia = UnitInertia(*(np.array(parameters.inertia) / parameters.mass))
    body = plant.AddRigidBody("vehicle", SpatialInertia(parameters.mass, np.zeros(3), inertia))
    payload_inertia = UnitInertia(*(np.array(PAYLOAD.inertia) / PAYLOAD.mass))
    load = plant.AddRigidBody("payload", SpatialInertia(PAYLOAD.mass, np.zeros(3), payload_inertia))
    plant.WeldFrames(body.body_frame(), load.body_frame(), RigidTransform(np.array(PAYLOAD.position)))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -parameters.gravity])
    plant.Finalize()
    context = plant.CreateDefaultContext()
    effects = Effects(DRAG, ROTOR_AERODYNAMICS, payload=PAYLOAD)
    vehicle, vehicle_context = continuous_vehicle(parameters, effects)
    forces = Forces(parameters, effects)
    for sample in samples(50, seed=5):
        R_WB = RollPitchYaw(sample.state[3:6]).ToRotationMatrix()
        plant.SetFreeBodyPose(context, body, RigidTransform(R_WB, sample.state[:3]))
        w_W = R_WB @ sample.state[9:12]
        plant.SetFreeBodySpatialVelocity(context, body, SpatialVelocity(w_W, sample.state[6:9]))
        apply_forces(plant, context, body, R_WB, *forces.at(sample.state, sample.speeds, sample.wind, np.zeros(4)))
        acceleration = plant.EvalBodySpatialAccelerationInWorld(context, body)
        derivative = derivative_of(vehicle, vehicle_context, sample)
        assert_close(derivative[6:9], acceleration.translational(), 1e-11)
        assert_close(derivative[9:12], R_WB.inverse() @ acceleration.rotational(), 1e-11)


SLUNG_LOAD = SlungLoad(mass=0.17, length=0.8)  # kg and m


@pytest.fixture(scope="module")
def pendulum(asymmetric_vehicle):
    """Return a plant of a vehicle with a slung load, the vehicle's body, and the joints of its attitude and the rod.

    Coordinates are x, y and z, then roll, pitch and yaw, then the angles of the rod.
    """
    parameters = asymmetric_vehicle
    plant = MultibodyPlant(time_step=0.0)
    parent = plant.world_body()
    no_inertia = SpatialInertia.Zero()
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        carriage = plant.AddRigidBody(name, no_inertia)
        plant.AddJoint(PrismaticJoint(name, parent.body_frame(), carriage.body_frame(), axis))
        parent = carriage
    inertia = UnitInertia(*(np.array(parameters.inertia) / parameters.mass))
    body = plant.AddRigidBody("vehicle", SpatialInertia(parameters.mass, np.zeros(3), inertia))
    attitude_joint = plant.AddJoint(BallRpyJoint("ball", parent.body_frame(), body.body_frame()))
    squared_length = SLUNG_LOAD.length**2
    point_inertia = SpatialInertia(
        SLUNG_LOAD.mass, [0.0, 0.0, -SLUNG_LOAD.length], UnitInertia(squared_length, squared_length, 0.0)
    )
    load = plant.AddRigidBody("load", point_inertia)
    rod = plant.AddJoint(UniversalJoint("rod", parent.body_frame(), load.body_frame()))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -parameters.gravity])
    plant.Finalize()
    return plant, body, attitude_joint, rod


def test_a_slung_load_agrees_with_a_multibody_plant(asymmetric_vehicle, pendulum):
    plant, body, attitude_joint, rod = pendulum
    parameters = asymmetric_vehicle._replace(rotor_inertia=0.0)
    context = plant.CreateDefaultContext()
    effects = Effects(DRAG, ROTOR_AERODYNAMICS, GROUND_EFFECT, slung_load=SLUNG_LOAD)
    vehicle, vehicle_context = continuous_vehicle(parameters, effects)
    forces = Forces(parameters, effects)
    rng = np.random.default_rng(6)
    for sample in samples(50, seed=6):
        swing = Swing(*rng.uniform(-1.2, 1.2, 2), *rng.normal(size=2))
        for i, name in enumerate("xyz"):
            joint = plant.GetJointByName(name)
            joint.set_translation(context, sample.state[i])
            joint.set_translation_rate(context, sample.state[6 + i])
        R_WB = RollPitchYaw(sample.state[3:6]).ToRotationMatrix()
        attitude_joint.set_angles(context, sample.state[3:6])
        attitude_joint.set_angular_velocity(context, R_WB @ sample.state[9:12])
        rod.set_angles(context, swing[:2])
        rod.set_angular_rates(context, swing[2:])
        apply_forces(plant, context, body, R_WB, *forces.at(sample.state, sample.speeds, sample.wind, np.zeros(4)))
        rates = plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :]
        acceleration = plant.EvalBodySpatialAccelerationInWorld(context, body)
        derivative = derivative_of(vehicle, vehicle_context, sample, swing)
        assert_close(derivative[6:9], acceleration.translational(), 1e-10)
        assert_close(derivative[9:12], R_WB.inverse() @ acceleration.rotational(), 1e-10)
        assert_close(derivative[16:18], swing[2:])
        assert_close(derivative[18:20], rates[rod.velocity_start() : rod.velocity_start() + 2], 1e-10)


def load_velocity(state, swing):
    """Return the velocity of the load in W, from the derivative of the rod's direction."""
    a, b, da, db = swing
    along_a = np.array([0.0, math.cos(a) * math.cos(b), math.sin(a) * math.cos(b)])
    along_b = np.array([-math.cos(b), -math.sin(a) * math.sin(b), math.cos(a) * math.sin(b)])
    return state[6:9] + SLUNG_LOAD.length * (da * along_a + db * along_b)


def test_the_energy_of_a_swinging_load_changes_by_the_work_of_the_rotors(asymmetric_vehicle):
    """The error is below 1e-7 J after one second with steps of 0.5 ms. The load swings by 0.5 rad in this time."""
    parameters = asymmetric_vehicle._replace(linear_drag=0.0, quadratic_drag=0.0, rotor_time_constant=1e-3)
    effects = Effects(slung_load=SLUNG_LOAD)
    time_step, num_steps = 5e-4, 2000
    config = QuadrotorConfig(parameters, start=HoverPose(z=2.0), effects=effects)
    vehicle = Quadrotor(time_step=time_step, effects=effects.names, parameters=config)
    context = vehicle.CreateDefaultContext()
    swing = Swing(0.5, -0.3, 0.4, 0.6)
    vehicle.set_state(context, "swing", swing)
    speeds = np.array(vehicle.get_state(context, "rotor_speed"))
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, speeds)

    def energy():
        state, load = np.array(vehicle.get_state(context, "state")), vehicle.get_state(context, "swing")
        velocity = load_velocity(state, load)
        height = state[2] - SLUNG_LOAD.length * math.cos(load.roll) * math.cos(load.pitch)
        kinetic = parameters.mass * state[6:9] @ state[6:9] + SLUNG_LOAD.mass * velocity @ velocity
        rotational = state[9:12] @ (np.array(parameters.inertia) * state[9:12])
        weight = parameters.mass * state[2] + SLUNG_LOAD.mass * height
        return 0.5 * (kinetic + rotational) + parameters.gravity * weight

    simulator = Simulator(vehicle, context)
    thrust = np.array(parameters.rotors.thrust_factors) @ speeds**2
    initial_energy, work, final_change = energy(), 0.0, 0.0
    previous_state = np.array(vehicle.get_state(context, "state"))
    for step in range(1, num_steps + 1):
        simulator.AdvanceTo(step * time_step)
        simulator.AdvancePendingEvents()
        state = np.array(vehicle.get_state(context, "state"))
        final_change = abs(vehicle.get_state(context, "swing").roll - 0.5)
        # The body does not rotate, so the work of the thrust is the force times the displacement.
        work += thrust * rotation(*state[3:6])[:, 2] @ (state[:3] - previous_state[:3])
        previous_state = state
    assert final_change > 0.3
    np.testing.assert_allclose(state[3:6], 0.0, atol=1e-9)
    assert energy() - initial_energy == pytest.approx(work, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [EFFECTS["all"], EFFECTS["all"]._replace(payload=None, slung_load=SLUNG_LOAD), EFFECTS["ground effect"]],
    ids=["payload", "slung load", "ground effect"],
)
def test_steps_with_effects_are_of_fourth_order(asymmetric_vehicle, effects):
    """The error after 0.2 s falls to a sixteenth if the time step is halved."""
    command, wind = np.array([205.0, 190.0, 200.0, 215.0]), [2.0, -1.0, 0.5]

    def final_state(time_step):
        config = QuadrotorConfig(asymmetric_vehicle, start=HoverPose(z=-0.25), effects=effects)
        vehicle = Quadrotor(time_step=time_step, effects=effects.names, parameters=config)
        simulator = Simulator(vehicle)
        context = simulator.get_mutable_context()
        vehicle.GetInputPort("rotor_speed_command").FixValue(context, command)
        vehicle.GetInputPort("wind").FixValue(context, wind)
        if time_step == 0.0:
            ResetIntegratorFromFlags(simulator, "runge_kutta5", 0.01).set_target_accuracy(1e-10)
        simulator.AdvanceTo(0.2)
        simulator.AdvancePendingEvents()
        names = ["state", "swing"] if effects.slung_load else ["state"]
        return np.concatenate([vehicle.GetOutputPort(name).Eval(context) for name in names])

    exact = final_state(0.0)
    coarse_error, fine_error = (np.abs(final_state(step) - exact).max() for step in (0.02, 0.01))
    assert 1e-9 < fine_error < 1e-4
    assert coarse_error / fine_error == pytest.approx(16.0, rel=0.25)
