"""Flights under model predictive control: as the regulator's where no limit is near, and within limits where one is."""

from pathlib import Path

import numpy as np
import pytest
from both_ways import assert_flown_alike, assert_metrics_alike

from drake_quad import load_scenario, simulate
from drake_quad.control.mpc.programme import Programme
from drake_quad.scenario.batch import Batch

CONTROLLERS = Path(__file__).parents[2] / "diagrams" / "controllers"
LABORATORY = CONTROLLERS.parent / "laboratory.yaml"
MPC, LQG = CONTROLLERS / "mpc.yaml", CONTROLLERS / "lqg.yaml"
SHORT = ("duration=1.2", "laboratory.motion_capture={position_noise: 0.001}")


def load(controller, *overrides, wind="nominal"):
    return load_scenario(f"{LABORATORY}:{wind}", overrides, layers=[str(controller)])


def as_lqg(scenario):
    """The same with the regulator alone."""
    flown = load(f"{LQG}:lqg_low_wind").control.model_copy(update={"max_thrust": scenario.control.max_thrust})
    return scenario.model_copy(update={"control": flown})


@pytest.mark.slow
def test_where_no_limit_is_near_it_is_the_regulator():
    """In the fans' wind, for a flight to the first half of the eight; the shipped design is that of the LQG."""
    mpc = load(f"{MPC}:mpc", "duration=8", wind="high_wind")
    found, expected = (simulate(each, compiled=True) for each in (mpc, as_lqg(mpc)))
    assert np.abs(expected["disturbance"]).max() > 0.3
    for name in ("state", "wrench", "acceleration_command", "error", "disturbance"):
        np.testing.assert_allclose(found[name], expected[name], atol=1e-6)


@pytest.mark.slow
def test_it_keeps_to_a_floor_that_the_regulator_breaks():
    """Since it sees that the thrust will not do for what the reference asks, it begins to rise earlier."""
    mpc = load(f"{MPC}:mpc_short_of_thrust", "duration=8")
    found, regulator = (simulate(each, compiled=True) for each in (mpc, as_lqg(mpc)))
    assert regulator.record("state").z.min() < 1.085
    assert found.record("state").z.min() > 1.09
    below = [flight.record("error").z for flight in (found, regulator)]
    assert np.abs(below[0]).max() < 0.6 * np.abs(below[1]).max()
    weight = 0.68 * 9.81
    assert found.record("wrench").thrust.max() <= 1.2 * weight + 1e-9


@pytest.mark.slow
def test_compiled_is_as_wired_and_a_fleet_as_each_alone():
    """Where limits bind, in noise."""
    scenario = load(f"{MPC}:mpc_short_of_thrust", *SHORT)
    together = assert_flown_alike(Batch.draw(scenario, [4, 7]))
    for sample, flight in zip((4, 7), together, strict=True):
        alone = simulate(scenario, sample=sample, compiled=True)
        np.testing.assert_allclose(flight["state"], alone["state"], atol=1e-9)
        assert_metrics_alike(flight.metrics, alone.metrics)


@pytest.mark.slow
def test_behind_an_autopilot_the_tilt_of_commands_is_kept(monkeypatch):
    """A corridor that it leaves at once, with the network's correction on top."""
    network = (
        "control.network={kind: type_2, axes: [x, y], inputs: {error: {scale: 20}, disturbance: {scale: 2}},"
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
    solved = []
    perturbations = Programme.perturbations

    def counted(self, *args):
        found = perturbations(self, *args)
        solved.append(bool(found.any()))
        return found

    monkeypatch.setattr(Programme, "perturbations", counted)
    (flight,) = assert_flown_alike(Batch.draw(scenario, [0]))
    assert sum(solved) > 20
    target = flight.record("attitude_target")
    assert np.hypot(np.tan(target.pitch), np.tan(target.roll)).max() < 1.05 * np.tan(0.05)
