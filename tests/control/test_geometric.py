"""Tests of geometric attitude control: agreement with the PD near the command, and recovery from any attitude."""

import math

import numpy as np
import pytest
import scipy
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.systems.analysis import Simulator

from drake_quad import load_scenario, simulate
from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.control.attitude import AttitudeParameters, attitude_law
from drake_quad.control.geometric import (
    IntegratingAttitudeParameters,
    geometric_law,
    integrated_rotation,
    integrating_law,
)
from drake_quad.fleets.fleet_simulation import fly
from drake_quad.flight.mission import plan_route
from drake_quad.framework.wiring import subsystem
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.scenario.batch import Batch
from drake_quad.signals import AngularAcceleration, Attitude, BodyRates, State

INERTIA = np.array([0.0065, 0.0085, 0.0126])  # kg m²


def test_the_geometric_law_equals_the_pd_near_the_commanded_attitude():
    """Both laws have the same derivatives with respect to attitude, rates and all commands at level attitude."""
    parameters = AttitudeParameters(PerAngle(17.0, 14.0, 5.0), PerAngle(7.5, 6.8, 3.1), *INERTIA)

    def derivatives(law):
        rows = InitializeAutoDiff(np.zeros(15)).ravel().tolist()
        rest = [rows[0] * 0.0] * 3
        measurement = State(*rest, *rows[0:3], *rest, *rows[3:6])
        commanded = Attitude(*rows[6:9]), BodyRates(*rows[9:12]), AngularAcceleration(*rows[12:15])
        return ExtractGradient(np.array([*law(measurement, *commanded, parameters)]))

    np.testing.assert_allclose(derivatives(geometric_law), derivatives(attitude_law), atol=1e-15)


def angles_of(R):
    """Return roll, pitch and yaw of a rotation matrix R_WB, as defined by eq (1) of the paper."""
    yaw, pitch, roll = scipy.spatial.transform.Rotation.from_matrix(R).as_euler("ZYX")
    return Attitude(roll, pitch, yaw)


@pytest.mark.slow
def test_the_published_lyapunov_function_decreases_under_exact_dynamics():
    """The function is V = ½ e_Ω·J e_Ω + k_R Ψ + c e_R·e_Ω with Ψ = ½ tr(1 - R_dᵀ R), with one k_R for all axes.

    The command is constant. At the start the error is a rotation by 178° about an axis that is not a body axis.
    """
    k_R, k_Omega, c = 0.12, 0.05, 0.004
    parameters = AttitudeParameters(PerAngle(*(k_R / INERTIA)), PerAngle(*(k_Omega / INERTIA)), *INERTIA)
    desired, zero = Attitude(0.2, -0.3, 0.7), (0.0, 0.0, 0.0)
    R_d = scipy.spatial.transform.Rotation.from_euler("ZYX", [0.7, -0.3, 0.2]).as_matrix()
    axis = np.array([0.6, -0.48, 0.64])
    R_0 = R_d @ scipy.spatial.transform.Rotation.from_rotvec(math.radians(178.0) * axis).as_matrix()

    def slope(_, state):
        R, w = state[:9].reshape(3, 3), state[9:]
        measurement = State(0.0, 0.0, 0.0, *angles_of(R), 0.0, 0.0, 0.0, *w)
        torque = geometric_law(measurement, desired, BodyRates(*zero), AngularAcceleration(*zero), parameters)
        hat = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        return np.concatenate([(R @ hat).ravel(), (np.array(torque) - np.cross(w, INERTIA * w)) / INERTIA])

    start = np.concatenate([R_0.ravel(), [0.3, -0.2, 0.1]])
    states = scipy.integrate.solve_ivp(
        slope, (0.0, 8.0), start, rtol=1e-8, atol=1e-10, t_eval=np.linspace(0.0, 8.0, 200)
    ).y.T

    def lyapunov(state):
        R, w = state[:9].reshape(3, 3), state[9:]
        skew = 0.5 * (R_d.T @ R - R.T @ R_d)
        e_R = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        return 0.5 * w @ (INERTIA * w) + 0.5 * k_R * np.trace(np.eye(3) - R_d.T @ R) + c * e_R @ w

    values = np.array([lyapunov(state) for state in states])
    assert values[0] > 1.9 * k_R  # The largest possible value is 2 k_R.
    assert (np.diff(values) < 1e-9).all()
    assert values[-1] < 1e-5 * values[0]
    np.testing.assert_allclose(states[-1][:9].reshape(3, 3), R_d, atol=2e-3)


def test_the_geometric_law_does_not_depend_on_full_turns_of_the_attitude():
    """After a full roll, the law turns the shorter way, whereas a PD on the angle unwinds the whole turn."""
    parameters = AttitudeParameters(PerAngle(17.0, 14.0, 5.0), PerAngle(7.5, 6.8, 3.1), *INERTIA)
    rest = (0.0, 0.0, 0.0)

    def roll_torque(law, roll):
        measurement = State(*rest, roll, 0.0, 0.0, *rest, *rest)
        return law(measurement, Attitude(*rest), BodyRates(*rest), AngularAcceleration(*rest), parameters).tau_x

    assert roll_torque(geometric_law, 2.0 * math.pi - 0.3) == pytest.approx(roll_torque(geometric_law, -0.3), rel=1e-12)
    assert roll_torque(geometric_law, 2.0 * math.pi - 0.3) > 0.0 > roll_torque(attitude_law, 2.0 * math.pi - 0.3)


HOVER_POSITION = (0.3, -0.2, 30.0)  # m
RECOVERY_SCENARIO = """
recovery:
  route: {kind: hover, position: [0.3, -0.2, 30.0], duration: 30.0}
  crash: {tilt: null, position_error: 1000.0, height: -1000.0}
  control:
    position: {kind: pd, k_p: [2.0, 2.0, 4.0], k_d: [2.5, 2.5, 3.5]}
    attitude: {kind: geometric, k_p: [30.0, 30.0, 5.0], k_d: [8.0, 8.0, 3.5]}
"""


@pytest.mark.long
def test_vehicles_recover_from_any_attitude_with_the_sample_rates_and_delay_of_the_paper(tmp_path):
    """The vehicles start at rest: upside down, at 178° about several axes, and at a hundred random attitudes."""
    path = tmp_path / "recovery.yaml"
    path.write_text(RECOVERY_SCENARIO)
    rotation_vectors = math.radians(178.0) * np.array([[1.0, 0.0, 0.0], [0.48, 0.8, 0.36], [-0.8, 0.6, 0.0]])
    fixed_rotations = scipy.spatial.transform.Rotation.from_rotvec(rotation_vectors).as_matrix()
    random_rotations = scipy.spatial.transform.Rotation.random(100, random_state=1).as_matrix()
    attitudes = [angles_of(R) for R in (*fixed_rotations, *random_rotations)]

    scenario = load_scenario(path)
    diagram = build_fleet_diagram(Batch.draw(scenario, range(len(attitudes))), plan_route(scenario))
    simulator = Simulator(diagram)
    vehicle = subsystem(diagram, ["laboratory", "vehicle"])
    context = vehicle.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    begin = vehicle.get_state(context, "state")
    roll, pitch, yaw = np.transpose(attitudes)
    vehicle.set_state(context, "state", begin._replace(roll=roll, pitch=pitch, yaw=yaw))
    fly(simulator, 30.0)
    end = vehicle.get_state(context, "state")
    np.testing.assert_allclose(np.transpose([end.x, end.y, end.z]), [HOVER_POSITION] * len(attitudes), atol=0.05)
    np.testing.assert_allclose([end.v_x, end.v_y, end.v_z], 0.0, atol=0.05)
    np.testing.assert_allclose([np.cos(end.roll) * np.cos(end.pitch), np.cos(end.yaw)], 1.0, atol=1e-4)


COMMANDED_ATTITUDE = Attitude(0.2, -0.3, 0.7)  # rad
MEASURED_STATE = State(
    x=0.0, y=0.0, z=0.0, roll=-0.4, pitch=0.5, yaw=1.1, v_x=0.0, v_y=0.0, v_z=0.0, p=0.3, q=-0.2, r=0.6
)
PARAMETERS_WITH_INTEGRAL = IntegratingAttitudeParameters(
    attitude=AttitudeParameters(PerAngle(17.0, 14.0, 5.0), PerAngle(7.5, 6.8, 3.1), *INERTIA),
    k_i=PerAngle(9.0, 7.0, 5.0),
    limit=0.35,
)


def rotation_error():
    """Return the rotation error ½ (R_dᵀ R - Rᵀ R_d)^∨, computed with SciPy's rotations."""
    R_d, R = (
        scipy.spatial.transform.Rotation.from_euler("ZYX", [each.yaw, each.pitch, each.roll]).as_matrix()
        for each in (COMMANDED_ATTITUDE, MEASURED_STATE)
    )
    skew = 0.5 * (R_d.T @ R - R.T @ R_d)
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def test_the_integral_grows_by_gain_times_period_times_error_up_to_its_limit():
    period, before = 0.02, np.array([0.1, -0.2, 0.3])
    step = period * np.array(PARAMETERS_WITH_INTEGRAL.k_i) * rotation_error()
    after = integrated_rotation(
        AngularAcceleration(*before), MEASURED_STATE, COMMANDED_ATTITUDE, PARAMETERS_WITH_INTEGRAL, period
    )
    np.testing.assert_allclose(after, before + step, atol=1e-15)
    assert np.abs(step).min() > 0.01
    for sign in (1.0, -1.0):
        at_limit = AngularAcceleration(*(0.35 * sign * np.sign(step)))
        next_integral = np.array(
            integrated_rotation(at_limit, MEASURED_STATE, COMMANDED_ATTITUDE, PARAMETERS_WITH_INTEGRAL, period)
        )
        np.testing.assert_allclose(next_integral, at_limit if sign > 0.0 else at_limit + step, atol=1e-15)


def test_the_integral_is_subtracted_from_the_torque():
    """The subtracted torque is the moment of inertia times the integral, about each axis."""
    integral = np.array([0.1, -0.2, 0.3])
    commanded = COMMANDED_ATTITUDE, BodyRates(0.1, 0.2, 0.3), AngularAcceleration(0.4, 0.5, 0.6)
    without = geometric_law(MEASURED_STATE, *commanded, PARAMETERS_WITH_INTEGRAL.attitude)
    torque = integrating_law(AngularAcceleration(*integral), MEASURED_STATE, *commanded, PARAMETERS_WITH_INTEGRAL)
    np.testing.assert_allclose(torque, without - INERTIA * integral, atol=1e-15)


@pytest.mark.slow
def test_the_integral_compensates_an_offset_centre_of_mass(diagrams):
    """The body tilts under a PD until the torque balances the offset. An integral makes the body level again."""
    gains = "k_p: [30.0, 30.0, 5.0], k_d: [8.0, 8.0, 3.5]"
    offset = ["vehicle.centre_of_mass=[0.0, 0.002]", "duration=6"]
    roll_errors = np.empty(2)
    for i, integral in enumerate(("", ", k_i: [30.0, 30.0, 2.0]")):
        attitude = f"control.attitude={{kind: geometric, {gains}{integral}}}"
        flight = simulate(load_scenario(diagrams / "hover.yaml", [attitude, *offset]), compiled=True)
        roll_error = flight.record("attitude_command").roll - flight.record("state").roll
        roll_errors[i] = np.abs(roll_error[-50:]).max()
    assert roll_errors[0] > 0.02
    assert roll_errors[1] < 0.02 * roll_errors[0]
