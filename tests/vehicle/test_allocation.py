import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import linprog

from drake_quad.framework.wiring import split_output
from drake_quad.signals import RotorSpeed, Wrench
from drake_quad.vehicle.allocation import Allocation, RotorModel, allocate
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.parameters import QuadrotorParameters

TABLE_I = QuadrotorParameters()
ROTORS = RotorModel.of(TABLE_I)
TOP_THRUST = 4.0 * 4.13e-5 * 300.0**2
BOTTOM_THRUST = 4.0 * 4.13e-5 * 60.0**2

wrenches = st.builds(Wrench, st.floats(-20.0, 40.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.5, 0.5))
rotor_speeds = st.builds(RotorSpeed, *[st.floats(60.0, 300.0)] * 4)


@given(rotor_speeds)
def test_inverts_eq_5_within_the_limits(rotor_speed):
    speeds, shortfall = allocate(rotor_action(rotor_speed, TABLE_I).wrench, ROTORS)
    # At the very limits rounding may call for a trace of saturation.
    np.testing.assert_allclose(speeds, rotor_speed, rtol=1e-9)
    np.testing.assert_allclose(shortfall, 0.0, atol=1e-9)


@given(wrenches)
def test_speeds_are_within_the_limits_and_shortfall_is_what_is_missing(wrench):
    speeds, shortfall = allocate(wrench, ROTORS)
    assert np.all(np.array(speeds) >= 60.0 * (1.0 - 1e-12))
    assert np.all(np.array(speeds) <= 300.0 * (1.0 + 1e-12))
    np.testing.assert_allclose(np.subtract(wrench, shortfall), rotor_action(speeds, TABLE_I).wrench, atol=1e-9)


@pytest.mark.slow
@given(wrenches)
# Room for so much yaw that roll or pitch, at 40 % and at 60 % of the way up, could go further than both its rotors.
@example(Wrench(0.6 * BOTTOM_THRUST + 0.4 * TOP_THRUST, 0.0, 2.0, 0.5))
@example(Wrench(0.4 * BOTTOM_THRUST + 0.6 * TOP_THRUST, 0.0, -2.0, -0.5))
@example(Wrench(0.6 * BOTTOM_THRUST + 0.4 * TOP_THRUST, -2.0, 0.0, -0.5))
@example(Wrench(0.4 * BOTTOM_THRUST + 0.6 * TOP_THRUST, 2.0, 0.0, 0.5))
@settings(max_examples=200, deadline=None)
def test_gives_up_yaw_first_then_roll_and_pitch_and_thrust_last(wrench):
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
    share = linprog([-1.0, 0.0], A_ub=both, b_ub=limits, bounds=[(0, 1), (0, 1)]).x[0]
    kept = linprog([0.0, -1.0], A_ub=both, b_ub=limits + 1e-9, bounds=[(max(share - 1e-9, 0.0), share), (0, 1)]).x[1]
    expected = Wrench(thrust, share * wrench.tau_x, share * wrench.tau_y, kept * wrench.tau_z)
    np.testing.assert_allclose(np.subtract(wrench, shortfall), expected, atol=1e-6)


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
