"""Tests of the disturbance estimator that uses the measured direction of the thrust."""

import math

import numpy as np
import pytest

from drake_quad.control.disturbance.laws import IncrementalLaw, KalmanLaw
from drake_quad.control.disturbance.tilt import (
    KnownAccelerations,
    SpecificThrust,
    TiltEstimatorParameters,
    estimate_by_tilt,
    next_tilt_states,
    tilted_acceleration,
)
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, State

H = 0.02  # s, control tick
G = 9.79  # m/s²
LAWS = (IncrementalLaw(1e6),) * 3  # bandwidth of 1e6 rad/s, so that the estimate follows the measurement without a lag
PARAMETERS = TiltEstimatorParameters(laws=LAWS, lag=0.06, gravity=G, limit=50.0, start=PerAxis(0.0, 0.0, 0.0))
NO_ACCELERATION = Acceleration(0.0, 0.0, 0.0)  # m/s²


def state_at(attitude=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)):
    return State(0.0, 0.0, 0.0, *attitude, *velocity, 0.0, 0.0, 0.0)


def estimated_disturbance(before, measurement, thrust=G):
    """Return the estimated disturbance one tick after rest.

    The bandwidth of the filter is so large that the filter has no effect.
    """
    memory = tuple([law.initial_memory(0.0) for law in LAWS])
    return np.array(estimate_by_tilt(memory, before, SpecificThrust(thrust), measurement, PARAMETERS, H)[1])


def test_a_tilted_thrust_accelerates_the_vehicle_by_eq_3():
    roll, pitch, yaw = 0.3, -0.2, 1.1
    acceleration = tilted_acceleration(state_at((roll, pitch, yaw)), SpecificThrust(11.0), G)
    expected = [
        (math.sin(yaw) * math.sin(roll) + math.cos(yaw) * math.sin(pitch) * math.cos(roll)) * 11.0,
        (-math.cos(yaw) * math.sin(roll) + math.sin(yaw) * math.sin(pitch) * math.cos(roll)) * 11.0,
        math.cos(pitch) * math.cos(roll) * 11.0 - G,
    ]
    assert acceleration == pytest.approx(expected, rel=1e-12)


def test_accelerations_due_to_tilt_and_thrust_are_not_estimated_as_disturbances():
    """The estimate is zero for the known acceleration a, and 0.5 a for 1.5 times this acceleration."""
    attitude = (0.1, 0.2, 0.3)
    first, last = (
        Acceleration(0.4, -0.3, 0.2),
        np.array(tilted_acceleration(state_at(attitude), SpecificThrust(10.5), G)),
    )
    explained = 0.5 * (np.array(first) + last)
    disturbance = estimated_disturbance(
        KnownAccelerations(first, NO_ACCELERATION), state_at(attitude, H * explained), 10.5
    )
    np.testing.assert_allclose(disturbance, 0.0, atol=1e-9)
    disturbance = estimated_disturbance(
        KnownAccelerations(first, NO_ACCELERATION), state_at(attitude, 1.5 * H * explained), 10.5
    )
    np.testing.assert_allclose(disturbance, 0.5 * explained, rtol=1e-9)


def test_a_learned_disturbance_is_not_estimated_again():
    acceleration, learned = np.array([0.7, -0.5, 0.3]), Acceleration(0.6, -0.4, 0.5)
    disturbance = estimated_disturbance(
        KnownAccelerations(NO_ACCELERATION, learned), state_at(velocity=H * acceleration)
    )
    np.testing.assert_allclose(disturbance, acceleration - np.array(learned), rtol=1e-9)
    memory = tuple([law.initial_memory(0.0) for law in LAWS])
    _, before, *_ = next_tilt_states(
        memory,
        KnownAccelerations(NO_ACCELERATION, NO_ACCELERATION),
        SpecificThrust(G),
        (),
        state_at(),
        NO_ACCELERATION,
        learned,
        PARAMETERS,
        H,
    )
    assert before.learned == learned


def test_the_displacement_caused_by_known_accelerations_is_predicted():
    """The known acceleration is linear between two ticks, plus a constant learned disturbance."""
    first, last = (
        np.array([0.4, -0.3, 0.2]),
        np.array(tilted_acceleration(state_at((0.1, 0.2, 0.3)), SpecificThrust(10.5), G)),
    )
    acceleration = np.array([0.6, -0.4, 0.5])
    distance = H**2 * (first / 3.0 + last / 6.0 + acceleration / 2.0)
    law = KalmanLaw.of(deviation=1.0, time_constant=5.0, position_noise=1e-3, period=H)
    parameters = PARAMETERS._replace(laws=(law,) * 3)
    memory, before = (
        (law.initial_memory(0.0),) * 3,
        KnownAccelerations(Acceleration(*first), Acceleration(*acceleration)),
    )

    def disturbance(x, y, z):
        measurement = state_at((0.1, 0.2, 0.3))._replace(x=x, y=y, z=z)
        return estimate_by_tilt(memory, before, SpecificThrust(10.5), measurement, parameters, H)[1]

    np.testing.assert_allclose(disturbance(*distance), 0.0, atol=1e-12)
    np.testing.assert_allclose(disturbance(*(distance + 0.01)), 0.01 * law.gain.disturbance, rtol=1e-9)


def test_the_thrust_follows_the_magnitude_of_the_command_after_its_delay():
    memory, thrust, in_transit = (
        tuple([law.initial_memory(0.0) for law in LAWS]),
        SpecificThrust(G),
        (SpecificThrust(G),) * 2,
    )
    before, command, thrusts = KnownAccelerations(NO_ACCELERATION, NO_ACCELERATION), Acceleration(3.0, -2.0, 1.5), []
    for _ in range(5):
        memory, before, thrust, in_transit = next_tilt_states(
            memory, before, thrust, in_transit, state_at(), command, NO_ACCELERATION, PARAMETERS, H
        )
        thrusts.append(thrust.thrust)
    length, fraction = math.sqrt(9.0 + 4.0 + (1.5 + G) ** 2), 1.0 - math.exp(-H / 0.06)
    assert thrusts[:2] == [G, G]
    assert thrusts[2] == pytest.approx(G + fraction * (length - G), rel=1e-12)
    assert thrusts[4] == pytest.approx(length + (1.0 - fraction) ** 3 * (G - length), rel=1e-12)
