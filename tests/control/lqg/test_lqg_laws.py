"""Tests of the equations of linear-quadratic-Gaussian control, against matrix equations and differential flatness."""

import math

import numpy as np
import pytest
from all_systems import NOMINAL_THRUST, TARGET_LQG, TORQUE_LQG

from drake_quad.control.lqg.chains import AttitudeChain, TorqueChain, VerticalChain
from drake_quad.control.lqg.laws import (
    ChainCommands,
    Estimate,
    KalmanState,
    RegulatorOutput,
    SentCommands,
    estimator_step,
    filter_step,
    next_sent,
    outer_feedback,
    position_error,
    position_error_rate,
    regulator_output,
    target_from_acceleration,
    total_disturbance,
    wrench_from_snap,
)
from drake_quad.signals import Acceleration, Jerk, PositionError, PositionErrorRate, Reference, Snap, State
from drake_quad.vehicle.inverse_dynamics import rotor_demand
from drake_quad.vehicle.parameters import Inertia, QuadrotorParameters

H = 0.01  # s, camera frame
TICK = 0.02  # s, control tick
LAST_VERTICAL_THRUST = 8.9  # m/s², vertical specific thrust of the last command
RNG = np.random.default_rng(5)
MEASUREMENT = State(
    x=0.31, y=-0.42, z=1.13, roll=0.11, pitch=-0.17, yaw=0.4, v_x=0.5, v_y=0.6, v_z=0.7, p=0.8, q=0.9, r=1.0
)
REFERENCE = Reference(
    x=0.35, y=-0.5, z=1.2, v_x=0.2, v_y=0.3, v_z=-0.1, a_x=0.4, a_y=-0.6, a_z=0.5, yaw=0.7, yaw_rate=0.2
)
JERK = Jerk(0.3, -0.5, 0.7)  # m/s³
SNAP = Snap(1.1, -1.7, 0.9, 0.6)  # m/s⁴


def random_chain(kind, scale=0.1):
    return kind(*(scale * RNG.normal(size=len(kind._fields))).tolist())


def running_filter(kind):
    return KalmanState(Estimate(random_chain(kind), random_chain(kind), random_chain(VerticalChain)), 1.0, 0.3)


def sent_commands(delay, snap):
    commands = tuple(ChainCommands(*RNG.normal(size=3).tolist()) for _ in range(delay + 1))
    return SentCommands(
        commands, tuple(ChainCommands(*RNG.normal(size=3).tolist()) for _ in range(delay)), LAST_VERTICAL_THRUST, snap
    )


def rotation(state):
    """Return the rotation matrix of eq (1) of the paper, as a product of rotations about the three axes."""
    (c_r, s_r), (c_p, s_p), (c_y, s_y) = ((math.cos(a), math.sin(a)) for a in (state.roll, state.pitch, state.yaw))
    return (
        np.array([[c_y, -s_y, 0], [s_y, c_y, 0], [0, 0, 1]])
        @ np.array([[c_p, 0, s_p], [0, 1, 0], [-s_p, 0, c_p]])
        @ np.array([[1, 0, 0], [0, c_r, -s_r], [0, s_r, c_r]])
    )


def test_the_filter_is_a_textbook_kalman_filter_with_the_thrust_of_the_measured_attitude():
    before, sent = running_filter(TorqueChain), sent_commands(2, SNAP)
    estimate = estimator_step(MEASUREMENT, before, sent, None, TORQUE_LQG, H, True)
    x_B, y_B, z_B = rotation(MEASUREMENT)[:, 2]
    thrust = LAST_VERTICAL_THRUST * np.array([x_B, y_B]) / z_B
    for axis, measured, s, u in zip(
        "xyz", (MEASUREMENT.x, MEASUREMENT.y, MEASUREMENT.z), [*thrust, None], sent.commands[0], strict=True
    ):
        loop = TORQUE_LQG.vertical if axis == "z" else TORQUE_LQG.lateral
        chain_before = getattr(before.estimate, axis)
        x, A, B, L = np.array(chain_before), np.array(loop.A), np.array(loop.B), np.array(loop.L).T
        innovation = [measured - chain_before.position, *([] if s is None else [s - chain_before.thrust])]
        expected = A @ (x + L @ innovation) + B * u
        # The horizontal thrust in the chain belongs to the vertical thrust of the last command. The filter scales it to
        # the estimated vertical thrust.
        offset = (
            0.0
            if s is None
            else chain_before.thrust * (9.81 + before.estimate.z.thrust - LAST_VERTICAL_THRUST) / LAST_VERTICAL_THRUST
        )
        expected[:2] += 0.5 * H**2 * offset, H * offset
        np.testing.assert_allclose(getattr(estimate, axis), expected, rtol=1e-12)


def test_a_repeated_camera_frame_is_ignored():
    before, sent = running_filter(TorqueChain), sent_commands(2, SNAP)
    lost = before._replace(last_x=MEASUREMENT.x)
    estimate = estimator_step(MEASUREMENT, lost, sent, None, TORQUE_LQG, H, True)
    x = np.array(TORQUE_LQG.lateral.A) @ before.estimate.x + np.array(TORQUE_LQG.lateral.B) * sent.commands[0].x
    np.testing.assert_allclose(estimate.x[2:], x[2:], rtol=1e-12)
    # Cameras may measure the same position twice even if no frame is lost.
    assert estimator_step(MEASUREMENT, lost, sent, None, TORQUE_LQG, H, False) == estimator_step(
        MEASUREMENT, before, sent, None, TORQUE_LQG, H, True
    )


def test_the_filter_starts_at_rest_at_the_measured_position():
    first = running_filter(TorqueChain)._replace(has_started=0.0)
    after = filter_step(MEASUREMENT, first, sent_commands(2, SNAP), None, TORQUE_LQG, H, True)
    assert (after.has_started, after.last_x) == (1.0, MEASUREMENT.x)
    assert position_error(after.estimate, REFERENCE) == pytest.approx((0.04, -0.08, 0.07))
    assert position_error_rate(after.estimate, REFERENCE) == pytest.approx((0.2, 0.3, -0.1))
    assert total_disturbance(after.estimate) == (0.0, 0.0, 0.0)


def test_a_known_acceleration_changes_the_estimated_motion_but_not_the_estimated_disturbance():
    before, sent, known = running_filter(TorqueChain), sent_commands(2, SNAP), Acceleration(0.7, -1.1, 1.3)
    plain, with_acceleration = (
        estimator_step(MEASUREMENT, before, sent, each, TORQUE_LQG, H, True) for each in (None, known)
    )
    for axis in "xyz":
        change = np.subtract(getattr(with_acceleration, axis), getattr(plain, axis))
        expected = np.zeros_like(change)
        expected[:2] = 0.5 * H**2 * getattr(known, axis), H * getattr(known, axis)
        np.testing.assert_allclose(change, expected, atol=1e-13)


def expected_deviation(chain_now, axis, subtracted=0.0):
    """Return the deviation of a chain from the reference, whose acceleration is reduced by `subtracted` (m/s²)."""
    r = REFERENCE
    motion = {
        "x": [r.x, r.v_x, r.a_x - subtracted, JERK.x, SNAP.x],
        "y": [r.y, r.v_y, r.a_y - subtracted, JERK.y, SNAP.y],
        "z": [r.z, r.v_z, r.a_z - subtracted],
    }[axis]
    count = {TorqueChain: 5, AttitudeChain: 4, VerticalChain: 3}[type(chain_now)]
    e = np.array(chain_now)
    e[:count] -= motion[:count]
    return e


UNLIMITED_THRUST = NOMINAL_THRUST._replace(tan_max_tilt=1e6, min_thrust=-1e6, max_thrust=1e6)


def test_the_snap_command_contains_state_feedback_and_feedforward_with_lead():
    parameters = TORQUE_LQG._replace(thrust=UNLIMITED_THRUST, torques=TORQUE_LQG.torques._replace(max_snap=1e6))
    estimate, sent = running_filter(TorqueChain).estimate, sent_commands(2, Snap(0.8, -1.0, 0.3, 0.0))
    correction = Acceleration(0.2, -0.3, 0.1)
    output = regulator_output(estimate, REFERENCE, JERK, SNAP, sent, correction, None, parameters, TICK)
    for axis, forward in (
        ("x", SNAP.x + 0.09 * (SNAP.x - 0.8) / TICK),
        ("y", SNAP.y + 0.09 * (SNAP.y + 1.0) / TICK),
        ("z", REFERENCE.a_z - 0.1 + 0.07 * JERK.z),
    ):
        loop = parameters.vertical if axis == "z" else parameters.lateral
        e = expected_deviation(getattr(estimate, axis), axis, getattr(correction, axis))
        pending = [getattr(each, axis) for each in sent.deviations]
        feedback = np.dot(loop.K, e) + np.dot(loop.K_pending, pending)
        assert getattr(output.command, axis) == pytest.approx(forward - feedback)
        assert getattr(output.deviation, axis) == pytest.approx(-feedback)
    # The acceleration is the command of an outer loop: the PD plus the compensation of the disturbance.
    pd = outer_feedback(position_error(estimate, REFERENCE), position_error_rate(estimate, REFERENCE), parameters)
    K = parameters.lateral.K
    compensation = (
        K.first * estimate.x.first + K.second * estimate.x.second + K.second_rate * estimate.x.second_rate
    ) / 1.8
    assert output.acceleration.x == pytest.approx(REFERENCE.a_x - 0.2 + pd.x - compensation)
    assert output.acceleration.z == output.command.z


@pytest.mark.parametrize("parameters", [TORQUE_LQG, TARGET_LQG])
def test_outer_feedback_has_the_regulator_gains_divided_by_the_outer_gain(parameters):
    for i, loop in enumerate((parameters.lateral, parameters.lateral, parameters.vertical)):
        error, rate = np.zeros(3), np.zeros(3)
        error[i], rate[i] = 0.3, -0.7
        feedback = outer_feedback(PositionError(*error), PositionErrorRate(*rate), parameters)
        expected = np.zeros(3)
        expected[i] = (loop.K.position * 0.3 - loop.K.velocity * 0.7) / loop.outer_divisor
        np.testing.assert_allclose(feedback, expected, rtol=1e-12)


def test_the_command_to_an_autopilot_is_an_acceleration_with_lead():
    parameters = TARGET_LQG._replace(thrust=UNLIMITED_THRUST)
    estimate, sent = running_filter(AttitudeChain).estimate, sent_commands(1, None)
    output = regulator_output(estimate, REFERENCE, JERK, SNAP, sent, None, None, parameters, TICK)
    e = expected_deviation(estimate.y, "y")
    feedback = np.dot(parameters.lateral.K, e) + parameters.lateral.K_pending[0] * sent.deviations[0].y
    assert output.command.y == pytest.approx(REFERENCE.a_y + 0.2 * JERK.y + 0.03 * SNAP.y - feedback)
    assert output.acceleration[:2] == output.command[:2]


def test_commands_stay_within_the_tilt_thrust_and_snap_limits():
    """A limited horizontal command keeps its direction. Deviations are computed from the limited command."""
    far_reference = REFERENCE._replace(x=40.0, y=-30.0, z=300.0)
    attitude = regulator_output(
        running_filter(AttitudeChain).estimate,
        far_reference,
        JERK,
        SNAP,
        sent_commands(1, None),
        None,
        None,
        TARGET_LQG,
        TICK,
    )
    assert math.hypot(*attitude.command[:2]) == pytest.approx(0.7 * 9.81)
    free = TARGET_LQG._replace(thrust=UNLIMITED_THRUST)
    estimate, sent = running_filter(AttitudeChain).estimate, sent_commands(1, None)
    limited, desired = (
        regulator_output(estimate, far_reference, JERK, SNAP, sent, None, None, each, TICK).command
        for each in (TARGET_LQG, free)
    )
    assert limited.x / limited.y == pytest.approx(desired.x / desired.y)
    assert limited.z == pytest.approx(12.0 / 0.68 - 9.81)
    low = regulator_output(estimate, far_reference._replace(z=-300.0), JERK, SNAP, sent, None, None, TARGET_LQG, TICK)
    assert low.command.z == pytest.approx(2.0 / 0.68 - 9.81)
    narrow = TORQUE_LQG._replace(torques=TORQUE_LQG.torques._replace(max_snap=3.0))
    farther_reference = far_reference._replace(x=400.0, y=-300.0)
    torques = regulator_output(
        running_filter(TorqueChain).estimate,
        farther_reference,
        JERK,
        SNAP,
        sent_commands(2, SNAP),
        None,
        None,
        narrow,
        TICK,
    )
    assert [abs(u) for u in torques.command[:2]] == [3.0, 3.0]
    assert math.hypot(*torques.acceleration[:2]) == pytest.approx(0.7 * 9.81)
    assert torques.command.x - torques.deviation.x == pytest.approx(SNAP.x)


def test_the_queue_of_sent_commands_advances_at_each_tick():
    sent = sent_commands(2, SNAP)
    requested = regulator_output(
        running_filter(TorqueChain).estimate, REFERENCE, JERK, SNAP, sent, None, None, TORQUE_LQG, TICK
    )
    after = next_sent(requested, SNAP, sent)
    assert after.upward == requested.upward
    assert after.commands == (*sent.commands[1:], requested.command)
    assert after.deviations == (*sent.deviations[1:], requested.deviation)
    alone = sent_commands(0, None)
    assert next_sent(requested, SNAP, alone) == SentCommands((requested.command,), (), requested.upward, None)


def vehicle_on_path(kind):
    """Return the rotor demand, the measurement and the estimate of a vehicle that flies exactly on its path."""
    parameters = QuadrotorParameters()._replace(mass=0.68, gravity=9.81, inertia=Inertia(0.01, 0.01, 0.01))
    demand = rotor_demand(REFERENCE, JERK, SNAP, parameters)
    measured = State(REFERENCE.x, REFERENCE.y, REFERENCE.z, *demand.attitude, 0.0, 0.0, 0.0, *demand.body_rates)
    rows = {
        axis: {"thrust": getattr(REFERENCE, f"a_{axis}"), "jerk": getattr(JERK, axis), "snap": getattr(SNAP, axis)}
        for axis in "xyz"
    }
    kinds = {"x": kind, "y": kind, "z": VerticalChain}
    chains = [kinds[axis](*(rows[axis].get(name, 0.0) for name in kinds[axis]._fields)) for axis in "xyz"]
    return demand, measured, Estimate(*chains)


def undisturbed_output(x, y, z):
    """Return the regulator's output for commands along x, y and z if there are no disturbances."""
    command = ChainCommands(x, y, z)
    return RegulatorOutput(command, command, Acceleration(x, y, z), NOMINAL_THRUST.gravity + REFERENCE.a_z)


def test_the_wrench_for_a_vehicle_on_its_path_follows_from_flatness():
    """The controller neglects the gyroscopic torque, which is zero for equal moments of inertia."""
    demand, measured, estimate = vehicle_on_path(TorqueChain)
    equal_inertia = TORQUE_LQG.torques._replace(i_xx=0.01, i_yy=0.01, i_zz=0.01)
    parameters = TORQUE_LQG._replace(torques=equal_inertia, thrust=UNLIMITED_THRUST)
    requested = undisturbed_output(SNAP.x, SNAP.y, REFERENCE.a_z)
    wrench = wrench_from_snap(requested, estimate, measured, REFERENCE, JERK, SNAP, parameters)
    assert wrench[:3] == pytest.approx(demand.wrench[:3])
    yaw = 3.1 * (REFERENCE.yaw_rate - measured.r) + SNAP.yaw
    assert wrench.tau_z == pytest.approx(0.01 * yaw)
    turned = wrench_from_snap(
        requested, estimate, measured._replace(yaw=measured.yaw - 2 * math.pi), REFERENCE, JERK, SNAP, parameters
    )
    assert turned == pytest.approx(wrench)


def test_the_attitude_target_of_a_vehicle_on_its_path_is_its_attitude():
    demand, measured, estimate = vehicle_on_path(AttitudeChain)
    requested = undisturbed_output(REFERENCE.a_x, REFERENCE.a_y, REFERENCE.a_z)
    target = target_from_acceleration(
        requested, estimate, measured, REFERENCE, TARGET_LQG._replace(thrust=UNLIMITED_THRUST)
    )
    assert target == pytest.approx((demand.wrench.thrust, *demand.attitude, 0.0, 0.0, REFERENCE.yaw_rate))


def test_the_vertical_thrust_compensates_the_estimated_disturbance():
    estimate, sent = running_filter(AttitudeChain).estimate, sent_commands(1, None)
    free = TARGET_LQG._replace(thrust=UNLIMITED_THRUST)
    correction = Acceleration(0.2, -0.3, 0.1)
    output = regulator_output(estimate, REFERENCE, JERK, SNAP, sent, correction, None, free, TICK)
    disturbance = estimate.z.first + estimate.z.second
    assert output.upward == pytest.approx(9.81 + REFERENCE.a_z - 0.1 - disturbance)
    # The vertical specific thrust does not fall below its lower limit, so no division by zero occurs.
    falling = REFERENCE._replace(a_z=-50.0)
    limited = regulator_output(estimate, falling, JERK, SNAP, sent, None, None, TARGET_LQG, TICK)
    assert limited.upward == pytest.approx(2.0 / 0.68)


@pytest.mark.parametrize("change", [-4.0, 3.0])
def test_thrust_changes_do_not_affect_the_commanded_and_the_estimated_attitude(change):
    """Additional thrust accelerates a tilted vehicle sideways, which the filter does not attribute to the attitude."""
    _, measured, estimate = vehicle_on_path(AttitudeChain)
    free = TARGET_LQG._replace(thrust=UNLIMITED_THRUST)
    changed_estimate = estimate._replace(z=estimate.z._replace(thrust=estimate.z.thrust + change))
    usual, other = undisturbed_output(1.3, -0.7, 0.4), undisturbed_output(1.3, -0.7, 0.4 + change)
    commanded = target_from_acceleration(usual, estimate, measured, REFERENCE, free)
    changed_target = target_from_acceleration(other, changed_estimate, measured, REFERENCE, free)
    assert changed_target[1:] == commanded[1:]
    # The thrust acts along the measured z axis of the body. Its vertical component changes as commanded.
    up = rotation(measured)[2, 2]
    assert changed_target.thrust - commanded.thrust == pytest.approx(0.68 * change / up)
    _, torque_measurement, torque_estimate = vehicle_on_path(TorqueChain)
    changed_torque_estimate = torque_estimate._replace(
        z=torque_estimate.z._replace(thrust=torque_estimate.z.thrust + change)
    )
    torques = TORQUE_LQG._replace(thrust=UNLIMITED_THRUST)
    wrench, changed_wrench = (
        wrench_from_snap(requested, estimate, torque_measurement, REFERENCE, JERK, SNAP, torques)
        for requested, estimate in ((usual, torque_estimate), (other, changed_torque_estimate))
    )
    assert changed_wrench[1:] == wrench[1:]
    assert changed_wrench.thrust - wrench.thrust == pytest.approx(0.68 * change / up)
    # The thrust changes only the horizontal velocity. It does not change the innovation from the measured attitude.
    sent = sent_commands(1, None)._replace(upward=9.81 + REFERENCE.a_z)
    before = KalmanState(estimate, 1.0, 0.0), KalmanState(changed_estimate, 1.0, 0.0)
    plain, changed = (estimator_step(measured, each, sent, None, free, H, True) for each in before)
    assert changed.x[2:] == plain.x[2:]
    sideways = REFERENCE.a_x * change / (9.81 + REFERENCE.a_z)
    assert changed.x.velocity - plain.x.velocity == pytest.approx(H * sideways)
