"""Tests of the allocation of wrenches to rotors."""

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
from drake_quad.vehicle.authority import explain_infeasible_hover, explain_missing_wrench
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.rotors import Rotor, Rotors

PAPER_VEHICLE = QuadrotorParameters()
ROTORS = RotorModel.of(PAPER_VEHICLE)
MAX_THRUST = 4.0 * 4.13e-5 * 300.0**2  # N
MIN_THRUST = 4.0 * 4.13e-5 * 60.0**2  # N

wrenches = st.builds(Wrench, st.floats(-20.0, 40.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.5, 0.5))
rotor_speeds = st.builds(RotorSpeed, *[st.floats(60.0, 300.0)] * 4)


with_both_allocations = pytest.mark.parametrize("allocate", [allocate, allocate_to_pairs])
with_both_priorities = pytest.mark.parametrize("priority", get_args(Priority))


@with_both_allocations
@given(rotor_speed=rotor_speeds)
def test_allocation_inverts_eq_5_within_the_limits(allocate, rotor_speed):
    speeds, shortfall = allocate(rotor_action(rotor_speed, PAPER_VEHICLE).wrench, ROTORS)
    # Rounding can cause a very small saturation at the limits themselves.
    np.testing.assert_allclose(speeds, rotor_speed, rtol=1e-9)
    np.testing.assert_allclose(shortfall, 0.0, atol=1e-9)


@with_both_allocations
@with_both_priorities
@given(wrench=wrenches)
def test_speeds_are_within_the_limits_and_the_shortfall_is_the_missing_wrench(allocate, priority, wrench):
    speeds, shortfall = allocate(wrench, ROTORS, priority)
    assert np.all(np.array(speeds) >= 60.0 * (1.0 - 1e-12))
    assert np.all(np.array(speeds) <= 300.0 * (1.0 + 1e-12))
    np.testing.assert_allclose(np.subtract(wrench, shortfall), rotor_action(speeds, PAPER_VEHICLE).wrench, atol=1e-9)


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
        if not explain_missing_wrench(rotors) and not explain_infeasible_hover(rotors, min_speed=60.0, max_speed=300.0):
            return rotors


def best_wrench(wrench, rotors, priority):
    """Return the best wrench of rotors between 60 and 300 rad/s, and which of its parts are less than commanded.

    The parts are roll and pitch torque, thrust, and yaw torque. There is one linear programme for each part, in the
    order of the priority. Unknowns are the fraction of roll and pitch torque, the thrust, the fraction of yaw torque,
    and the distance of the thrust from the commanded one.
    """
    x, y, _, turns, b, d = np.array(rotors).T
    inverse = np.linalg.inv([b, y * b, -x * b, -turns * d]) / 300.0**2
    tilt, yaw = inverse @ [0.0, wrench.tau_x, wrench.tau_y, 0.0], inverse[:, 3] * wrench.tau_z
    squares = np.column_stack([tilt, inverse[:, 0], yaw, np.zeros(4)])
    rows = np.vstack([squares, -squares, [0.0, 1.0, 0.0, -1.0], [0.0, -1.0, 0.0, -1.0]])
    limits = np.array([*[1.0] * 4, *[-((60.0 / 300.0) ** 2)] * 4, wrench.thrust, -wrench.thrust])
    bounds = [(0.0, 1.0), (None, None), (0.0, 1.0), (0.0, None)]
    # Each linear programme optimises one part of the wrench. The parts that earlier programmes determined may change by
    # this tolerance, since the solver has rounding errors.
    tolerance = 1e-9

    def best(objective, bounds):
        options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
        solution = scipy.optimize.linprog(objective, rows, limits + tolerance, bounds=bounds, options=options)
        assert solution.status == 0, solution.message
        return solution.x

    max_fraction, min_distance, max_yaw = [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -1.0, 0.0]
    if priority == "roll_pitch":
        bounds[0] = best(max_fraction, bounds)[0] - tolerance, 1.0
        bounds[3] = 0.0, best(min_distance, bounds)[3] + tolerance
    else:
        without_torque = [(0.0, 0.0), (None, None), (0.0, 0.0), (0.0, None)]
        thrust = best(min_distance, without_torque)[1]
        bounds[1] = thrust - tolerance, thrust + tolerance
        bounds[0] = best(max_fraction, bounds)[0] - tolerance, 1.0
    fraction, thrust, yaw_fraction, distance = best(max_yaw, bounds)
    produced = Wrench(thrust, fraction * wrench.tau_x, fraction * wrench.tau_y, yaw_fraction * wrench.tau_z)
    return produced, np.array([fraction < 1.0 - 1e-9, distance > 1e-9, yaw_fraction < 1.0 - 1e-9])


def random_demand(rotors, rng):
    """Return a random wrench that is within, slightly beyond, or far beyond the limits of the rotors."""
    x, y, _, turns, b, d = np.array(rotors).T
    feasible = np.array([b, y * b, -x * b, -turns * d]) @ rng.uniform(60.0**2, 300.0**2, 4)
    spread = rng.choice([0.0, 0.5, 5.0])
    return Wrench(*(feasible * (1.0 + spread * rng.uniform(-1.0, 1.0, 4))).tolist())


@pytest.mark.slow
@with_both_priorities
@pytest.mark.parametrize("shape", [Rotors.plus, Rotors.x, random_layout])
def test_each_part_of_a_wrench_is_optimal_given_the_parts_with_higher_priority(shape, priority):
    """Allocation agrees with linear programmes for a plus, for an X or H of any size, and for any four rotors."""
    rng = np.random.default_rng(5)
    paired = shape is not random_layout
    num_reduced = np.zeros(3)
    for _ in range(50):
        length, width = rng.uniform(0.1, 0.6, 2)
        rotors = shape(length=length, width=width) if paired else random_layout(rng)
        wrench = random_demand(rotors, rng)
        expected, reduced_parts = best_wrench(wrench, rotors, priority)
        for allocation in (allocate, allocate_to_pairs) if paired else (allocate,):
            speeds, shortfall = allocation(wrench, RotorModel.of(QuadrotorParameters(rotors=rotors)), priority)
            produced = np.subtract(wrench, shortfall)
            np.testing.assert_allclose(produced, expected, rtol=0.0, atol=1e-6)
            action = rotor_action(speeds, QuadrotorParameters(rotors=rotors)).wrench
            np.testing.assert_allclose(action, produced, rtol=0.0, atol=1e-9)
        num_reduced += reduced_parts
    assert (num_reduced > 4).all(), "each part of the wrench should be less than commanded in several samples"


@pytest.mark.slow
@with_both_allocations
@with_both_priorities
@pytest.mark.parametrize(
    "wrench",
    # The thrust puts the squared speeds at 40 % or 60 % of their range. The yaw torque moves the two rotors that
    # produce the roll or pitch torque across the middle of this range, where they can produce the largest torque.
    [
        Wrench(0.6 * MIN_THRUST + 0.4 * MAX_THRUST, 0.0, 2.0, 0.5),
        Wrench(0.4 * MIN_THRUST + 0.6 * MAX_THRUST, 0.0, -2.0, -0.5),
        Wrench(0.6 * MIN_THRUST + 0.4 * MAX_THRUST, -2.0, 0.0, -0.5),
        Wrench(0.4 * MIN_THRUST + 0.6 * MAX_THRUST, 2.0, 0.0, 0.5),
    ],
)
def test_yaw_torque_increases_the_range_of_roll_and_pitch_torque(allocate, priority, wrench):
    _, shortfall = allocate(wrench, ROTORS, priority)
    expected, _ = best_wrench(wrench, Rotors.plus(), priority)
    np.testing.assert_allclose(np.subtract(wrench, shortfall), expected, rtol=0.0, atol=1e-6)


@with_both_allocations
@given(rotor_speed=st.builds(RotorSpeed, *[st.floats(61.0, 299.0)] * 4))
def test_the_priority_does_not_change_a_wrench_within_the_limits(allocate, rotor_speed):
    wrench = rotor_action(rotor_speed, PAPER_VEHICLE).wrench
    by_priority = [allocate(wrench, ROTORS, priority) for priority in get_args(Priority)]
    assert by_priority[0] == by_priority[1]
    assert by_priority[0].shortfall == (0.0, 0.0, 0.0, 0.0)


@with_both_allocations
@pytest.mark.parametrize("thrust", [0.0, MIN_THRUST, MAX_THRUST, 2.0 * MAX_THRUST])
def test_a_large_roll_torque_requires_the_mean_of_smallest_and_largest_thrust(allocate, thrust):
    """A small commanded thrust is increased to this mean, and a large one is decreased to it."""
    speeds, shortfall = allocate(Wrench(thrust, 9.0, 0.0, 0.0), ROTORS)
    middle = 0.5 * (60.0**2 + 300.0**2)
    np.testing.assert_allclose(np.square(speeds), [middle, 60.0**2, middle, 300.0**2], rtol=1e-12)
    assert shortfall.tau_x == pytest.approx(9.0 - 4.13e-5 * 0.17 * (300.0**2 - 60.0**2))
    assert thrust - shortfall.thrust == pytest.approx(4.0 * 4.13e-5 * middle)


@with_both_allocations
@pytest.mark.parametrize(("thrust", "fraction"), [(0.0, 0.0), (2.0 * MAX_THRUST, 1.0)])
def test_two_rotors_produce_thrust_if_roll_torque_saturates_the_others(allocate, thrust, fraction):
    """The two rotors can also produce yaw torque in the commanded direction."""
    # This torque changes the squared speed of each rotor by 1000 rad²/s².
    yaw_torque = 4.0 * 8.5e-7 * 1000.0
    speeds, shortfall = allocate(Wrench(thrust, 9.0, 0.0, yaw_torque), ROTORS)
    level = 0.5 * (60.0**2 + 300.0**2) + fraction * 2000.0
    np.testing.assert_allclose(np.square(speeds), [level, 60.0**2, level, 300.0**2], rtol=1e-12)
    assert shortfall.tau_z == pytest.approx((1.0 - fraction) * yaw_torque, abs=1e-12)


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
    paired_speeds, paired_shortfall = allocate_to_pairs(wrench, model, priority)
    np.testing.assert_allclose(np.square(speeds), np.square(paired_speeds), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(shortfall, paired_shortfall, rtol=0.0, atol=1e-9)


def test_a_rotor_without_drag_torque_does_not_limit_the_yaw_torque():
    model = RotorModel.of(QuadrotorParameters(rotors=Rotors.x(length=0.3, width=0.3)))
    model_without_yaw = model._replace(mixer=model.mixer._replace(rotor_1=model.mixer.rotor_1._replace(tau_z=0.0)))
    hover = model.mixer.rotor_1.thrust * 6.67
    speeds, shortfall = allocate(Wrench(6.67, 0.0, 0.0, 1.0), model_without_yaw)
    per_yaw = model.mixer.rotor_3.tau_z
    yaw = min((300.0**2 - hover) / per_yaw, (hover - 60.0**2) / per_yaw)
    assert shortfall == pytest.approx((0.0, 0.0, 0.0, 1.0 - yaw), abs=1e-12)
    expected = hover + yaw * per_yaw * np.array([0.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(np.square(speeds), expected, rtol=1e-12)


def test_a_saturated_rotor_does_not_limit_torque_that_it_does_not_produce():
    """A weak front rotor reaches its limit first, but only the rotors at the sides produce roll torque."""
    weak, *other_rotors = Rotors.plus()
    rotors = Rotors(weak._replace(thrust_factor=0.8 * 4.13e-5, drag_factor=0.8 * 8.5e-7), *other_rotors)
    model = RotorModel.of(QuadrotorParameters(rotors=rotors))
    speeds, shortfall = allocate(Wrench(20.0, 0.2, 0.0, 0.0), model, "thrust")
    assert shortfall == pytest.approx((20.0 - 4.0 * 0.8 * 4.13e-5 * 300.0**2, 0.0, 0.0, 0.0), abs=1e-12)
    assert speeds.rotor_1 == pytest.approx(300.0)
    _, shortfall = allocate(Wrench(20.0, 0.0, -0.1, 0.0), model, "thrust")
    assert shortfall.tau_y == pytest.approx(-0.1)


def test_yaw_torque_is_reduced_before_roll_torque():
    _, shortfall = allocate(Wrench(6.67, 0.3, 0.0, 0.3), ROTORS)
    assert shortfall == Wrench(0.0, 0.0, 0.0, shortfall.tau_z)
    assert 0.0 < shortfall.tau_z < 0.3


def test_allocations_of_a_fleet_and_of_single_vehicles_agree():
    rng = np.random.default_rng(0)
    wrench = np.array([rng.uniform(0, 15, 50), *rng.normal(size=(2, 50)), 0.1 * rng.normal(size=50)])
    fleet = Allocation(num_vehicles=50)
    context = fleet.CreateDefaultContext()
    fleet.get_input_port().FixValue(context, wrench.ravel())
    rows = fleet.get_output_port().Eval(context).reshape(8, 50)
    for i in range(50):
        speeds, shortfall = allocate(Wrench(*wrench[:, i].tolist()), ROTORS)
        np.testing.assert_allclose(rows[:, i], speeds + shortfall, rtol=1e-14, atol=1e-16)


def test_the_output_is_split_into_rotor_speed_commands_and_shortfall():
    builder = DiagramBuilder()
    for name, port in split_output(builder, "allocation", Allocation()).items():
        builder.ExportOutput(port, name)
    builder.ExportInput(builder.GetSubsystemByName("allocation").get_input_port(), "wrench")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("wrench").FixValue(context, [0.68 * 9.81, 0.0, 0.0, 0.0])
    speeds = diagram.GetOutputPort("rotor_speed_command").Eval(context)
    np.testing.assert_allclose(speeds, hover_rotor_speeds(PAPER_VEHICLE))
    np.testing.assert_array_equal(diagram.GetOutputPort("shortfall").Eval(context), 0.0)


def test_a_roll_torque_that_is_just_within_the_limits_is_produced():
    """The roll torque needs a change of 0.1 rad²/s², and the squared speeds are 0.5 rad²/s² below their maximum."""
    level, roll = 300.0**2 - 0.5, 0.1
    wrench = Wrench(4.0 * 4.13e-5 * level, 2.0 * 4.13e-5 * 0.17 * roll, 0.0, 0.0)
    speeds, shortfall = allocate(wrench, ROTORS)
    np.testing.assert_allclose(np.square(speeds), level + np.array([0.0, -roll, 0.0, roll]), atol=1e-6)
    np.testing.assert_allclose(shortfall, 0.0, atol=1e-12)


@with_both_allocations
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_roll_torque_that_exceeds_a_limit_is_reduced_to_the_limit(allocate, sign):
    """The torque needs a change of 0.5 rad²/s², but the squared speeds are only 0.1 rad²/s² below their maximum."""
    level, roll = 300.0**2 - 0.1, sign * 0.5
    tau_x = 2.0 * 4.13e-5 * 0.17 * roll
    speeds, shortfall = allocate(Wrench(4.0 * 4.13e-5 * level, tau_x, 0.0, 0.0), ROTORS, "thrust")
    assert shortfall.tau_x == pytest.approx(0.8 * tau_x, rel=1e-6)
    np.testing.assert_allclose(np.square(speeds), level + np.array([0.0, -0.2, 0.0, 0.2]) * roll, atol=1e-6)


@pytest.mark.slow
@with_both_allocations
@with_both_priorities
def test_rounding_errors_move_no_rotor_below_its_limit(allocate, priority):
    """Negative squared speeds would make the speeds NaN."""
    for low in (0.0, 60.0):
        rotors, rng = RotorModel.of(PAPER_VEHICLE._replace(min_rotor_speed=low)), np.random.default_rng(3)
        speeds, _ = allocate(Wrench(*(rng.normal(size=(1500, 4)) * [10.0, 3.0, 3.0, 0.3]).T), rotors, priority)
        assert np.min(speeds) >= low


def test_rounding_errors_move_no_rotor_above_its_limit():
    """The test covers `allocate`, which has larger rounding errors than `allocate_to_pairs`."""
    rng = np.random.default_rng(3)
    speeds, _ = allocate(Wrench(*(rng.normal(size=(300, 4)) * [10.0, 3.0, 3.0, 0.3]).T), ROTORS)
    assert np.max(speeds) <= 300.0
