"""Tests of INDI of the attitude on its own model, with an unknown torque."""

import numpy as np
import pytest
import scipy

from drake_quad.control.attitude import AttitudeParameters, attitude_law
from drake_quad.control.disturbance.laws import IncrementalLaw
from drake_quad.control.disturbance.response import AxisCommand
from drake_quad.control.incremental_attitude import (
    IncrementalAttitudeParameters,
    incremental_torque,
    next_incremental_memory,
)
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.signals import AngularAcceleration, Attitude, BodyRates, State

H = 0.02  # s, control tick
LAG = 0.05  # s
INERTIA = np.array([0.0065, 0.0085, 0.0126])  # kg m²
# Gains k_P in 1/s² and k_D in 1/s, and moments of inertia in kg m².
GAINS = AttitudeParameters(PerAngle(17.0, 14.0, 5.0), PerAngle(7.5, 6.8, 3.1), *INERTIA)
PARAMETERS = IncrementalAttitudeParameters(attitude=GAINS, law=IncrementalLaw(5.0), lag=LAG, limit=20.0)
LEVEL_COMMAND = Attitude(0.0, 0.0, 0.0), BodyRates(0.0, 0.0, 0.0), AngularAcceleration(0.0, 0.0, 0.0)
DISTURBING_ACCELERATION = np.array([0.9, -0.7, 0.4])  # rad/s²


def state_after_settling(law_of):
    """Return angles and rates after eight seconds with a constant disturbing angular acceleration.

    The vehicle follows the commanded angular acceleration with the modelled lag.
    """
    angles, rates, modelled_response = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(400):
        measurement = State(0.0, 0.0, 0.0, *angles, 0.0, 0.0, 0.0, *rates)
        command = np.array(law_of(measurement)) / INERTIA
        for _ in range(25):
            modelled_response += H / 25 / LAG * (command - modelled_response)
            rates += H / 25 * (modelled_response + DISTURBING_ACCELERATION)
            angles += H / 25 * rates
    return angles, rates


def test_a_constant_torque_deflects_a_pd_but_not_indi():
    angles, rates = state_after_settling(lambda measurement: attitude_law(measurement, *LEVEL_COMMAND, GAINS))
    np.testing.assert_allclose(angles, DISTURBING_ACCELERATION / np.array(GAINS.k_p), rtol=1e-3)
    initial_states = ((PARAMETERS.law.initial_memory(0.0),) * 3, (AxisCommand(0.0, 0.0),) * 3)
    states = [initial_states]

    def incremental(measurement):
        memory, modelled_response = states.pop()
        arguments = measurement, *LEVEL_COMMAND, PARAMETERS, H
        states.append(next_incremental_memory(memory, modelled_response, (), *arguments)[:2])
        return incremental_torque(memory, *arguments)

    angles, rates = state_after_settling(incremental)
    np.testing.assert_allclose([angles, rates], 0.0, atol=1e-3)
    # The estimated disturbance is the measured acceleration that the model does not explain.
    (memory, _) = states.pop()
    assert [each.disturbance for each in memory] == pytest.approx(DISTURBING_ACCELERATION, rel=1e-2)


def test_the_indi_torque_without_a_disturbance_equals_the_pd_torque():
    """The estimated disturbance is zero at the first tick if all rates are zero."""
    measurement = State(0.0, 0.0, 0.0, 0.1, -0.2, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    desired = Attitude(0.2, 0.1, -0.3), BodyRates(0.5, -0.4, 0.3), AngularAcceleration(1.0, 2.0, -3.0)
    memory = (PARAMETERS.law.initial_memory(0.0),) * 3
    expected = attitude_law(measurement, *desired, GAINS)
    assert incremental_torque(memory, measurement, *desired, PARAMETERS, H) == expected


def test_the_torque_follows_the_equation_of_incremental_control():
    """The torque is I (α_c - d) + ω_r × I ω_r, where the filter H gives d = H (ω̇ - α)."""
    rng = np.random.default_rng(2)
    bandwidth = PARAMETERS.law.bandwidth
    lag = np.array([[0.0, 1.0], [-(bandwidth**2), -np.sqrt(2.0) * bandwidth]]), np.array([[0.0], [bandwidth**2]])
    A, B, *_ = scipy.signal.cont2discrete((*lag, np.array([[1.0, 0.0]]), np.zeros((1, 1))), H)
    filtered, modelled, before = np.zeros((2, 3)), np.zeros(3), np.zeros(3)
    rate_increment = np.zeros(3)  # rad/s, change of the modelled body rates in the last tick
    memory = (PARAMETERS.law.initial_memory(0.0),) * 3
    modelled_response = (AxisCommand(0.0, 0.0),) * 3
    for _ in range(40):
        angles, rates, attitude, commanded_rates, feed_forward = rng.normal(size=(5, 3)) * [
            [0.2],
            [0.3],
            [0.2],
            [1.0],
            [3.0],
        ]
        filtered = A @ filtered + B * (rates - before - rate_increment) / H
        disturbance = filtered[0]
        desired = GAINS.k_p * (attitude - angles) + GAINS.k_d * (commanded_rates - rates) + feed_forward
        expected = INERTIA * (desired - disturbance) + np.cross(commanded_rates, INERTIA * commanded_rates)
        measurement = State(0.0, 0.0, 0.0, *angles, 0.0, 0.0, 0.0, *rates)
        requested = Attitude(*attitude), BodyRates(*commanded_rates), AngularAcceleration(*feed_forward)
        torque = incremental_torque(memory, measurement, *requested, PARAMETERS, H)
        np.testing.assert_allclose(torque, expected, rtol=0.0, atol=1e-12)
        memory, modelled_response, _ = next_incremental_memory(
            memory, modelled_response, (), measurement, *requested, PARAMETERS, H
        )
        # The model α' = (α_c - d - α) / lag is solved exactly over a tick.
        command = desired - disturbance
        decay = np.exp(-H / LAG)
        rate_increment = H * command + LAG * (1.0 - decay) * (modelled - command)
        modelled = command + decay * (modelled - command)
        before = rates
