"""Tests of flights with model predictive control, with and without active limits."""

from pathlib import Path

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike, assert_metrics_alike

from drake_quad import load_scenario, simulate
from drake_quad.control.mpc.programme import Programme
from drake_quad.scenario.batch import Batch

CONTROLLERS = Path(__file__).parents[2] / "diagrams" / "controllers"
LABORATORY = CONTROLLERS.parent / "laboratory.yaml"
MPC = CONTROLLERS / "mpc.yaml"
LQG = CONTROLLERS / "lqg.yaml"
SHORT_FLIGHT = ("duration=1.2", "laboratory.motion_capture={position_noise: 0.001}")


def load(controller, *overrides, wind="nominal"):
    return load_scenario(f"{LABORATORY}:{wind}", overrides, layers=[str(controller)])


def as_lqg(scenario):
    """Return the scenario with the linear-quadratic-Gaussian regulator instead of model predictive control."""
    regulator = load(f"{LQG}:lqg_low_wind").control.model_copy(update={"max_thrust": scenario.control.max_thrust})
    return scenario.model_copy(update={"control": regulator})


@pytest.mark.long
def test_mpc_equals_the_regulator_far_from_limits():
    """The flight is the first half of the figure eight in the wind of the fans, with the shipped LQG design."""
    mpc = load(f"{MPC}:mpc", "duration=8", wind="high_wind")
    flight, expected = (simulate(each, compiled=True) for each in (mpc, as_lqg(mpc)))
    assert np.abs(expected["disturbance"]).max() > 0.3
    for name in ("state", "wrench", "acceleration_command", "error", "disturbance"):
        np.testing.assert_allclose(flight[name], expected[name], atol=1e-6)


@pytest.mark.long
def test_mpc_stays_above_a_floor_that_the_regulator_violates():
    """MPC predicts that the thrust is too small to follow the reference, and starts to climb earlier."""
    mpc = load(f"{MPC}:mpc_short_of_thrust", "duration=8")
    predictive, regulator = (simulate(each, compiled=True) for each in (mpc, as_lqg(mpc)))
    assert regulator.record("state").z.min() < 1.085
    assert predictive.record("state").z.min() > 1.09
    height_errors = [flight.record("error").z for flight in (predictive, regulator)]
    assert np.abs(height_errors[0]).max() < 0.6 * np.abs(height_errors[1]).max()
    weight = 0.68 * 9.81
    assert predictive.record("wrench").thrust.max() <= 1.2 * weight + 1e-9


@pytest.mark.long
def test_mpc_flights_are_equal_compiled_uncompiled_and_in_a_fleet():
    """The limits are active, and there is noise."""
    scenario = load(f"{MPC}:mpc_short_of_thrust", *SHORT_FLIGHT)
    together = assert_flown_alike(Batch.draw(scenario, [4, 7]))
    for sample, flight in zip((4, 7), together, strict=True):
        alone = simulate(scenario, sample=sample, compiled=True)
        np.testing.assert_allclose(flight["state"], alone["state"], atol=1e-9)
        assert_metrics_alike(flight.metrics, alone.metrics)


@pytest.mark.long
def test_mpc_commands_to_an_autopilot_keep_the_tilt_limit(monkeypatch):
    """The vehicle leaves the corridor immediately, and the correction of a network is added."""
    network = (
        "control.network={kind: type_2, axes: [x, y], inputs: {error: {scale: 20, centres: [-1, 1], widths: [2, 2]},"
        " disturbance: {scale: 2, centres: [-1, 1], widths: [2, 2]}},"
        " learning: {kind: gradient, signal: feedback, rate: 2}}"
    )
    onboard = load_scenario(
        CONTROLLERS.parent / "onboard.yaml",
        [network, "duration=0.8", "control.max_tilt=0.05", "laboratory.autopilot.kind=attitude"],
        layers=[f"{LQG}:lqg_onboard"],
    )
    written = onboard.model_dump(mode="json")
    written["control"] |= {"kind": "mpc", "corridor": {"kind": "tube", "half_width": [0.001, None, 0.1]}}
    scenario = type(onboard).model_validate(written)
    is_perturbed = []
    perturbations = Programme.perturbations

    def record_perturbations(self, *args):
        result = perturbations(self, *args)
        is_perturbed.append(bool(result.any()))
        return result

    monkeypatch.setattr(Programme, "perturbations", record_perturbations)
    (flight,) = assert_flown_alike(Batch.draw(scenario, [0]))
    assert sum(is_perturbed) > 20
    target = flight.record("attitude_target")
    assert np.hypot(np.tan(target.pitch), np.tan(target.roll)).max() < 1.05 * np.tan(0.05)
