"""Tests of cascades of PIDs: comparison with PX4's equations in PX4's frames and units, and flights."""

import math

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike
from pydrake.systems.analysis import Simulator
from scipy.spatial.transform import Rotation

from drake_quad import InputError, load_scenario, simulate
from drake_quad.assembly.control import control_setting
from drake_quad.control.pid_cascade.acceleration import acceleration_target, saturate_velocity_sum
from drake_quad.control.pid_cascade.parameters import (
    AccelerationParameters,
    CascadeParameters,
    CascadeRules,
    PidLoopGains,
    TiltParameters,
    empty_memory,
)
from drake_quad.control.pid_cascade.system import PidCascade
from drake_quad.control.pid_cascade.tilt import tilt_target
from drake_quad.flight.mission import plan_route
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.linear.closed_loop import closed_loop, loop_with_injection
from drake_quad.linear.link_margins import link_margins
from drake_quad.pid.filters import first_order
from drake_quad.pid.loop import Derivative, Integral, Terms
from drake_quad.scenario.batch import Batch
from drake_quad.signals import Attitude, Reference, State
from drake_quad.vehicle.autopilot import rotation_error
from drake_quad.vehicle.parameters import QuadrotorParameters

MASS = 1.3  # kg
GRAVITY = 9.80665  # m/s²
HOVER_THRUST = 0.45  # normalised thrust in hover
WEIGHT = MASS * GRAVITY  # N
PERIOD = 0.01  # s, control period
K_P_POSITION = np.array([0.95, 0.95, 1.0])  # 1/s
K_P = np.array([1.8, 1.8, 4.0])  # 1/s, velocity loop
K_I = np.array([0.4, 0.4, 2.0])  # 1/s², velocity loop
K_D = np.array([0.2, 0.2, 0.1])  # dimensionless, velocity loop
MAX_HORIZONTAL_UP_DOWN_SPEEDS = (2.0, 1.0, 0.7)  # m/s: horizontal, up, down
MAX_TILT = 0.6  # rad
THRUST_LIMITS = (0.12, 0.9)  # normalised
HORIZONTAL_MARGIN = 0.3  # normalised thrust
DERIVATIVE_BANDWIDTH = 31.0  # rad/s, bandwidth of the derivative filter
W_TO_NED = np.diag([1.0, -1.0, -1.0])  # rotation matrix
CRAZYFLIE_SCENARIO = ["vehicles/crazyflie", "controllers/crazyflie"]
PX4_CONTROL = {
    "control": {
        "kind": "pid_cascade",
        "position": {"k_p": [0.95, 0.95, 1.0]},
        "velocity": {"k_p": [1.8, 1.8, 4.0], "k_i": [0.4, 0.4, 2.0], "k_d": [0.2, 0.2, 0.0]},
        "command": {"kind": "acceleration"},
    }
}


def cascade_numbers():
    terms = [
        Terms(Integral(i, limit), Derivative(d, first_order(DERIVATIVE_BANDWIDTH, PERIOD)))
        for i, d, limit in zip(K_I, K_D, (1e3, 1e3, GRAVITY))
    ]
    unit = WEIGHT / HOVER_THRUST
    return CascadeParameters(
        PidLoopGains(PerAxis(*K_P_POSITION)),
        PidLoopGains(PerAxis(*K_P), tuple(terms)),
        1.0,
        MASS,
        GRAVITY,
        AccelerationParameters(
            1.0,
            *MAX_HORIZONTAL_UP_DOWN_SPEEDS,
            math.tan(MAX_TILT),
            *(unit * fraction for fraction in THRUST_LIMITS),
            unit * HORIZONTAL_MARGIN,
        ),
    )


class Px4:
    """PositionControl of PX4 in its axes (north, east, down), with normalised thrust."""

    def __init__(self):
        self.integral, self.before, self.rate = np.zeros(3), None, np.zeros(3)

    def update(self, position, velocity, target, fed_velocity, acceleration, *, decoupled):
        if self.before is not None:
            fraction = DERIVATIVE_BANDWIDTH * PERIOD / (1.0 + DERIVATIVE_BANDWIDTH * PERIOD)
            self.rate += fraction * ((velocity - self.before) / PERIOD - self.rate)
        self.before = velocity
        first = (target - position) * K_P_POSITION
        setpoint = np.array([*self.limited_sum(first[:2], fed_velocity[:2]), first[2] + fed_velocity[2]])
        setpoint[2] = np.clip(setpoint[2], -MAX_HORIZONTAL_UP_DOWN_SPEEDS[1], MAX_HORIZONTAL_UP_DOWN_SPEEDS[2])
        error = setpoint - velocity
        demanded = acceleration + error * K_P + self.integral - self.rate * K_D
        down = np.array([-demanded[0], -demanded[1], GRAVITY - (0.0 if decoupled else demanded[2])])
        axis = down / np.linalg.norm(down)
        if math.acos(axis[2]) > MAX_TILT:
            level = axis[:2] / np.linalg.norm(axis[:2])
            axis = np.array([*(math.sin(MAX_TILT) * level), math.cos(MAX_TILT)])
        collective = min((demanded[2] * HOVER_THRUST / GRAVITY - HOVER_THRUST) / axis[2], -THRUST_LIMITS[0])
        thrust = axis * collective
        remaining = error.copy()
        if (thrust[2] >= -THRUST_LIMITS[0] and error[2] >= 0.0) or (thrust[2] <= -THRUST_LIMITS[1] and error[2] <= 0.0):
            remaining[2] = 0.0
        sideways = np.linalg.norm(thrust[:2])
        thrust[2] = max(thrust[2], -math.sqrt(THRUST_LIMITS[1] ** 2 - min(sideways, HORIZONTAL_MARGIN) ** 2))
        max_sideways = math.sqrt(max(THRUST_LIMITS[1] ** 2 - thrust[2] ** 2, 0.0))
        if sideways > max_sideways:
            thrust[:2] *= max_sideways / sideways
        produced = thrust[:2] * GRAVITY / HOVER_THRUST
        if demanded[:2] @ demanded[:2] > produced @ produced:
            remaining[:2] -= 2.0 / K_P[0] * (demanded[:2] - produced)
        self.integral += remaining * K_I * PERIOD
        self.integral[2] = np.clip(self.integral[2], -GRAVITY, GRAVITY)
        return thrust

    @staticmethod
    def limited_sum(first, second):
        """Return the sum of two velocities, with the second one shortened if the sum exceeds the largest speed."""
        if np.linalg.norm(first + second) <= MAX_HORIZONTAL_UP_DOWN_SPEEDS[0]:
            return first + second
        size = np.linalg.norm(first)
        if size >= MAX_HORIZONTAL_UP_DOWN_SPEEDS[0]:
            return first / size * MAX_HORIZONTAL_UP_DOWN_SPEEDS[0]
        unit = second / np.linalg.norm(second)
        along = unit @ first
        return first + unit * (-along + math.sqrt(along**2 - size**2 + MAX_HORIZONTAL_UP_DOWN_SPEEDS[0] ** 2))


@pytest.mark.parametrize("decoupled", [True, False])
@pytest.mark.parametrize("size", [0.2, 1.0, 4.0])
def test_the_thrust_matches_px4_at_every_tick_within_and_beyond_limits(decoupled, size):
    rng, px4, memory = np.random.default_rng(5), Px4(), empty_memory(cascade_numbers())
    yaw = 0.7
    for tick in range(60):
        position, velocity, position_target, fed_velocity, acceleration = (
            size * rng.normal(size=(5, 3)) * np.array([[1, 1, 1]])
        )
        velocity = velocity + 0.1 * tick
        thrust = px4.update(
            *(W_TO_NED @ vector for vector in (position, velocity, position_target, fed_velocity, acceleration)),
            decoupled=decoupled,
        )
        state = State(*position, 0.1, -0.2, 0.3, *velocity, 0.0, 0.0, 0.0)
        reference = Reference(*position_target, *fed_velocity, *acceleration, yaw, 0.4)
        target, memory = acceleration_target(
            state, reference, cascade_numbers(), memory, PERIOD, CascadeRules(decouples_vertical=decoupled)
        )
        attitude = Rotation.from_euler("ZYX", [target.yaw, target.pitch, target.roll])
        commanded_thrust = attitude.apply([0.0, 0.0, target.thrust]) * HOVER_THRUST / WEIGHT
        np.testing.assert_allclose(commanded_thrust, W_TO_NED @ thrust, rtol=1e-9, atol=1e-9)
        rates = Rotation.from_euler("ZYX", [0.3, -0.2, 0.1]).inv().apply([0.0, 0.0, 0.4])
        np.testing.assert_allclose(target[4:], rates, atol=1e-12)
        integrals = [each.integral for each in memory.velocity]
        np.testing.assert_allclose(integrals, W_TO_NED @ px4.integral, rtol=1e-8, atol=1e-9)


def quaternion_error(attitude, target, weight):
    """Return the attitude error of PX4's AttitudeControl, computed with SciPy's rotations."""
    q, desired = (Rotation.from_euler("ZYX", [yaw, pitch, roll]) for roll, pitch, yaw in (attitude, target))
    axis_now, axis_then = q.apply([0.0, 0.0, 1.0]), desired.apply([0.0, 0.0, 1.0])
    axis, angle = np.cross(axis_now, axis_then), math.acos(np.clip(axis_now @ axis_then, -1.0, 1.0))
    tilt = Rotation.from_rotvec(angle * axis / max(np.linalg.norm(axis), 1e-30))
    reduced = tilt * q
    turn = (reduced.inv() * desired).as_rotvec()
    np.testing.assert_allclose(turn[:2], 0.0, atol=1e-7)
    error = (q.inv() * reduced * Rotation.from_rotvec(weight * turn)).as_quat()
    return 2.0 * error[:3] * np.sign(error[3])


def test_the_rotation_error_matches_px4():
    rng = np.random.default_rng(3)
    for _ in range(100):
        attitude, target = rng.uniform(-1.0, 1.0, (2, 3)) * [1.2, 1.2, 3.1]
        error = rotation_error(Attitude(*attitude), Attitude(*target), 0.4)
        expected = quaternion_error(attitude, target, 0.4)
        np.testing.assert_allclose(error, expected / [1.0, 1.0, 0.4], rtol=1e-6, atol=1e-6)


def test_a_saturated_sum_of_two_velocities_reduces_the_second_velocity_first():
    rng = np.random.default_rng(2)
    for first, second in rng.normal(size=(200, 2, 2)) * 2.0:
        velocity = np.array(saturate_velocity_sum(tuple(first), tuple(second), 2.0))
        np.testing.assert_allclose(velocity, Px4.limited_sum(first, second), atol=1e-9)
        assert np.linalg.norm(velocity) <= 2.0 + 1e-9
    assert saturate_velocity_sum((3.0, 0.0), (0.0, 0.0), 2.0) == pytest.approx((2.0, 0.0))
    assert saturate_velocity_sum((0.0, 0.0), (0.0, -3.0), 2.0) == pytest.approx((0.0, -2.0))
    assert saturate_velocity_sum((0.0, 0.0), (0.0, 0.0), 2.0) == pytest.approx((0.0, 0.0))


def test_tilt_commands_are_relative_to_the_heading():
    """A vehicle that faces Y, and whose reference is 0.1 m ahead along X, rolls to the right."""
    tilting = CascadeParameters(
        PidLoopGains(PerAxis(2.0, 2.0, 2.0)),
        PidLoopGains(PerAxis(0.4, 0.5, 5.0)),
        0.5,
        MASS,
        GRAVITY,
        TiltParameters(0.9 * WEIGHT, 0.2 * WEIGHT, 1.5 * WEIGHT),
    )
    state = State(-0.1, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi, *[0.0] * 6)
    reference = Reference(0.0, 0.0, 1.02, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5 * math.pi, 9.0)
    target, _ = tilt_target(state, reference, tilting, empty_memory(tilting), PERIOD, CascadeRules())
    assert target.roll == pytest.approx(0.5 * (2.0 * 0.1 + 0.5 * 0.2))
    assert target.pitch == pytest.approx(0.0, abs=1e-12)
    assert target.thrust == pytest.approx(0.9 * WEIGHT + MASS * 5.0 * 2.0 * 0.02)
    assert target[3:] == (0.5 * math.pi, 0.0, 0.0, 0.0)


def test_the_attitude_target_is_held_between_the_ticks_of_the_loops():
    scenario = load_scenario("laboratory:nominal", layers=CRAZYFLIE_SCENARIO)
    recipe = scenario.control.recipes(control_setting(scenario, plan_route(scenario)))["cascade"]
    assert recipe.structure["num_ticks"] == 5
    cascade = recipe.build(1)
    simulator = Simulator(cascade)
    context, thrusts = simulator.get_mutable_context(), []
    cascade.GetInputPort("reference").FixValue(context, np.zeros(11))
    for tick in range(12):
        measurement = np.zeros(12)
        measurement[8] = -0.01 * tick
        cascade.GetInputPort("measurement").FixValue(context, measurement)
        simulator.AdvanceTo(0.002 * tick)
        thrusts.append(cascade.GetOutputPort("attitude_target").Eval(context)[0])
        simulator.AdvanceTo(0.002 * tick + 0.001)
    changed = np.flatnonzero(np.diff(thrusts)) + 1
    np.testing.assert_array_equal(changed, [5, 10])


@pytest.mark.long
@pytest.mark.parametrize(
    ("scenario", "layers", "overrides"),
    [
        (
            "laboratory:low_wind",
            CRAZYFLIE_SCENARIO,
            {"vehicle.trim_force": {"x": {"normal": {"mean": 0.01, "standard_deviation": 0.003}}}},
        ),
        ("onboard", [], {**PX4_CONTROL, "control.velocity.k_i": [{"uniform": {"min": 0.3, "max": 0.5}}, 0.4, 2.0]}),
    ],
)
def test_cascades_fly_equally_compiled_uncompiled_and_in_fleets(scenario, layers, overrides):
    loaded = load_scenario(scenario, {"duration": 1.0, **overrides}, layers=layers)
    assert_flown_alike(Batch.draw(loaded, range(2)))


@pytest.mark.long
def test_an_integral_removes_the_error_that_a_trim_force_causes():
    """The integral balances the trim force F. Without it, the error is F / m divided by both proportional gains."""
    hover = {"route": {"kind": "hover", "position": [0, 0, 1]}, "duration": 40.0, "vehicle.trim_force": {"x": 0.2}}
    hover |= {"vehicle.linear_drag": 0.0}
    noise_free = {"laboratory.motion_capture": {"position_noise": 0.0, "attitude_noise": 0.0}}
    noise_free |= {"laboratory.autopilot": {"gyroscope_noise": 0.0, "gyroscope_bias": [0, 0, 0]}}
    errors = []
    for k_i in ([0.4, 0.4, 2.0], [0.0, 0.0, 0.0]):
        flight = simulate(load_scenario("onboard", {**PX4_CONTROL, **hover, **noise_free, "control.velocity.k_i": k_i}))
        errors.append(flight.record("state").x[-1])
    mass = flight.scenario.nominal.mass
    assert errors[0] == pytest.approx(0.0, abs=2e-3)
    assert errors[1] == pytest.approx(0.2 / (mass * 1.8 * 0.95), rel=0.02)


@pytest.mark.slow
def test_the_linear_model_has_the_period_of_a_cascade_that_is_slower_than_the_ticks():
    scenario = load_scenario("laboratory:nominal", layers=CRAZYFLIE_SCENARIO)
    loop = closed_loop(scenario)
    assert loop.system.period == pytest.approx(0.01)
    assert 0.99 < max(abs(loop.system.poles())) < 1.0
    offsets = loop_with_injection(scenario).system
    assert offsets.inputs[-1].endswith("@4")  # five ticks of 2 ms
    np.testing.assert_allclose(offsets.A, loop.system.A, atol=1e-9)
    assert link_margins(scenario)["roll"].disk > 0.3


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            {"laboratory.autopilot": {"kind": "none"}},
            "autopilot.kind is 'none', but must be a kind that controls the attitude",
        ),
        ({"control.period": 0.03}, "control.period is 0.03, but must be a multiple of the period of the command link"),
        ({"control.velocity.limit": [1.0, 1.0, 1.0]}, "velocity.limit .* must be left out, since the command itself"),
        (
            {"control.velocity.k_p": [0.0, 1.0, 1.0]},
            r"velocity.k_p.0 is 0.0, but must be larger than 0, since the anti-windup",
        ),
        ({"control.velocity.integration": "backward_euler"}, "velocity.integration .* must be forward_euler"),
        (
            {"laboratory.autopilot": {"yaw_weight": 0.4, "attitude_terms": {"k_i": [1, 1, 1]}}},
            "attitude_terms .* must be left out, since an attitude loop with yaw_weight is proportional",
        ),
    ],
)
def test_inconsistent_settings_of_a_cascade_are_refused(overrides, message):
    with pytest.raises(InputError, match=message):
        load_scenario("onboard", {**PX4_CONTROL, **overrides})


def test_parameters_and_rules_of_a_cascade_follow_the_scenario():
    command = {"kind": "acceleration", "feed_forward": 0.6, "max_speed": 2.5, "max_ascent": 1.5, "max_descent": 0.8}
    command |= {"max_tilt": 0.5, "min_thrust": 0.2, "max_thrust": 1.7, "horizontal_margin": 0.4}
    scenario = load_scenario(
        "onboard",
        {
            **PX4_CONTROL,
            "control.command": {**command, "decouples_vertical": False},
            "control.velocity_feed_forward": 0.7,
            "control.position.k_i": [0.1, 0.0, 0.2],
            "control.position.integration": "backward_euler",
        },
    )
    structure, parameters = scenario.control.recipes(control_setting(scenario, plan_route(scenario)))["cascade"][1:]
    weight = parameters.mass * parameters.gravity
    assert structure["rules"] == CascadeRules(True, False, False)
    expected = AccelerationParameters(0.6, 2.5, 1.5, 0.8, math.tan(0.5), 0.2 * weight, 1.7 * weight, 0.4 * weight)
    assert parameters.command == pytest.approx(expected)
    assert parameters.velocity_feed_forward == 0.7
    assert [terms.integral is None for terms in parameters.position.terms] == [False, True, False]
    assert parameters.position.terms[0].integral == (0.1, math.inf, None)
    assert scenario.control.limits().max_tilt == 0.5


def test_an_autopilot_with_commanded_body_rates_has_no_attitude_error():
    autopilot = load_scenario("onboard", ["laboratory.autopilot.yaw_weight=0.4"]).laboratory.autopilot
    for follows, weight in ((True, 0.4), (False, None)):
        options = {"settings": autopilot, "follows_attitude": follows, "curve": None}
        recipe = autopilot.recipes(QuadrotorParameters(), **options)["autopilot"]
        assert recipe.parameters.yaw_weight == weight


def test_a_cascade_without_memory_has_no_state():
    assert not PidCascade(parameters=cascade_numbers()._replace(velocity=PidLoopGains(PerAxis(*K_P)))).states
