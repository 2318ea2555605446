"""Tests of stability maps, by comparison with the poles of single loops and with single flights."""

from pathlib import Path

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.design.gains import AxisPdGains, pd_loop
from drake_quad.design.stability_map import mapped_plant, simulated_map, stability_map
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.linear.margins import margins
from drake_quad.linear.modes import modes
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.scenario.batch import draw_sample
from drake_quad.scenario.paths import map_leaves

ROOT = Path(__file__).parent.parent.parent
SHIPPED_GAINS = ROOT / "diagrams" / "gains" / "laboratory.yaml"
K_P_VALUES = np.array([0.1, 0.3, 0.8])  # 1/s²
K_D_VALUES = np.array([0.2, 0.7, 1.5, 3.5])  # 1/s


@pytest.fixture(scope="module")
def scenario():
    return nominal_laboratory("duration=3", "crash.position_error=0.5")


def nominal_laboratory(*overrides):
    return load_scenario(ROOT / "diagrams" / "laboratory.yaml:nominal", overrides, layers=[SHIPPED_GAINS])


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["position", "attitude"])
def test_each_point_of_the_map_has_the_poles_and_margins_of_a_single_loop(scenario, loop):
    plant = mapped_plant(scenario, loop)
    k_p, k_d = (K_P_VALUES, K_D_VALUES) if loop == "position" else (np.array([1.0, 8.0, 60.0]), 8.0 * K_D_VALUES)
    gain_map = stability_map(plant, k_p, k_d)
    assert 0 < gain_map.stable.sum() < gain_map.stable.size
    for i, j in np.ndindex(gain_map.stable.shape):
        gains = AxisPdGains(k_p[i], k_d[j])
        closed = plant.with_feedback(np.array([gains]))
        assert gain_map.size[i, j] == pytest.approx(np.abs(closed.poles()).max(), rel=1e-9)
        if not gain_map.stable[i, j]:
            assert np.isnan(gain_map.damping[i, j])
            assert np.isnan(gain_map.delay[i, j])
            continue
        slow_modes = [
            mode for mode in modes(closed.A, closed.states, period=0.02) if mode.pole.real > np.log(0.05) / 0.02
        ]
        assert gain_map.damping[i, j] == pytest.approx(min(mode.damping for mode in slow_modes), rel=1e-3)
        assert gain_map.delay[i, j] == pytest.approx(margins(pd_loop(plant, gains)).delay, rel=5e-3)


def test_a_position_loop_without_k_p_is_not_stable(scenario):
    """The integrator's pole remains at 1 if k_P is zero."""
    gain_map = stability_map(mapped_plant(scenario, "position"), np.array([0.0]), K_D_VALUES[:3])
    np.testing.assert_allclose(gain_map.size, 1.0, atol=1e-8)
    assert not gain_map.stable.any()


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["position", "attitude"])
@pytest.mark.parametrize("controller", [None, "pid", "disturbance_observer", "indi"])
def test_the_mapped_loop_has_the_poles_of_the_whole_diagram(loop, controller):
    overrides = [
        "nominal.inertia=[0.0065, 0.0085, 0.0126]",
        "vehicle.mass=0.75",
        "vehicle.inertia=[0.0071, 0.0079, 0.0131]",
        "control.position={k_p: [0.25, 0.4, 5.5], k_d: [0.65, 0.9, 3.4]}",
        "control.attitude={k_p: [4.5, 6.5, 5.0], k_d: [3.1, 3.9, 3.3]}",
    ]
    layers = (
        [ROOT / "diagrams" / "controllers" / "designed" / f"laboratory.yaml:{controller}"]
        if controller
        else [SHIPPED_GAINS]
    )
    scenario = load_scenario(ROOT / "diagrams" / "laboratory.yaml:nominal", overrides, layers=layers)
    block, i = getattr(scenario.control, loop), 0 if loop == "position" else 1
    gains = {f"control.{loop}.k_p.{i}": 1.1 * block.k_p[i], f"control.{loop}.k_d.{i}": 0.95 * block.k_d[i]}
    poles = mapped_plant(scenario, loop).with_feedback(np.array([[*gains.values()]])).poles()
    changed = map_leaves(scenario, lambda path, value: gains.get(path, value))
    diagram_poles = closed_loop(changed).system.poles()
    slow_poles = poles[np.abs(poles) > 0.1]
    assert len(slow_poles) >= 5
    for pole in slow_poles:
        assert np.abs(diagram_poles - pole).min() < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("loop", ["position", "attitude"])
def test_each_point_of_the_simulated_map_equals_a_single_flight(scenario, loop):
    """All flights have the wind and noise of one sample, and one of them crashes."""
    k_p, k_d = (
        (K_P_VALUES, np.array([0.2, 0.7])) if loop == "position" else (np.array([6.0, 90.0]), np.array([0.3, 4.0]))
    )
    gain_map = simulated_map(scenario, loop, k_p, k_d, sample=3)
    assert gain_map.rmse.shape == (len(k_p), len(k_d))
    first = simulated_map(scenario, loop, k_p[:1], k_d[:1]).rmse
    np.testing.assert_array_equal(first, simulated_map(scenario, loop, k_p[:1], k_d[:1], sample=0).rmse)
    assert first != pytest.approx(gain_map.rmse[:1, :1], rel=1e-6)
    crashed = 0
    for i, j in np.ndindex(gain_map.rmse.shape):
        block = getattr(scenario.control, loop)
        gains = [
            f"control.{loop}.{name}=[{value}, {value}, {getattr(block, name)[2]}]"
            for name, value in (("k_p", k_p[i]), ("k_d", k_d[j]))
        ]
        overrides = ["duration=3", "crash.position_error=0.5", *gains]
        alone = simulate(nominal_laboratory(*overrides), sample=3, compiled=False)
        assert gain_map.rmse[i, j] == pytest.approx(alone.metrics.rmse, rel=1e-9)
        assert gain_map.crash_time[i, j] == alone.metrics.crash_time
        crashed += alone.metrics.crashed
    assert loop == "position" or crashed > 0


def test_poles_of_delay_lines_do_not_count_for_the_damping():
    """Poles of magnitude below 0.05 decay within a tick and do not count, even if negative. A pole at -0.06 counts."""
    for pole, damping in ((0.01, 1.0), (-0.04, 1.0), (-0.06, 0.66719)):
        plant = SampledSystem(
            np.diag([pole, 0.001]), np.zeros((2, 1)), np.eye(2), np.zeros((2, 1)), 0.02, ("a", "b"), ("u",), ("a", "b")
        )
        gain_map = stability_map(plant, np.array([1.0]), np.array([1.0, 2.0]))
        np.testing.assert_allclose(gain_map.damping, [[damping, damping]], rtol=1e-4)
        np.testing.assert_allclose(gain_map.size, abs(pole))


@pytest.mark.long
def test_a_map_of_a_scenario_with_a_sample_uses_the_parameters_of_the_sample(scenario):
    drawn = load_scenario(
        ROOT / "diagrams" / "laboratory.yaml:nominal", ["vehicle.mass={uniform: {min: 0.6, max: 0.8}}"]
    )
    first, second = (mapped_plant(drawn.model_copy(update={"sample": sample}), "position") for sample in (0, 1))
    with_sample = load_scenario(
        ROOT / "diagrams" / "laboratory.yaml:nominal", [f"vehicle.mass={draw_sample(drawn, 1).vehicle.mass!r}"]
    )
    np.testing.assert_allclose(mapped_plant(with_sample, "position").A, second.A, atol=1e-12)
    assert np.abs(first.A - second.A).max() > 1e-4
