"""Comparison of operating points and linear models of the vehicle with analytical matrices and finite differences."""

import math

import numpy as np
import pytest

from drake_quad import InputError
from drake_quad.linear.modes import modes
from drake_quad.linear.vehicle_model import (
    INPUTS,
    OUTPUTS,
    STATES,
    affine_vehicle,
    find_trim,
    linear_vehicle,
    to_state_space,
)
from drake_quad.signals import RotorSpeed, State, Wind
from drake_quad.vehicle.effects import NO_EFFECTS
from drake_quad.vehicle.parameters import CentreOfMass, QuadrotorParameters
from drake_quad.vehicle.quadrotor import KINEMATICS
from drake_quad.vehicle.rotors import Rotors
from drake_quad.vehicle.stepping import VehicleState, quadrotor_derivatives

VEHICLE_WITH_DRAG = QuadrotorParameters(
    linear_drag=0.1, quadratic_drag=0.01, centre_of_mass=CentreOfMass(0.003, -0.002)
)


def hover_by_hand(c):
    """Return A and B in hover, from eqs (1) to (5) with rotor lag, for Table I and a linear drag c."""
    m, g, b, d, arm, lag = 0.68, 9.81, 4.13e-5, 8.5e-7, 0.17, 0.05
    inertia = (0.007, 0.007, 0.012)
    speed = math.sqrt(m * g / (4.0 * b))
    A, B = np.zeros((16, 16)), np.zeros((16, 7))
    A[0:3, 6:9] = np.eye(3)
    A[3:6, 9:12] = np.eye(3)
    A[6, 4], A[7, 3] = g, -g
    A[6:9, 6:9], B[6:9, 4:7] = -c / m * np.eye(3), c / m * np.eye(3)
    A[8, 12:16] = 2.0 * b * speed / m
    A[9, 12:16] = 2.0 * arm * b * speed / inertia[0] * np.array([0.0, -1.0, 0.0, 1.0])
    A[10, 12:16] = 2.0 * arm * b * speed / inertia[1] * np.array([-1.0, 0.0, 1.0, 0.0])
    A[11, 12:16] = 2.0 * d * speed / inertia[2] * np.array([1.0, -1.0, 1.0, -1.0])
    A[12:16, 12:16], B[12:16, 0:4] = -np.eye(4) / lag, np.eye(4) / lag
    return A, B


@pytest.mark.parametrize("drag", [0.0, 0.15])
def test_the_model_in_hover_matches_matrices_by_hand(drag):
    """The matrices agree to 1e-12."""
    parameters = QuadrotorParameters(linear_drag=drag)
    system = linear_vehicle(find_trim(parameters), parameters)
    A, B = hover_by_hand(drag)
    np.testing.assert_allclose(system.A(), A, atol=1e-12, rtol=0.0)
    np.testing.assert_allclose(system.B(), B, atol=1e-12, rtol=0.0)
    np.testing.assert_array_equal(system.C(), np.eye(12, 16))


def test_the_model_of_an_x_layout_in_hover_matches_matrices_by_hand():
    """All four rotors roll and pitch the vehicle. Rotors 2 and 4 have the opposite yaw torque."""
    length, width, b, d, speed = 0.2, 0.3, 4.13e-5, 8.5e-7, math.sqrt(0.68 * 9.81 / (4.0 * 4.13e-5))
    parameters = QuadrotorParameters(rotors=Rotors.x(length=length, width=width))
    system = linear_vehicle(find_trim(parameters), parameters)
    A, B = hover_by_hand(0.0)
    A[9, 12:16] = width * b * speed / 0.007 * np.array([-1.0, -1.0, 1.0, 1.0])
    A[10, 12:16] = length * b * speed / 0.007 * np.array([-1.0, 1.0, 1.0, -1.0])
    A[11, 12:16] = 2.0 * d * speed / 0.012 * np.array([1.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(system.A(), A, atol=1e-12, rtol=0.0)
    np.testing.assert_allclose(system.B(), B, atol=1e-12, rtol=0.0)


@pytest.mark.parametrize("kinematics", ["exact", "small_angle"])
def test_the_model_of_a_moving_vehicle_matches_finite_differences(kinematics):
    trim = find_trim(
        VEHICLE_WITH_DRAG, velocity=(4.0, 2.0, -1.0), wind=(1.0, -2.0, 0.5), yaw=0.6, kinematics=kinematics
    )
    system = affine_vehicle(trim, VEHICLE_WITH_DRAG, kinematics=kinematics)
    point = np.concatenate([trim.state, trim.rotor_speed, trim.rotor_speed, trim.wind])

    def rates(x):
        state = VehicleState(State(*x[:12]), RotorSpeed(*x[12:16]))
        inputs = RotorSpeed(*x[16:20]), Wind(*x[20:]), None
        slope = quadrotor_derivatives(state, *inputs, VEHICLE_WITH_DRAG, None, NO_EFFECTS, 0.0, KINEMATICS[kinematics])
        return np.hstack([slope.body, slope.rotors])

    steps = 1e-6 * np.maximum(1.0, np.abs(point))
    numeric = np.array([(rates(point + h * e) - rates(point - h * e)) / (2.0 * h) for h, e in zip(steps, np.eye(23))]).T
    np.testing.assert_allclose(np.hstack([system.A(), system.B()]), numeric, atol=1e-6)
    # The operating point is a straight flight: the affine model returns the velocity as the derivative of the position,
    # and zero as the derivative of each other state.
    rate = system.A() @ point[:16] + system.B() @ point[16:] + system.f0()
    np.testing.assert_allclose(rate[:3], [4.0, 2.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(rate[3:], 0.0, atol=1e-8)


def test_a_trim_leans_into_the_wind():
    """The tilt θ satisfies tan θ = D / (m g), with the drag D.

    The thrust balances drag and weight, and the torques balance the offset of the centre of mass.
    """
    wind = np.array([6.0, -3.0, 0.0])
    trim = find_trim(VEHICLE_WITH_DRAG, wind=tuple(wind))
    speed = np.linalg.norm(wind)
    force = (0.1 + 0.01 * speed) * wind
    roll, pitch = trim.state[3:5]
    assert math.tan(pitch) == pytest.approx(-force[0] / (0.68 * 9.81), rel=1e-9)
    thrust = 4.13e-5 * np.sum(trim.rotor_speed**2)
    assert thrust == pytest.approx(math.hypot(0.68 * 9.81, *force), rel=1e-9)
    assert math.sin(roll) == pytest.approx(force[1] / thrust, rel=1e-9)
    lifts = 4.13e-5 * trim.rotor_speed**2
    assert 0.17 * (lifts[3] - lifts[1]) == pytest.approx(-0.002 * thrust, rel=1e-9)


def test_a_point_that_is_not_an_equilibrium_is_refused_with_its_acceleration():
    parameters = QuadrotorParameters()
    with pytest.raises(InputError, match="not an equilibrium: x changes by 3 per second"):
        linear_vehicle(find_trim(parameters, velocity=(3.0, 0.0, 0.0)), parameters)
    hover = find_trim(parameters)
    with pytest.raises(InputError, match=r"not an equilibrium: v_z changes by -?0\.\d+ per second"):
        linear_vehicle(hover._replace(rotor_speed=0.99 * hover.rotor_speed), parameters)
    with pytest.raises(
        InputError, match=r"no steady flight at \(60, 0, 0\) m/s .* the smallest remaining acceleration is"
    ):
        find_trim(VEHICLE_WITH_DRAG, velocity=(60.0, 0.0, 0.0))


def test_names_are_passed_to_python_control():
    parameters = QuadrotorParameters(linear_drag=0.1)
    system = linear_vehicle(find_trim(parameters), parameters)
    model = to_state_space(system)
    assert (model.nstates, model.ninputs, model.noutputs) == (len(STATES), len(INPUTS), len(OUTPUTS)) == (16, 7, 12)
    assert model.state_labels[4] == "pitch"
    assert model.input_labels[4] == "wind_x"
    from_wind = model["state_v_x", "wind_x"]
    assert abs(from_wind(1j * 1e-3)) == pytest.approx(1.0, rel=1e-3), (
        "in a steady wind the vehicle drifts at the speed of the air"
    )


def test_a_vehicle_in_hover_has_integrators_and_the_lags_of_its_rotors():
    parameters = QuadrotorParameters()
    system = linear_vehicle(find_trim(parameters), parameters)
    found_modes = modes(system.A(), STATES)
    assert [(mode.multiplicity, round(mode.frequency)) for mode in found_modes] == [(12, 0), (4, 20)]
    assert set(found_modes[0].states) == set(STATES[:12])


def test_different_slow_modes_are_distinguished():
    """The discrete-time eigenvalues of these modes are nearly the same."""
    A = np.diag(np.exp(np.array([-0.30, -0.33, -0.33, -20.0]) * 0.02))
    found_modes = modes(A, ("a", "b", "c", "d"), period=0.02)
    assert [(round(mode.pole.real, 6), mode.multiplicity) for mode in found_modes] == [
        (-0.3, 1),
        (-0.33, 2),
        (-20.0, 1),
    ]
    assert [set(mode.states) for mode in found_modes] == [{"a"}, {"b", "c"}, {"d"}]


@pytest.mark.parametrize(("swing", "multiplicity"), [(0.003, 2), (0.007, 1), (0.012, 1)])
def test_a_slow_swing_is_one_mode(swing, multiplicity):
    """The distance of its two poles may be smaller or larger than the tolerance for equal poles."""
    (mode,) = modes(np.array([[-1.0, swing], [-swing, -1.0]]), ("a", "b"))
    assert mode.multiplicity == multiplicity
    assert mode.pole.imag >= 0.0


def test_modes_are_named_by_their_participating_states():
    """One oscillator has a damping ratio of 0.1 at 2 rad/s, the other 0.5 at 5 rad/s, before and after sampling."""
    A = np.zeros((4, 4))
    A[0, 1], A[1, :2] = 1.0, (-4.0, -0.4)
    A[2, 3], A[3, 2:] = 1.0, (-25.0, -5.0)
    T = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    for period in (None, 0.05):
        values, vectors = np.linalg.eig(A)
        sampled = A if period is None else (vectors @ np.diag(np.exp(values * period)) @ np.linalg.inv(vectors)).real
        slow, fast = modes(sampled, ("a", "b", "c", "d"), period=period)
        assert (slow.frequency, slow.damping) == pytest.approx((2.0, 0.1))
        assert (fast.frequency, fast.damping) == pytest.approx((5.0, 0.5))
        assert set(slow.states) == {"a", "b"}
        assert set(fast.states) == {"c", "d"}
        assert [mode.frequency for mode in modes(T @ sampled @ T.T, ("a", "b", "c", "d"), period=period)] == (
            pytest.approx([2.0, 5.0])
        )


HOVER_SPEED = math.sqrt(0.68 * 9.81 / (4.0 * 4.13e-5))  # rad/s


@pytest.mark.parametrize(("low", "high"), [(60.0, 0.9995 * HOVER_SPEED), (1.0005 * HOVER_SPEED, 300.0)])
def test_rotors_that_are_slightly_too_slow_or_too_fast_cannot_trim_the_vehicle(low, high):
    """The rotor limits leave an acceleration of a thousandth of g, so there is no equilibrium."""
    parameters = QuadrotorParameters(min_rotor_speed=low, max_rotor_speed=high)
    with pytest.raises(
        InputError, match=rf"rotors between {low:g} and {high:g} rad/s; .* acceleration is 0\.0098\d? m/s²"
    ):
        find_trim(parameters)
    wide_enough = QuadrotorParameters(min_rotor_speed=0.9995 * HOVER_SPEED, max_rotor_speed=1.0005 * HOVER_SPEED)
    np.testing.assert_allclose(find_trim(wide_enough).rotor_speed, HOVER_SPEED, rtol=1e-12)


@pytest.mark.parametrize(("tilt", "exists"), [(1.39, True), (1.41, False)])
def test_operating_points_are_found_up_to_a_tilt_of_80_degrees(tilt, exists):
    """The largest tilt is 1.4 rad, for wind from any direction."""
    parameters = QuadrotorParameters(linear_drag=1.0, max_rotor_speed=2000.0)
    speed = 0.68 * 9.81 * math.tan(tilt)
    for wind, angle in (((speed, 0.0, 0.0), 4), ((0.0, speed, 0.0), 3), ((-speed, 0.0, 0.0), 4)):
        if exists:
            assert abs(find_trim(parameters, wind=wind).state[angle]) == pytest.approx(tilt)
        else:
            with pytest.raises(InputError, match="there is no steady flight"):
                find_trim(parameters, wind=wind)


def test_a_trim_has_the_requested_position_and_yaw():
    trim = find_trim(
        VEHICLE_WITH_DRAG, position=(1.0, -2.0, 3.0), velocity=(0.5, 0.25, -0.125), wind=(0.1, 0.2, 0.3), yaw=0.6
    )
    np.testing.assert_array_equal(trim.state[[0, 1, 2, 5]], [1.0, -2.0, 3.0, 0.6])
    np.testing.assert_array_equal(trim.state[6:], [0.5, 0.25, -0.125, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(trim.wind, [0.1, 0.2, 0.3])
    assert (trim.state.shape, trim.rotor_speed.shape) == ((12,), (4,))
    at_rest = find_trim(QuadrotorParameters())
    np.testing.assert_allclose(at_rest.state, 0.0, atol=1e-12)
    np.testing.assert_array_equal(at_rest.wind, np.zeros(3))


def test_a_linear_model_requires_state_derivatives_below_a_millionth():
    parameters = QuadrotorParameters()
    hover = find_trim(parameters)
    for speed, refused in ((0.9e-6, False), (1.1e-6, True)):
        state = hover.state.copy()
        state[7] = speed
        if refused:
            with pytest.raises(InputError, match=r"not an equilibrium: y changes by 1\.1e-06 per second"):
                linear_vehicle(hover._replace(state=state), parameters)
        else:
            linear_vehicle(hover._replace(state=state), parameters)


def test_inputs_and_outputs_are_named_after_their_signals():
    assert STATES[:4] == ("x", "y", "z", "roll")
    assert STATES[11:] == ("r", *(f"rotor_speed.rotor_{number}" for number in (1, 2, 3, 4)))
    assert INPUTS[3:5] == ("rotor_speed_command.rotor_4", "wind.x")
    assert OUTPUTS[0] == "state.x"
