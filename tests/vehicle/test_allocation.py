import numpy as np
import pytest
import scipy
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from drake_quad.framework.wiring import split_output
from drake_quad.signals import RotorSpeed, Wrench
from drake_quad.vehicle.allocation import Allocation, RotorModel, allocate, allocate_to_pairs
from drake_quad.vehicle.authority import hover_flaw, missing_direction
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.rotors import Rotor, Rotors

TABLE_I = QuadrotorParameters()
ROTORS = RotorModel.of(TABLE_I)
TOP_THRUST = 4.0 * 4.13e-5 * 300.0**2
BOTTOM_THRUST = 4.0 * 4.13e-5 * 60.0**2

wrenches = st.builds(Wrench, st.floats(-20.0, 40.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.5, 0.5))
rotor_speeds = st.builds(RotorSpeed, *[st.floats(60.0, 300.0)] * 4)


both_ways = pytest.mark.parametrize("allocate", [allocate, allocate_to_pairs])


@both_ways
@given(rotor_speed=rotor_speeds)
def test_inverts_eq_5_within_the_limits(allocate, rotor_speed):
    speeds, shortfall = allocate(rotor_action(rotor_speed, TABLE_I).wrench, ROTORS)
    # At the very limits rounding may call for a trace of saturation.
    np.testing.assert_allclose(speeds, rotor_speed, rtol=1e-9)
    np.testing.assert_allclose(shortfall, 0.0, atol=1e-9)


@both_ways
@given(wrench=wrenches)
def test_speeds_are_within_the_limits_and_shortfall_is_what_is_missing(allocate, wrench):
    speeds, shortfall = allocate(wrench, ROTORS)
    assert np.all(np.array(speeds) >= 60.0 * (1.0 - 1e-12))
    assert np.all(np.array(speeds) <= 300.0 * (1.0 + 1e-12))
    np.testing.assert_allclose(np.subtract(wrench, shortfall), rotor_action(speeds, TABLE_I).wrench, atol=1e-9)


@pytest.mark.slow
@both_ways
@given(wrench=wrenches)
# Room for so much yaw that roll or pitch, at 40 % and at 60 % of the way up, could go further than both its rotors.
@example(wrench=Wrench(0.6 * BOTTOM_THRUST + 0.4 * TOP_THRUST, 0.0, 2.0, 0.5))
@example(wrench=Wrench(0.4 * BOTTOM_THRUST + 0.6 * TOP_THRUST, 0.0, -2.0, -0.5))
@example(wrench=Wrench(0.6 * BOTTOM_THRUST + 0.4 * TOP_THRUST, -2.0, 0.0, -0.5))
@example(wrench=Wrench(0.4 * BOTTOM_THRUST + 0.6 * TOP_THRUST, 2.0, 0.0, 0.5))
@settings(max_examples=200, deadline=None)
def test_gives_up_yaw_first_then_roll_and_pitch_and_thrust_last(allocate, wrench):
    """Against a linear program for each priority in turn: thrust, then the share of roll and pitch, then yaw."""
    _, shortfall = allocate(wrench, ROTORS)
    b, d, lever = 4.13e-5, 8.5e-7, 2.0 * 0.17 * 4.13e-5
    thrust = np.clip(wrench.thrust, BOTTOM_THRUST, TOP_THRUST)
    assert wrench.thrust - shortfall.thrust == pytest.approx(thrust, abs=1e-9)
    level, roll, pitch, yaw = thrust / (4.0 * b), wrench.tau_x / lever, wrench.tau_y / lever, wrench.tau_z / (4.0 * d)
    # Squared rotor speeds, in units of the largest, are level + rows @ (share of roll and pitch, share of yaw).
    unit = 300.0**2
    rows = np.array([[-pitch, yaw], [-roll, -yaw], [pitch, yaw], [roll, -yaw]]) / unit
    limits = np.concatenate([np.full(4, unit - level), np.full(4, level - 60.0**2)]) / unit
    both = np.vstack([rows, -rows])
    share = scipy.optimize.linprog([-1.0, 0.0], A_ub=both, b_ub=limits, bounds=[(0, 1), (0, 1)]).x[0]
    kept = scipy.optimize.linprog(
        [0.0, -1.0], A_ub=both, b_ub=limits + 1e-9, bounds=[(max(share - 1e-9, 0.0), share), (0, 1)]
    ).x[1]
    expected = Wrench(thrust, share * wrench.tau_x, share * wrench.tau_y, kept * wrench.tau_z)
    np.testing.assert_allclose(np.subtract(wrench, shortfall), expected, atol=1e-6)


def random_layout(rng):
    """Four uneven rotors that can hover, some of them on their own side of the vehicle, and their limits."""
    while True:
        angles = np.array([0.0, -0.5, -1.0, -1.5]) * np.pi + rng.uniform(-0.4, 0.4, 4) + rng.uniform(-np.pi, np.pi)
        arms = rng.uniform(0.08, 0.3, 4)
        turns = (-1.0, 1.0, -1.0, 1.0) if rng.uniform() < 0.7 else rng.choice([-1.0, 1.0], 4)
        rotors = Rotors(
            *(
                Rotor(arm * np.cos(angle), arm * np.sin(angle), z, turn, b, d)
                for arm, angle, z, turn, b, d in zip(
                    arms, angles, rng.normal(size=4), turns, rng.uniform(2e-5, 6e-5, 4), rng.uniform(4e-7, 1e-6, 4)
                )
            )
        )
        if not missing_direction(rotors) and not hover_flaw(rotors, min_speed=60.0, max_speed=300.0):
            return rotors


@pytest.mark.slow
def test_priorities_of_any_layout_against_linear_programs():
    """Thrust without torque first, then the share of roll and pitch, then yaw; eq (5) written anew as a matrix."""
    rng = np.random.default_rng(5)
    cut = np.zeros(3)
    for _ in range(400):
        rotors = random_layout(rng)
        x, y, _, turns, b, d = np.array(rotors).T
        forward = np.array([b, y * b, -x * b, -turns * d])
        # Any wrench within the limits, and then too much of it.
        middle = forward @ rng.uniform(60.0**2, 300.0**2, 4)
        wrench = Wrench(*(middle * np.array([1.0, *rng.uniform(0.0, 6.0, 2), rng.uniform(0.0, 6.0)])).tolist())
        found, shortfall = allocate(wrench, RotorModel.of(QuadrotorParameters(rotors=rotors)))
        # Squared speeds, in units of the largest, are inverse @ wrench; everything is linear in the three unknowns.
        inverse = np.linalg.inv(forward) / 300.0**2
        low, high = (60.0 / 300.0) ** 2, 1.0
        tilt, yaw = inverse @ [0.0, wrench.tau_x, wrench.tau_y, 0.0], inverse[:, 3] * wrench.tau_z
        least = max(low / inverse[:, 0])
        most = min(high / inverse[:, 0])
        thrust = np.clip(wrench.thrust, least, most)
        level = inverse[:, 0] * thrust
        rows = np.column_stack([tilt, yaw])
        both, limits = np.vstack([rows, -rows]), np.concatenate([high - level, level - low])
        share = scipy.optimize.linprog([-1.0, 0.0], A_ub=both, b_ub=limits, bounds=[(0, 1), (0, 1)]).x[0]
        slack = limits + 1e-9
        kept = scipy.optimize.linprog(
            [0.0, -1.0], A_ub=both, b_ub=slack, bounds=[(max(share - 1e-9, 0.0), share), (0, 1)]
        ).x[1]
        expected = Wrench(thrust, share * wrench.tau_x, share * wrench.tau_y, kept * wrench.tau_z)
        np.testing.assert_allclose(np.subtract(wrench, shortfall), expected, atol=2e-6)
        np.testing.assert_allclose(forward @ np.square(found), np.subtract(wrench, shortfall), atol=1e-9)
        cut += [thrust != wrench.thrust, share < 1.0, kept < 1.0]
    assert (cut > 20).all(), "something of each kind must be given up for this to mean anything"


@given(
    wrench=wrenches,
    shape=st.sampled_from([Rotors.plus, Rotors.x]),
    length=st.floats(0.05, 1.0),
    width=st.floats(0.05, 1.0),
    direction=st.sampled_from([-1.0, 1.0]),
)
def test_pairs_are_allocated_as_any_rotors_are(wrench, shape, length, width, direction):
    rotors = shape(length=length, width=width, rotor_1_direction=direction)
    model = RotorModel.of(QuadrotorParameters(rotors=rotors))
    (speeds, shortfall), (other_speeds, other_shortfall) = allocate(wrench, model), allocate_to_pairs(wrench, model)
    np.testing.assert_allclose(np.square(speeds), np.square(other_speeds), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(shortfall, other_shortfall, rtol=0.0, atol=1e-9)


def test_a_rotor_that_yaw_does_not_move_leaves_yaw_to_the_others():
    model = RotorModel.of(QuadrotorParameters(rotors=Rotors.x(length=0.3, width=0.3)))
    still = model._replace(mixer=model.mixer._replace(rotor_1=model.mixer.rotor_1._replace(tau_z=0.0)))
    hover = model.mixer.rotor_1.thrust * 6.67
    speeds, shortfall = allocate(Wrench(6.67, 0.0, 0.0, 1.0), still)
    per_yaw = model.mixer.rotor_3.tau_z
    yaw = min((300.0**2 - hover) / per_yaw, (hover - 60.0**2) / per_yaw)
    assert shortfall == pytest.approx((0.0, 0.0, 0.0, 1.0 - yaw), abs=1e-12)
    expected = hover + yaw * per_yaw * np.array([0.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(np.square(speeds), expected, rtol=1e-12)


def test_a_rotor_without_room_leaves_alone_what_asks_nothing_of_it():
    """A weak rotor in front is at its limit first; roll is for the rotors beside it, which have room."""
    weak, *others = Rotors.plus()
    rotors = Rotors(weak._replace(thrust_factor=0.8 * 4.13e-5, drag_factor=0.8 * 8.5e-7), *others)
    model = RotorModel.of(QuadrotorParameters(rotors=rotors))
    speeds, shortfall = allocate(Wrench(20.0, 0.2, 0.0, 0.0), model)
    assert shortfall == pytest.approx((20.0 - 4.0 * 0.8 * 4.13e-5 * 300.0**2, 0.0, 0.0, 0.0), abs=1e-12)
    assert speeds.rotor_1 == pytest.approx(300.0)
    _, shortfall = allocate(Wrench(20.0, 0.0, -0.1, 0.0), model)
    assert shortfall.tau_y == pytest.approx(-0.1)


def test_a_yaw_torque_that_does_not_fit_leaves_roll_untouched():
    _, shortfall = allocate(Wrench(6.67, 0.3, 0.0, 0.3), ROTORS)
    assert shortfall == Wrench(0.0, 0.0, 0.0, shortfall.tau_z)
    assert 0.0 < shortfall.tau_z < 0.3


def test_fleet_and_single_vehicle_agree():
    rng = np.random.default_rng(0)
    wrench = np.array([rng.uniform(0, 15, 50), *rng.normal(size=(2, 50)), 0.1 * rng.normal(size=50)])
    fleet = Allocation(num_vehicles=50)
    context = fleet.CreateDefaultContext()
    fleet.get_input_port().FixValue(context, wrench.ravel())
    rows = fleet.get_output_port().Eval(context).reshape(8, 50)
    for i in range(50):
        speeds, shortfall = allocate(Wrench(*wrench[:, i].tolist()), ROTORS)
        np.testing.assert_allclose(rows[:, i], speeds + shortfall, rtol=1e-14, atol=1e-16)


def test_its_parts_come_out_under_their_names():
    builder = DiagramBuilder()
    for name, port in split_output(builder, "allocation", Allocation()).items():
        builder.ExportOutput(port, name)
    builder.ExportInput(builder.GetSubsystemByName("allocation").get_input_port(), "wrench")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("wrench").FixValue(context, [0.68 * 9.81, 0.0, 0.0, 0.0])
    speeds = diagram.GetOutputPort("rotor_speed_command").Eval(context)
    np.testing.assert_allclose(speeds, hover_rotor_speeds(TABLE_I))
    np.testing.assert_array_equal(diagram.GetOutputPort("shortfall").Eval(context), 0.0)


def test_what_little_room_is_left_is_given_whole():
    """Half of a squared rad/s below the top there is room for a tenth of it."""
    level, roll = 300.0**2 - 0.5, 0.1
    wrench = Wrench(4.0 * 4.13e-5 * level, 2.0 * 4.13e-5 * 0.17 * roll, 0.0, 0.0)
    speeds, shortfall = allocate(wrench, ROTORS)
    np.testing.assert_allclose(np.square(speeds), level + np.array([0.0, -roll, 0.0, roll]), atol=1e-6)
    np.testing.assert_allclose(shortfall, 0.0, atol=1e-12)


@both_ways
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_demand_that_is_small_is_held_to_what_little_room_there_is(allocate, sign):
    """A tenth of a squared rad/s below the top; of half of one, which roll asks for, a fifth fits."""
    level, roll = 300.0**2 - 0.1, sign * 0.5
    tau_x = 2.0 * 4.13e-5 * 0.17 * roll
    speeds, shortfall = allocate(Wrench(4.0 * 4.13e-5 * level, tau_x, 0.0, 0.0), ROTORS)
    assert shortfall.tau_x == pytest.approx(0.8 * tau_x, rel=1e-6)
    np.testing.assert_allclose(np.square(speeds), level + np.array([0.0, -0.2, 0.0, 0.2]) * roll, atol=1e-6)


@pytest.mark.slow
@both_ways
def test_no_rounding_takes_a_rotor_below_its_limit(allocate):
    """Nor the square of a speed below zero, where the root is not a number."""
    for low in (0.0, 60.0):
        rotors, rng = RotorModel.of(TABLE_I._replace(min_rotor_speed=low)), np.random.default_rng(3)
        for _ in range(3000):
            speeds, _ = allocate(Wrench(*rng.normal(size=4) * [10.0, 3.0, 3.0, 0.3]), rotors)
            assert min(speeds) >= low
