"""Tests of attitude and rate loops on board: comparison with independent equations, and flights."""

import numpy as np
import pytest
import scipy.signal
from pydrake.systems.analysis import Simulator
from scipy.spatial.transform import Rotation

from drake_quad import load_scenario, simulate
from drake_quad.pid.filters import butterworth, first_order
from drake_quad.pid.loop import Derivative, Integral, Terms
from drake_quad.signals import AttitudeTarget, BodyRates, State
from drake_quad.vehicle.autopilot import (
    AttitudeAutopilot,
    AutopilotMemory,
    AutopilotParameters,
    Gyroscope,
    LeanError,
    LoopAxisTerms,
    LoopGains,
    LoopRules,
    NeglectedDrag,
    SensorNoise,
    autopilot_step,
    estimated_attitude_and_rates,
    next_lean_error,
    wrench_without_torque,
)
from drake_quad.vehicle.parameters import Inertia

I_XX, I_YY, I_ZZ = 0.0065, 0.0085, 0.0126  # kg m²
AUTOPILOT_PARAMETERS = AutopilotParameters(
    LoopGains(6.0, 5.5, 2.8),
    LoopGains(14.0, 12.0, 9.0),
    Inertia(I_XX, I_YY, I_ZZ),
    Gyroscope(0.004, BodyRates(0.01, -0.02, 0.03)),
    0.002,
)
TARGET = AttitudeTarget(6.6, 0.1, -0.2, 3.0, 0.3, 0.4, -0.5)
STATE = State(1.0, 2.0, 3.0, 0.15, -0.1, -3.1, 0.1, 0.2, 0.3, 0.7, -0.9, 1.1)

NO_CAMERA_NOISE = "laboratory.motion_capture={position_noise: 0, attitude_noise: 0}"


def wrench_of(noise, parameters):
    """Return the wrench of an autopilot without an internal state."""
    wrench, memory = autopilot_step(TARGET, STATE, noise, parameters, None, 0.0025)
    assert memory is None
    return wrench


def expected_wrench(target, state, parameters, noise=((0.0,) * 3, (0.0,) * 3)):
    """Return the wrench by the equations of the two proportional loops, with vectors and matrices."""
    inertia = np.diag(parameters.inertia)
    rates = np.array(state[9:12]) + parameters.gyroscope.bias + parameters.gyroscope.noise * np.array(noise[0])
    error = np.array(target[1:4]) - np.array(state[3:6]) - parameters.attitude_noise * np.array(noise[1])
    error[2] -= 2.0 * np.pi * np.round(error[2] / (2.0 * np.pi))
    rate_command = np.array(target[4:]) + np.array(parameters.k_attitude) * error
    torque = inertia @ (np.array(parameters.k_rate) * (rate_command - rates)) + np.cross(rates, inertia @ rates)
    return [target[0], *torque]


def test_the_wrench_agrees_with_two_proportional_loops():
    """The shorter rotation from a yaw of -3.1 rad to a yaw of 3.0 rad is -0.18 rad."""
    np.testing.assert_allclose(
        wrench_of(None, AUTOPILOT_PARAMETERS), expected_wrench(TARGET, STATE, AUTOPILOT_PARAMETERS), rtol=1e-13
    )
    noise = SensorNoise((0.7, -1.2, 0.4), (1.1, -0.3, 0.9))
    noisy_wrench = wrench_of(noise, AUTOPILOT_PARAMETERS)
    np.testing.assert_allclose(noisy_wrench, expected_wrench(TARGET, STATE, AUTOPILOT_PARAMETERS, noise), rtol=1e-13)
    np.testing.assert_array_equal(wrench_without_torque(TARGET), [6.6, 0.0, 0.0, 0.0])


class Px4Rates:
    """PX4's RateControl with the filters of its gyroscope, in PX4's order of operations. All axes are equal."""

    def __init__(self, period, gains, limit, cutoffs):
        self.period, self.gains, self.limit = period, gains, limit
        self.low_pass = scipy.signal.butter(2, cutoffs[0], fs=2.0 * np.pi / period)
        self.filter_state = np.zeros((3, 2))
        self.fraction = cutoffs[1] * period / (1.0 + cutoffs[1] * period)
        self.previous_rates = None
        self.acceleration, self.integral = np.zeros(3), np.zeros(3)

    def update(self, measured_rates, rate_command):
        rates = np.zeros(3)
        for axis in range(3):
            (rates[axis],), self.filter_state[axis] = scipy.signal.lfilter(
                *self.low_pass, [measured_rates[axis]], zi=self.filter_state[axis]
            )
        if self.previous_rates is not None:
            self.acceleration += self.fraction * ((rates - self.previous_rates) / self.period - self.acceleration)
        self.previous_rates = rates
        k_p, k_i, k_d, k_ff = self.gains
        error = rate_command - rates
        torque = k_p * error + self.integral - k_d * self.acceleration + k_ff * rate_command
        integration_fraction = np.maximum(0.0, 1.0 - (error / np.radians(400.0)) ** 2)
        self.integral = np.clip(
            self.integral + integration_fraction * k_i * error * self.period, -self.limit, self.limit
        )
        return torque


def test_the_rate_loop_agrees_with_px4_at_each_tick():
    period, gains, limit, cutoffs = 0.0025, (14.0, 30.0, 0.3, 0.2), 2.5, (250.0, 120.0)
    k_p, k_i, k_d, k_ff = gains
    terms = Terms(Integral(k_i, limit, np.radians(400.0)), Derivative(k_d, first_order(cutoffs[1], period)), k_ff)
    parameters = AUTOPILOT_PARAMETERS._replace(
        k_rate=LoopGains(k_p, k_p, k_p),
        gyroscope=Gyroscope(),
        rate=LoopAxisTerms(terms, terms, terms),
        gyroscope_filter=butterworth(cutoffs[0], period),
        max_rates=BodyRates(2.0, 1.0, 0.5),
    )
    px4, memory, rng = Px4Rates(period, gains, limit, cutoffs), AutopilotMemory.of(parameters), np.random.default_rng(4)
    num_limited = 0
    for tick in range(200):
        rates = np.array([3.0, -2.0, 0.4]) * np.sin(0.05 * tick) + 0.3 * rng.normal(size=3)
        state = STATE._replace(p=rates[0], q=rates[1], r=rates[2])
        target = TARGET._replace(roll=0.3 * np.sin(0.03 * tick), q=3.0 * rng.normal())
        rate_command = np.array(target[4:]) + np.array(parameters.k_attitude) * [
            target.roll - state.roll,
            target.pitch - state.pitch,
            target.yaw - state.yaw - 2.0 * np.pi,
        ]
        limited_command = np.clip(rate_command, [-2.0, -1.0, -0.5], [2.0, 1.0, 0.5])
        num_limited += np.any(rate_command != limited_command)
        wrench, memory = autopilot_step(target, state, None, parameters, memory, period, LoopRules(gyroscopic=False))
        expected = np.array(parameters.inertia) * px4.update(rates, limited_command)
        np.testing.assert_allclose(wrench[1:], expected, rtol=1e-9, atol=1e-9)
    assert num_limited > 20
    assert np.abs(px4.integral).max() == limit


def test_an_attitude_estimator_that_neglects_drag_mistakes_drag_for_tilt():
    """The error follows the neglected drag with a first-order lag while the velocity is constant."""
    drag, period = NeglectedDrag(0.04, 0.5), 0.002
    error = LeanError(0.0, 0.0)
    state = STATE._replace(v_x=1.5, v_y=-0.8)
    for _ in range(200):
        error = next_lean_error(error, state, drag, period)
    np.testing.assert_allclose(error, -0.04 * np.array([1.5, -0.8]) * (1.0 - np.exp(-200 * period / 0.5)), rtol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, 0.5 * np.pi, 2.3])
def test_the_estimated_thrust_direction_has_the_error_of_the_estimator_along_x_and_y(yaw):
    """The angles are small, and the yaw is arbitrary."""

    def direction(attitude):
        return Rotation.from_euler("ZYX", [attitude.yaw, attitude.pitch, attitude.roll]).apply([0.0, 0.0, 1.0])

    state = STATE._replace(roll=0.0, pitch=0.0, yaw=yaw)
    exact_attitude, _ = estimated_attitude_and_rates(state, None, AUTOPILOT_PARAMETERS)
    estimated_attitude, _ = estimated_attitude_and_rates(state, None, AUTOPILOT_PARAMETERS, LeanError(-2e-3, 1e-3))
    np.testing.assert_allclose(
        (direction(estimated_attitude) - direction(exact_attitude))[:2], [-2e-3, 1e-3], atol=1e-8
    )
    assert estimated_attitude.yaw == exact_attitude.yaw


def test_sensors_of_the_autopilot_are_exact_by_default():
    parameters = AutopilotParameters(
        AUTOPILOT_PARAMETERS.k_attitude, AUTOPILOT_PARAMETERS.k_rate, AUTOPILOT_PARAMETERS.inertia
    )
    noise = SensorNoise((0.7, -1.2, 0.4), (1.1, -0.3, 0.9))
    assert wrench_of(noise, parameters) == wrench_of(None, parameters)
    assert parameters.gyroscope.bias == parameters.initial[1:] == (0.0, 0.0, 0.0)


def test_target_and_state_are_sampled_at_ticks_and_the_wrench_is_constant_between_them():
    autopilot = AttitudeAutopilot(period=0.005, parameters=AUTOPILOT_PARAMETERS)
    simulator = Simulator(autopilot)
    context = simulator.get_mutable_context()
    targets = [TARGET, TARGET._replace(thrust=7.0, roll=0.3)]
    for name, value in (("attitude_target", targets[0]), ("state", STATE)):
        autopilot.GetInputPort(name).FixValue(context, list(value))
    wrench = autopilot.GetOutputPort("wrench")
    np.testing.assert_array_equal(wrench.Eval(context), np.zeros(4))
    simulator.AdvanceTo(0.001)
    np.testing.assert_allclose(
        wrench.Eval(context), expected_wrench(targets[0], STATE, AUTOPILOT_PARAMETERS), rtol=1e-13
    )
    autopilot.GetInputPort("attitude_target").FixValue(context, list(targets[1]))
    simulator.AdvanceTo(0.0049)
    np.testing.assert_allclose(
        wrench.Eval(context), expected_wrench(targets[0], STATE, AUTOPILOT_PARAMETERS), rtol=1e-13
    )
    simulator.AdvanceTo(0.0051)
    np.testing.assert_allclose(
        wrench.Eval(context), expected_wrench(targets[1], STATE, AUTOPILOT_PARAMETERS), rtol=1e-13
    )


@pytest.mark.slow
def test_a_gyroscope_bias_causes_a_steady_attitude_error(diagrams):
    """The bias equals k_attitude (φ_r - φ) in equilibrium, apart from the effect of ω × I ω."""
    bias = np.array([0.02, -0.03, 0.01])
    flight = simulate(
        load_scenario(
            diagrams / "onboard.yaml",
            [
                "route={kind: hover, position: [0, 0, 1], duration: 20}",
                f"laboratory.autopilot={{gyroscope_noise: 0, gyroscope_bias: {bias.tolist()}}}",
                NO_CAMERA_NOISE,
                "laboratory.command_link.loss_rate=0",
            ],
        ),
        compiled=True,
    )
    autopilot, inertia = flight.scenario.laboratory.autopilot, np.array(flight.scenario.nominal.inertia)
    rate_error = bias - np.cross(bias, inertia * bias) / (inertia * np.array(autopilot.k_rate))
    error = flight["attitude_command"][-1] - flight["state"][-1, 3:6]
    np.testing.assert_allclose(error, rate_error / np.array(autopilot.k_attitude), rtol=1e-6)
    np.testing.assert_allclose(flight["state"][-1, 3:5], 0.0, atol=1e-8)


@pytest.mark.long
def test_the_link_does_not_delay_the_attitude_loop_on_board(diagrams):
    """The yaw decays in the same way for any delay of the link, because no position loop affects it."""
    yaws = []
    for delay in (0, 5):
        flight = simulate(
            load_scenario(
                diagrams / "onboard.yaml",
                [
                    "route={kind: hover, position: [0, 0, 1], duration: 2}",
                    NO_CAMERA_NOISE,
                    f"laboratory.command_link={{delay_ticks: {delay}, loss_rate: 0}}",
                    "laboratory.autopilot={gyroscope_noise: 0, gyroscope_bias: [0, 0, 0.2]}",
                ],
            ),
            compiled=True,
        )
        yaws.append(flight.record("state").yaw)
    assert np.abs(yaws[0]).max() > 0.02
    # The yaws differ slightly. The yaw loop changes the rotor speeds, and thereby disturbs the thrust and the height.
    # The height loop reacts over the link, so its effect on the rotor speeds depends on the delay.
    np.testing.assert_allclose(yaws[0], yaws[1], atol=1e-6)


@pytest.mark.parametrize("noisy", [False, True])
def test_an_autopilot_uses_random_numbers_only_if_its_sensors_are_noisy(noisy):
    assert AttitudeAutopilot(noisy=noisy, parameters=AUTOPILOT_PARAMETERS).HasInputPort("sensor_noise") is noisy
