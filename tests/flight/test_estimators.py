"""Tests of disturbance estimators in closed loop, by closed forms of the error in steady wind."""

import math

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.signals import Acceleration, Reference, State

PD_GAINS = "k_p: [4.0, 3.5, 6.0], k_d: [3.5, 3.2, 4.0], feed_forward: snap"
# Model of the vehicle's response that the estimators use.
RESPONSE = "response: {kind: commanded, lag: [0.25, 0.26, 0.07]}"
HEAVY_VEHICLE_IN_WIND = [
    "vehicle.mass=0.71",
    "laboratory.wind=[{kind: steady, velocity: [2.5, -1.6, 0.4]}]",
    "control.attitude={k_p: [25.0, 25.0, 5.4], k_d: [9.0, 9.0, 3.5]}",
]


@pytest.fixture(scope="module")
def settled(diagrams):
    """Return a function that computes the error, the estimated disturbance and the command of a controller at rest.

    The vehicle hovers in steady wind, and is heavier than its nominal model.
    """

    def settle(position):
        scenario = load_scenario(
            diagrams / "laboratory.yaml:nominal", [*HEAVY_VEHICLE_IN_WIND, f"control.position={position}"]
        )
        loop = closed_loop(scenario)

        def signal(name):
            return loop.diagram.GetOutputPort(name).Eval(loop.context)

        state, reference = State(*signal("state")), Reference(*signal("reference"))
        error = np.array([reference.x - state.x, reference.y - state.y, reference.z - state.z])
        disturbance = signal("disturbance") if loop.diagram.HasOutputPort("disturbance") else None
        return error, disturbance, Acceleration(*signal("acceleration_command"))

    return settle


@pytest.mark.long
def test_the_errors_of_indi_and_l1_in_steady_wind_have_closed_forms(settled):
    """At rest, the command u compensates the disturbance. The error is u / k_P with a PD alone, and zero with INDI.

    With the adaptation rate a and the tick h, the error with L1 is 1 - exp(-a h) times the error with the PD alone.
    """
    pd_error, no_estimate, command = settled(f"{{kind: pd, {PD_GAINS}}}")
    assert no_estimate is None
    assert np.abs(pd_error).min() > 0.01
    np.testing.assert_allclose(np.array([4.0, 3.5, 6.0]) * pd_error, command, atol=1e-8)
    error, disturbance, indi_command = settled(f"{{kind: indi, {PD_GAINS}, {RESPONSE}, bandwidth: [2.0, 2.2, 3.0]}}")
    np.testing.assert_allclose(error, 0.0, atol=1e-7)
    np.testing.assert_allclose(disturbance, -np.array(indi_command), atol=1e-7)
    np.testing.assert_allclose(indi_command, command, rtol=1e-6)
    l1_error, _, _ = settled(f"{{kind: l1, {PD_GAINS}, {RESPONSE}, bandwidth: [1.5, 1.7, 2.0], adaptation: 5.0}}")
    np.testing.assert_allclose(l1_error, (1.0 - math.exp(-5.0 * 0.02)) * pd_error, rtol=1e-5)


@pytest.mark.slow
def test_the_error_of_a_kalman_filter_falls_as_its_disturbance_time_constant_grows(settled):
    parameters = "position_noise: 0.001, deviation: [0.3, 0.3, 0.3]"

    def remaining_error(T):
        return settled(
            f"{{kind: disturbance_observer, {PD_GAINS}, {RESPONSE}, {parameters}, time_constant: [{T}, {T}, {T}]}}"
        )[0]

    pd_error, _, _ = settled(f"{{kind: pd, {PD_GAINS}}}")
    fractions = [np.abs(remaining_error(T) / pd_error).max() for T in (0.5, 5.0, 5000.0)]
    assert fractions[0] < 0.5
    assert fractions[1] < 0.2 * fractions[0]
    assert fractions[2] < 1e-3


@pytest.mark.slow
def test_the_compensated_disturbance_is_limited(settled):
    """The PD compensates the part of the disturbance that exceeds the limit of the estimate."""
    parameters = f"{PD_GAINS}, {RESPONSE}, bandwidth: [2.0, 2.2, 3.0], disturbance_limit: 0.05"
    error, disturbance, command = settled(f"{{kind: indi, {parameters}}}")
    np.testing.assert_allclose(np.abs(disturbance), 0.05)
    np.testing.assert_allclose(np.array([4.0, 3.5, 6.0]) * error - disturbance, command, atol=1e-8)
