from typing import get_args

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from drake_quad.framework.wiring import split_output
from drake_quad.signals import RotorSpeed, Wrench
from drake_quad.vehicle.allocation import Allocation, Priority, RotorModel, allocate, allocate_to_pairs
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


both_forms = pytest.mark.parametrize("allocate", [allocate, allocate_to_pairs])
both_orders = pytest.mark.parametrize("priority", get_args(Priority))


@both_forms
@given(rotor_speed=rotor_speeds)
def test_allocation_inverts_eq_5_within_the_limits(allocate, rotor_speed):
    speeds, shortfall = allocate(rotor_action(rotor_speed, TABLE_I).wrench, ROTORS)
    # At the limits themselves, rounding can cause a very small saturation.
    np.testing.assert_allclose(speeds, rotor_speed, rtol=1e-9)
    np.testing.assert_allclose(shortfall, 0.0, atol=1e-9)


@both_forms
@both_orders
@given(wrench=wrenches)
def test_speeds_are_within_the_limits_and_the_shortfall_is_the_missing_wrench(allocate, priority, wrench):
    speeds, shortfall = allocate(wrench, ROTORS, priority)
    assert np.all(np.array(speeds) >= 60.0 * (1.0 - 1e-12))
    assert np.all(np.array(speeds) <= 300.0 * (1.0 + 1e-12))
    np.testing.assert_allclose(np.subtract(wrench, shortfall), rotor_action(speeds, TABLE_I).wrench, atol=1e-9)


def random_layout(rng):
    """Return four different rotors that can hover, some of them on the same side of the vehicle, and their limits."""
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


def best_wrench(wrench, rotors, priority):
    """Return the best wrench of rotors between 60 and 300 rad/s, and flags for cuts of share, thrust and yaw torque.

    There is one linear programme for each part of the wrench, in the order of the priority. Unknowns are the share of
    roll and pitch torque, the thrust, the share of yaw torque, and the distance of the thrust from the commanded one.
    """
    x, y, _, turns, b, d = np.array(rotors).T
    inverse = np.linalg.inv([b, y * b, -x * b, -turns * d]) / 300.0**2
    tilt, yaw = inverse @ [0.0, wrench.tau_x, wrench.tau_y, 0.0], inverse[:, 3] * wrench.tau_z
    squares = np.column_stack([tilt, inverse[:, 0], yaw, np.zeros(4)])
    rows = np.vstack([squares, -squares, [0.0, 1.0, 0.0, -1.0], [0.0, -1.0, 0.0, -1.0]])
    limits = np.array([*[1.0] * 4, *[-((60.0 / 300.0) ** 2)] * 4, wrench.thrust, -wrench.thrust])
    bounds = [(0.0, 1.0), (None, None), (0.0, 1.0), (0.0, None)]
    rounding = 1e-9  # tolerance on the results of earlier programmes, as exact as the solver is

    def best(objective, bounds):
        options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
        found = scipy.optimize.linprog(objective, rows, limits + rounding, bounds=bounds, options=options)
        assert found.status == 0, found.message
        return found.x

    most_share, nearest, most_yaw = [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -1.0, 0.0]
    if priority == "roll_pitch":
        bounds[0] = best(most_share, bounds)[0] - rounding, 1.0
        bounds[3] = 0.0, best(nearest, bounds)[3] + rounding
    else:
        without_torque = [(0.0, 0.0), (None, None), (0.0, 0.0), (0.0, None)]
        thrust = best(nearest, without_torque)[1]
        bounds[1] = thrust - rounding, thrust + rounding
        bounds[0] = best(most_share, bounds)[0] - rounding, 1.0
    share, thrust, yaw_share, distance = best(most_yaw, bounds)
    given = Wrench(thrust, share * wrench.tau_x, share * wrench.tau_y, yaw_share * wrench.tau_z)
    return given, np.array([share < 1.0 - 1e-9, distance > 1e-9, yaw_share < 1.0 - 1e-9])


def demand_on(rotors, rng):
    """Return a random wrench that the rotors can produce, or one that exceeds this by a little or by much."""
    x, y, _, turns, b, d = np.array(rotors).T
    given = np.array([b, y * b, -x * b, -turns * d]) @ rng.uniform(60.0**2, 300.0**2, 4)
    spread = rng.choice([0.0, 0.5, 5.0])
    return Wrench(*(given * (1.0 + spread * rng.uniform(-1.0, 1.0, 4))).tolist())


@pytest.mark.slow
@both_orders
@pytest.mark.parametrize("shape", [Rotors.plus, Rotors.x, random_layout])
def test_each_part_of_a_wrench_is_the_best_that_the_parts_before_it_allow(shape, priority):
    """Allocation agrees with linear programmes for a plus, an x or h of any size, and any four rotors."""
    rng = np.random.default_rng(5)
    paired = shape is not random_layout
    cut = np.zeros(3)
    for _ in range(50):
        length, width = rng.uniform(0.1, 0.6, 2)
        rotors = shape(length=length, width=width) if paired else random_layout(rng)
        wrench = demand_on(rotors, rng)
        expected, parts = best_wrench(wrench, rotors, priority)
        for form in (allocate, allocate_to_pairs) if paired else (allocate,):
            speeds, shortfall = form(wrench, RotorModel.of(QuadrotorParameters(rotors=rotors)), priority)
            given_up = np.subtract(wrench, shortfall)
            np.testing.assert_allclose(given_up, expected, rtol=0.0, atol=1e-6)
            action = rotor_action(speeds, QuadrotorParameters(rotors=rotors)).wrench
            np.testing.assert_allclose(action, given_up, rtol=0.0, atol=1e-9)
        cut += parts
    assert (cut > 4).all(), "each part of the wrench must be cut in several samples"


@pytest.mark.slow
@both_forms
@both_orders
@pytest.mark.parametrize(
    "wrench",
    # Yaw torque moves the two rotors of roll or pitch from 40 % or 60 % of their range to its middle and beyond.
    [
        Wrench(0.6 * BOTTOM_THRUST + 0.4 * TOP_THRUST, 0.0, 2.0, 0.5),
        Wrench(0.4 * BOTTOM_THRUST + 0.6 * TOP_THRUST, 0.0, -2.0, -0.5),
        Wrench(0.6 * BOTTOM_THRUST + 0.4 * TOP_THRUST, -2.0, 0.0, -0.5),
        Wrench(0.4 * BOTTOM_THRUST + 0.6 * TOP_THRUST, 2.0, 0.0, 0.5),
    ],
)
def test_yaw_torque_makes_room_for_roll_and_pitch_torque(allocate, priority, wrench):
    _, shortfall = allocate(wrench, ROTORS, priority)
    expected, _ = best_wrench(wrench, Rotors.plus(), priority)
    np.testing.assert_allclose(np.subtract(wrench, shortfall), expected, rtol=0.0, atol=1e-6)


@both_forms
@given(rotor_speed=st.builds(RotorSpeed, *[st.floats(61.0, 299.0)] * 4))
def test_the_priority_changes_no_bit_of_a_wrench_that_fits(allocate, rotor_speed):
    wrench = rotor_action(rotor_speed, TABLE_I).wrench
    by_priority = [allocate(wrench, ROTORS, priority) for priority in get_args(Priority)]
    assert by_priority[0] == by_priority[1]
    assert by_priority[0].shortfall == (0.0, 0.0, 0.0, 0.0)


@both_forms
@pytest.mark.parametrize("thrust", [0.0, BOTTOM_THRUST, TOP_THRUST, 2.0 * TOP_THRUST])
def test_a_large_roll_torque_moves_the_thrust_half_way_between_the_limits(allocate, thrust):
    """The thrust is raised from idle, and lowered from full thrust."""
    speeds, shortfall = allocate(Wrench(thrust, 9.0, 0.0, 0.0), ROTORS)
    middle = 0.5 * (60.0**2 + 300.0**2)
    np.testing.assert_allclose(np.square(speeds), [middle, 60.0**2, middle, 300.0**2], rtol=1e-12)
    assert shortfall.tau_x == pytest.approx(9.0 - 4.13e-5 * 0.17 * (300.0**2 - 60.0**2))
    assert thrust - shortfall.thrust == pytest.approx(4.0 * 4.13e-5 * middle)


@both_forms
@pytest.mark.parametrize(("thrust", "share"), [(0.0, 0.0), (2.0 * TOP_THRUST, 1.0)])
def test_two_free_rotors_give_thrust_if_roll_torque_saturates_the_others(allocate, thrust, share):
    """The other two rotors are free to produce thrust, and also yaw torque in the commanded direction."""
    commanded = 4.0 * 8.5e-7 * 1000.0  # 1000 rad²/s² for each rotor
    speeds, shortfall = allocate(Wrench(thrust, 9.0, 0.0, commanded), ROTORS)
    level = 0.5 * (60.0**2 + 300.0**2) + share * 2000.0
    np.testing.assert_allclose(np.square(speeds), [level, 60.0**2, level, 300.0**2], rtol=1e-12)
    assert shortfall.tau_z == pytest.approx((1.0 - share) * commanded, abs=1e-12)


@given(
    wrench=wrenches,
    shape=st.sampled_from([Rotors.plus, Rotors.x]),
    length=st.floats(0.05, 1.0),
    width=st.floats(0.05, 1.0),
    direction=st.sampled_from([-1.0, 1.0]),
    priority=st.sampled_from(get_args(Priority)),
)
def test_allocation_to_pairs_agrees_with_the_general_allocation(wrench, shape, length, width, direction, priority):
    rotors = shape(length=length, width=width, rotor_1_direction=direction)
    model = RotorModel.of(QuadrotorParameters(rotors=rotors))
    speeds, shortfall = allocate(wrench, model, priority)
    other_speeds, other_shortfall = allocate_to_pairs(wrench, model, priority)
    np.testing.assert_allclose(np.square(speeds), np.square(other_speeds), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(shortfall, other_shortfall, rtol=0.0, atol=1e-9)


def test_a_rotor_without_yaw_torque_does_not_limit_yaw():
    model = RotorModel.of(QuadrotorParameters(rotors=Rotors.x(length=0.3, width=0.3)))
    still = model._replace(mixer=model.mixer._replace(rotor_1=model.mixer.rotor_1._replace(tau_z=0.0)))
    hover = model.mixer.rotor_1.thrust * 6.67
    speeds, shortfall = allocate(Wrench(6.67, 0.0, 0.0, 1.0), still)
    per_yaw = model.mixer.rotor_3.tau_z
    yaw = min((300.0**2 - hover) / per_yaw, (hover - 60.0**2) / per_yaw)
    assert shortfall == pytest.approx((0.0, 0.0, 0.0, 1.0 - yaw), abs=1e-12)
    expected = hover + yaw * per_yaw * np.array([0.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(np.square(speeds), expected, rtol=1e-12)


def test_a_saturated_rotor_does_not_limit_torque_that_it_does_not_produce():
    """A weak front rotor reaches its limit first, but only the rotors at the sides produce roll torque."""
    weak, *others = Rotors.plus()
    rotors = Rotors(weak._replace(thrust_factor=0.8 * 4.13e-5, drag_factor=0.8 * 8.5e-7), *others)
    model = RotorModel.of(QuadrotorParameters(rotors=rotors))
    speeds, shortfall = allocate(Wrench(20.0, 0.2, 0.0, 0.0), model, "thrust")
    assert shortfall == pytest.approx((20.0 - 4.0 * 0.8 * 4.13e-5 * 300.0**2, 0.0, 0.0, 0.0), abs=1e-12)
    assert speeds.rotor_1 == pytest.approx(300.0)
    _, shortfall = allocate(Wrench(20.0, 0.0, -0.1, 0.0), model, "thrust")
    assert shortfall.tau_y == pytest.approx(-0.1)


def test_yaw_torque_is_sacrificed_before_roll():
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


def test_the_packed_output_has_both_signals_under_their_names():
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


def test_small_remaining_room_is_used_completely():
    """At 0.5 rad²/s² below the maximum, a demand of 0.1 rad²/s² fits."""
    level, roll = 300.0**2 - 0.5, 0.1
    wrench = Wrench(4.0 * 4.13e-5 * level, 2.0 * 4.13e-5 * 0.17 * roll, 0.0, 0.0)
    speeds, shortfall = allocate(wrench, ROTORS)
    np.testing.assert_allclose(np.square(speeds), level + np.array([0.0, -roll, 0.0, roll]), atol=1e-6)
    np.testing.assert_allclose(shortfall, 0.0, atol=1e-12)


@both_forms
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_small_demand_is_limited_to_the_remaining_room(allocate, sign):
    """At 0.1 rad²/s² below the maximum, a fifth of a roll demand of 0.5 rad²/s² fits."""
    level, roll = 300.0**2 - 0.1, sign * 0.5
    tau_x = 2.0 * 4.13e-5 * 0.17 * roll
    speeds, shortfall = allocate(Wrench(4.0 * 4.13e-5 * level, tau_x, 0.0, 0.0), ROTORS, "thrust")
    assert shortfall.tau_x == pytest.approx(0.8 * tau_x, rel=1e-6)
    np.testing.assert_allclose(np.square(speeds), level + np.array([0.0, -0.2, 0.0, 0.2]) * roll, atol=1e-6)


@pytest.mark.slow
@both_forms
@both_orders
def test_rounding_takes_no_rotor_below_its_limit(allocate, priority):
    """No squared speed becomes negative either, which would make its root NaN."""
    for low in (0.0, 60.0):
        rotors, rng = RotorModel.of(TABLE_I._replace(min_rotor_speed=low)), np.random.default_rng(3)
        speeds, _ = allocate(Wrench(*(rng.normal(size=(1500, 4)) * [10.0, 3.0, 3.0, 0.3]).T), rotors, priority)
        assert np.min(speeds) >= low


def test_rounding_takes_no_rotor_above_its_limit():
    """The coefficients of rotors at arbitrary positions are less exact than those of pairs."""
    rng = np.random.default_rng(3)
    speeds, _ = allocate(Wrench(*(rng.normal(size=(300, 4)) * [10.0, 3.0, 3.0, 0.3]).T), ROTORS)
    assert np.max(speeds) <= 300.0
