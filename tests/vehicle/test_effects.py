"""Effects on a vehicle agree with forces at points, with MultibodyPlant, and with energy balances."""

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
from drake_quad.vehicle.quadrotor import Place, Quadrotor, QuadrotorNumbers
from drake_quad.vehicle.rotors import Rotors
from drake_quad.vehicle.slung_load import SlungLoad

DRAG = BodyDrag(LinearDrag(0.1, 0.2, 0.3), QuadraticDrag(0.04, 0.05, 0.06), CentreOfPressure(0.01, -0.02, 0.03))
ROTORS = RotorAerodynamics(lift=0.03, climb=0.11, drag=2e-4, inflow=3e-4)
GROUND = GroundEffect(rotor_radius=0.21, ground_height=-0.4)
PAYLOAD = Payload(0.23, PayloadPosition(0.04, -0.03, -0.09), Inertia(2e-4, 3e-4, 5e-4))
EFFECTS = {
    "body drag": Effects(body_drag=DRAG),
    "rotor aerodynamics": Effects(rotor_aerodynamics=ROTORS),
    "ground effect": Effects(ground_effect=GROUND),
    "reaction torque": Effects(reaction_torque=ReactionTorque(9.0e-5)),
    "spin down": Effects(spin_down=SpinDown(0.07), reaction_torque=ReactionTorque(9.0e-5)),
    "payload": Effects(payload=PAYLOAD),
    "all": Effects(DRAG, ROTORS, GROUND, ReactionTorque(9.0e-5), SpinDown(0.07), payload=PAYLOAD),
}


class Sample:
    """Random vehicle state, command and wind."""

    def __init__(self, rng):
        attitude = rng.uniform(-1.2, 1.2, 3) * [1.0, 1.0, 2.5]
        self.state = np.concatenate([rng.normal(size=3), attitude, 3.0 * rng.normal(size=6)])
        self.speeds, self.command = rng.uniform(80.0, 280.0, (2, 4))
        self.wind = 3.0 * rng.normal(size=3)


def samples(count, seed):
    rng = np.random.default_rng(seed)
    return [Sample(rng) for _ in range(count)]


def slope(vehicle, context, sample, *more):
    """Return the derivative of the continuous state of a vehicle."""
    context.SetContinuousState(np.concatenate([sample.state, sample.speeds, *more]))
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, sample.command)
    vehicle.GetInputPort("wind").FixValue(context, sample.wind)
    return vehicle.EvalTimeDerivatives(context).CopyToVector()


def continuous(parameters, effects, **structure):
    numbers = QuadrotorNumbers(parameters, effects=effects)
    vehicle = Quadrotor(time_step=0.0, effects=effects.names, numbers=numbers, **structure)
    return vehicle, vehicle.CreateDefaultContext()


def rotor_rates(sample, parameters, effects):
    up = parameters.rotor_time_constant
    down = up if effects.spin_down is None else effects.spin_down.time_constant
    return (sample.command - sample.speeds) / np.where(sample.command > sample.speeds, up, down)


def parts(effects):
    if effects.payload is None:
        return []
    return [(effects.payload.mass, np.array(effects.payload.position), np.diag(effects.payload.inertia))]


def assert_close(actual, expected, tolerance=1e-12):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance * scale)


def anywhere(parameters):
    """Return a vehicle with rotors at random positions, whose mean is not the origin of the layout."""
    places = (0.16, -0.02, 0.03), (-0.01, -0.15, 0.0), (-0.12, 0.03, 0.01), (0.04, 0.18, 0.04)
    rotors = zip(parameters.rotors, places, strict=True)
    return parameters._replace(rotors=Rotors._make(rotor._replace(x=x, y=y, z=z) for rotor, (x, y, z) in rotors))


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("layout", ["plus", "anywhere"])
def test_air_loads_agree_with_forces_at_their_points(asymmetric_vehicle, layout, name):
    effects = EFFECTS[name]
    parameters = asymmetric_vehicle if layout == "plus" else anywhere(asymmetric_vehicle)
    vehicle, context = continuous(parameters, effects)
    bare, bare_context = continuous(parameters, Effects())
    forces = Forces(parameters, effects)
    moved = 0.0
    for sample in samples(100, seed=1):
        found, without = slope(vehicle, context, sample), slope(bare, bare_context, sample)
        rates = rotor_rates(sample, parameters, effects)
        pairs, torque = forces.at(sample.state, sample.speeds, sample.wind, rates)
        expected = accelerations(parameters, sample.state, sample.speeds, pairs, torque, parts(effects))
        assert_close(found[6:12], expected)
        assert_close(found[12:], rates)
        np.testing.assert_array_equal(found[:6], without[:6])
        moved = max(moved, np.abs(found[6:12] - without[6:12]).max())
    assert moved > 0.1, "the effect must have done something"


def test_effects_with_default_parameters_do_nothing(asymmetric_vehicle):
    effects = Effects(BodyDrag(), RotorAerodynamics())
    vehicle, context = continuous(asymmetric_vehicle, effects)
    bare, bare_context = continuous(asymmetric_vehicle, Effects())
    for sample in samples(20, seed=5):
        assert_close(slope(vehicle, context, sample), slope(bare, bare_context, sample))


def test_an_effect_without_parameters_is_rejected():
    with pytest.raises(ValueError, match="the effect body_drag has no parameters"):
        Quadrotor(
            effects=("ground_effect", "body_drag"), numbers=QuadrotorNumbers(effects=Effects(ground_effect=GROUND))
        )


@pytest.mark.parametrize("name", ["body drag", "rotor aerodynamics"])
def test_drag_only_dissipates_in_still_air(asymmetric_vehicle, name):
    """The forces act at the centre of mass, so they do no work on the rotation. Lift is zero, since it needs power."""
    drag = DRAG._replace(centre_of_pressure=CentreOfPressure())
    effects = Effects(body_drag=drag) if name == "body drag" else Effects(rotor_aerodynamics=ROTORS._replace(lift=0.0))
    vehicle, context = continuous(asymmetric_vehicle, effects)
    bare, bare_context = continuous(asymmetric_vehicle, Effects())
    for sample in samples(100, seed=2):
        sample.wind = np.zeros(3)
        change = slope(vehicle, context, sample)[6:9] - slope(bare, bare_context, sample)[6:9]
        assert change @ sample.state[6:9] < 0.0


def test_a_vehicle_that_moves_with_the_air_has_no_air_load(asymmetric_vehicle):
    vehicle, context = continuous(asymmetric_vehicle, Effects(DRAG, ROTORS))
    bare, bare_context = continuous(asymmetric_vehicle, Effects())
    for sample in samples(5, seed=3):
        sample.wind = sample.state[6:9]
        assert_close(slope(vehicle, context, sample), slope(bare, bare_context, sample))


def test_equal_body_drag_on_all_axes_is_isotropic_drag(asymmetric_vehicle):
    c_1, c_2 = 0.31, 0.07
    drag = BodyDrag(LinearDrag(c_1, c_1, c_1), QuadraticDrag(c_2, c_2, c_2))
    none = asymmetric_vehicle._replace(linear_drag=0.0, quadratic_drag=0.0)
    vehicle, context = continuous(none, Effects(body_drag=drag))
    isotropic = asymmetric_vehicle._replace(linear_drag=c_1, quadratic_drag=c_2)
    other, other_context = continuous(isotropic, Effects())
    for sample in samples(20, seed=4):
        assert_close(slope(vehicle, context, sample), slope(other, other_context, sample))


def test_ground_effect_has_the_ratio_of_cheeseman_and_bennett():
    """The ratio is 16/15 at the height R and 64/63 at 2 R. It decays as 1 / z² and is limited below R / 2."""
    ground = GroundEffect(rotor_radius=0.2, ground_height=1.0)
    assert ground_effect(1.2, ground) == pytest.approx(16.0 / 15.0, rel=1e-14)
    assert ground_effect(1.4, ground) == pytest.approx(64.0 / 63.0, rel=1e-14)
    assert (ground_effect(101.0, ground) - 1.0) / (ground_effect(201.0, ground) - 1.0) == pytest.approx(4.0, rel=1e-5)
    for height in (1.1, 1.05, 1.0, 0.0, -50.0):
        assert ground_effect(height, ground) == pytest.approx(4.0 / 3.0, rel=1e-14)
    assert ground_effect(1.1001, ground) < 4.0 / 3.0 - 1e-4


def applied(plant, context, body, R_WB, pairs, torque):
    """Apply forces and a torque, both given in B, to a body."""
    force = ExternallyAppliedSpatialForce()
    force.body_index, force.p_BoBq_B = body.index(), np.zeros(3)
    total = sum(force for _, force in pairs)
    about = torque + sum(np.cross(place, each) for place, each in pairs)
    force.F_Bq_W = SpatialForce(R_WB @ about, R_WB @ total)
    plant.get_applied_spatial_force_input_port().FixValue(context, Value[list[ExternallyAppliedSpatialForce]]([force]))


def test_a_payload_agrees_with_a_multibody_plant(asymmetric_vehicle):
    parameters = asymmetric_vehicle._replace(rotor_inertia=0.0)
    plant = MultibodyPlant(time_step=0.0)
    inertia = UnitInertia(*(np.array(parameters.inertia) / parameters.mass))
    body = plant.AddRigidBody("vehicle", SpatialInertia(parameters.mass, np.zeros(3), inertia))
    carried = UnitInertia(*(np.array(PAYLOAD.inertia) / PAYLOAD.mass))
    load = plant.AddRigidBody("payload", SpatialInertia(PAYLOAD.mass, np.zeros(3), carried))
    plant.WeldFrames(body.body_frame(), load.body_frame(), RigidTransform(np.array(PAYLOAD.position)))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -parameters.gravity])
    plant.Finalize()
    context = plant.CreateDefaultContext()
    effects = Effects(DRAG, ROTORS, payload=PAYLOAD)
    vehicle, ours = continuous(parameters, effects)
    forces = Forces(parameters, effects)
    for sample in samples(50, seed=5):
        R_WB = RollPitchYaw(sample.state[3:6]).ToRotationMatrix()
        plant.SetFreeBodyPose(context, body, RigidTransform(R_WB, sample.state[:3]))
        w_W = R_WB @ sample.state[9:12]
        plant.SetFreeBodySpatialVelocity(context, body, SpatialVelocity(w_W, sample.state[6:9]))
        applied(plant, context, body, R_WB, *forces.at(sample.state, sample.speeds, sample.wind, np.zeros(4)))
        acceleration = plant.EvalBodySpatialAccelerationInWorld(context, body)
        found = slope(vehicle, ours, sample)
        assert_close(found[6:9], acceleration.translational(), 1e-11)
        assert_close(found[9:12], R_WB.inverse() @ acceleration.rotational(), 1e-11)


SLUNG = SlungLoad(mass=0.17, length=0.8)


@pytest.fixture(scope="module")
def pendulum(asymmetric_vehicle):
    """Return a plant of a vehicle with a load: coordinates are x, y, z, then roll, pitch, yaw, then the rod's."""
    parameters = asymmetric_vehicle
    plant = MultibodyPlant(time_step=0.0)
    below = plant.world_body()
    nothing = SpatialInertia.Zero()
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        carriage = plant.AddRigidBody(name, nothing)
        plant.AddJoint(PrismaticJoint(name, below.body_frame(), carriage.body_frame(), axis))
        below = carriage
    inertia = UnitInertia(*(np.array(parameters.inertia) / parameters.mass))
    body = plant.AddRigidBody("vehicle", SpatialInertia(parameters.mass, np.zeros(3), inertia))
    ball = plant.AddJoint(BallRpyJoint("ball", below.body_frame(), body.body_frame()))
    square = SLUNG.length**2
    point = SpatialInertia(SLUNG.mass, [0.0, 0.0, -SLUNG.length], UnitInertia(square, square, 0.0))
    load = plant.AddRigidBody("load", point)
    rod = plant.AddJoint(UniversalJoint("rod", below.body_frame(), load.body_frame()))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -parameters.gravity])
    plant.Finalize()
    return plant, body, ball, rod


def test_a_slung_load_agrees_with_a_multibody_plant(asymmetric_vehicle, pendulum):
    plant, body, ball, rod = pendulum
    parameters = asymmetric_vehicle._replace(rotor_inertia=0.0)
    context = plant.CreateDefaultContext()
    effects = Effects(DRAG, ROTORS, GROUND, slung_load=SLUNG)
    vehicle, ours = continuous(parameters, effects)
    forces = Forces(parameters, effects)
    rng = np.random.default_rng(6)
    for sample in samples(50, seed=6):
        swing = Swing(*rng.uniform(-1.2, 1.2, 2), *rng.normal(size=2))
        for i, name in enumerate("xyz"):
            joint = plant.GetJointByName(name)
            joint.set_translation(context, sample.state[i])
            joint.set_translation_rate(context, sample.state[6 + i])
        R_WB = RollPitchYaw(sample.state[3:6]).ToRotationMatrix()
        ball.set_angles(context, sample.state[3:6])
        ball.set_angular_velocity(context, R_WB @ sample.state[9:12])
        rod.set_angles(context, swing[:2])
        rod.set_angular_rates(context, swing[2:])
        applied(plant, context, body, R_WB, *forces.at(sample.state, sample.speeds, sample.wind, np.zeros(4)))
        rates = plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :]
        acceleration = plant.EvalBodySpatialAccelerationInWorld(context, body)
        found = slope(vehicle, ours, sample, swing)
        assert_close(found[6:9], acceleration.translational(), 1e-10)
        assert_close(found[9:12], R_WB.inverse() @ acceleration.rotational(), 1e-10)
        assert_close(found[16:18], swing[2:])
        assert_close(found[18:20], rates[rod.velocity_start() : rod.velocity_start() + 2], 1e-10)


def load_velocity(state, swing):
    """Return the velocity of the load in W, from the derivative of the rod's direction."""
    a, b, da, db = swing
    along_a = np.array([0.0, math.cos(a) * math.cos(b), math.sin(a) * math.cos(b)])
    along_b = np.array([-math.cos(b), -math.sin(a) * math.sin(b), math.cos(a) * math.sin(b)])
    return state[6:9] + SLUNG.length * (da * along_a + db * along_b)


def test_the_energy_of_a_swinging_load_changes_by_the_work_of_the_rotors(asymmetric_vehicle):
    """With steps of 0.5 ms the error is below 1e-7 J after one second of swinging by 0.5 rad."""
    parameters = asymmetric_vehicle._replace(linear_drag=0.0, quadratic_drag=0.0, rotor_time_constant=1e-3)
    effects = Effects(slung_load=SLUNG)
    h, steps = 5e-4, 2000
    numbers = QuadrotorNumbers(parameters, start=Place(z=2.0), effects=effects)
    vehicle = Quadrotor(time_step=h, effects=effects.names, numbers=numbers)
    context = vehicle.CreateDefaultContext()
    swing = Swing(0.5, -0.3, 0.4, 0.6)
    vehicle.set_state(context, "swing", swing)
    speeds = np.array(vehicle.get_state(context, "rotor_speed"))
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, speeds)

    def energy():
        state, load = np.array(vehicle.get_state(context, "state")), vehicle.get_state(context, "swing")
        velocity = load_velocity(state, load)
        height = state[2] - SLUNG.length * math.cos(load.roll) * math.cos(load.pitch)
        kinetic = parameters.mass * state[6:9] @ state[6:9] + SLUNG.mass * velocity @ velocity
        turning = state[9:12] @ (np.array(parameters.inertia) * state[9:12])
        weight = parameters.mass * state[2] + SLUNG.mass * height
        return 0.5 * (kinetic + turning) + parameters.gravity * weight

    simulator = Simulator(vehicle, context)
    thrust = np.array(parameters.rotors.thrust_factors) @ speeds**2
    before, work, last = energy(), 0.0, 0.0
    state_before = np.array(vehicle.get_state(context, "state"))
    for step in range(1, steps + 1):
        simulator.AdvanceTo(step * h)
        simulator.AdvancePendingEvents()
        state = np.array(vehicle.get_state(context, "state"))
        last = abs(vehicle.get_state(context, "swing").roll - 0.5)
        # The body does not rotate, so the thrust's work is its force times the displacement.
        work += thrust * rotation(*state[3:6])[:, 2] @ (state[:3] - state_before[:3])
        state_before = state
    assert last > 0.3
    np.testing.assert_allclose(state[3:6], 0.0, atol=1e-9)
    assert energy() - before == pytest.approx(work, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [EFFECTS["all"], EFFECTS["all"]._replace(payload=None, slung_load=SLUNG), EFFECTS["ground effect"]],
    ids=["payload", "slung load", "ground effect"],
)
def test_steps_with_effects_are_of_fourth_order(asymmetric_vehicle, effects):
    """At half the time step the error after 0.2 s is a sixteenth."""
    command, wind = np.array([205.0, 190.0, 200.0, 215.0]), [2.0, -1.0, 0.5]

    def end(time_step):
        numbers = QuadrotorNumbers(asymmetric_vehicle, start=Place(z=-0.25), effects=effects)
        vehicle = Quadrotor(time_step=time_step, effects=effects.names, numbers=numbers)
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

    exact = end(0.0)
    coarse, fine = (np.abs(end(step) - exact).max() for step in (0.02, 0.01))
    assert 1e-9 < fine < 1e-4
    assert coarse / fine == pytest.approx(16.0, rel=0.25)
