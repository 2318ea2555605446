"""Tests of flights with linear-quadratic-Gaussian control: errors of the shipped designs, and additional networks."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Gain

from drake_quad import InputError, build_tracking_diagram, load_scenario, simulate
from drake_quad.assembly.control import control_recipes
from drake_quad.control.lqg.system import LinearQuadraticGaussian
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.design.tuning import LoopLimit
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_batch
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.batch import Batch, median_scenario

DIAGRAMS = Path(__file__).parents[2] / "diagrams"
HIGH_WIND_SCENARIO = "laboratory.yaml:high_wind"


def scenario_of(spec, *overrides, controller="lqg"):
    return load_scenario(f"{DIAGRAMS}/{spec}", overrides, layers=[f"{DIAGRAMS}/controllers/lqg.yaml:{controller}"])


def metrics_of_flights(scenario, num_samples):
    return [flight.metrics for flight in simulate_batch(Batch.draw(scenario, range(num_samples)), compiled=True)]


def mean_rmse(scenario, num_samples=4):
    """Return the mean RMSE of a few flights, none of which crashes, m."""
    metrics = metrics_of_flights(scenario, num_samples)
    assert not any(each.crashed for each in metrics)
    return np.mean([each.rmse for each in metrics])


@pytest.mark.long
@pytest.mark.parametrize(
    ("controller", "spec"),
    [
        ("lqg", HIGH_WIND_SCENARIO),
        ("lqg_low_wind", HIGH_WIND_SCENARIO),
        ("lqg_onboard", "onboard.yaml"),
        ("lqg_neural_fly", "neural_fly.yaml:wind_12"),
        ("lqg_robustness", "robustness.yaml"),
    ],
)
def test_a_shipped_design_has_at_most_60_percent_of_the_error_of_the_cascade(controller, spec):
    cascade = np.mean([metrics.rmse for metrics in metrics_of_flights(load_scenario(f"{DIAGRAMS}/{spec}"), 4)])
    assert mean_rmse(scenario_of(spec, controller=controller)) < 0.6 * cascade


@pytest.mark.long
def test_a_design_for_one_laboratory_has_less_error_there_than_a_design_for_nine_laboratories():
    assert mean_rmse(scenario_of(HIGH_WIND_SCENARIO, controller="lqg_low_wind")) < 0.7 * mean_rmse(
        scenario_of(HIGH_WIND_SCENARIO)
    )


@pytest.mark.long
def test_the_shipped_controller_tolerates_frames_that_are_50_ms_late():
    overrides = "laboratory.motion_capture.latency_frames=5", "duration=8"
    assert mean_rmse(scenario_of("laboratory.yaml:low_wind", *overrides)) < 0.06


@pytest.mark.long
@pytest.mark.parametrize("spec", ["outdoor.yaml", "neural_fly.yaml:wind_8"])
def test_designs_for_scenario_families_meet_the_loop_limit_of_the_protocol(spec):
    family = spec.partition(".")[0]
    scenario = load_scenario(f"{DIAGRAMS}/{spec}", layers=[f"{DIAGRAMS}/controllers/designed/{family}.yaml:lqg"])
    assert LoopLimit().margin_ratios(median_scenario(scenario)).min() >= 1.0
    cascade = np.mean([metrics.rmse for metrics in metrics_of_flights(load_scenario(f"{DIAGRAMS}/{spec}"), 4)])
    assert mean_rmse(scenario) < cascade


FIVE_SETS = "{scale: 0.3, centres: [-1, -0.5, 0, 0.5, 1], widths: [0.5, 0.5, 0.5, 0.5, 0.5]}"
FEWER_POSITION_SETS = f"control.network.inputs={{y: {FIVE_SETS}, z: null}}"
PHASE_CENTRES = np.arange(16) / 16  # fractions of a lap
FEWER_PHASE_SETS = f"control.network.inputs.phase={{centres: {PHASE_CENTRES.tolist()}, widths: {[0.1] * 16}}}"


@pytest.mark.long
@pytest.mark.parametrize(
    ("controller", "override"), [("lqg_map", FEWER_POSITION_SETS), ("lqg_schedule", FEWER_PHASE_SETS)]
)
def test_a_network_reduces_the_error_in_the_second_lap_by_a_tenth(controller, override):
    """The input of the network is the position or the phase of the lap. Fewer fuzzy sets reduce the time to compile."""
    laps = "route.laps=2", "metrics={first_lap: 2}", override
    rmse = mean_rmse(scenario_of(HIGH_WIND_SCENARIO, *laps, controller=controller))
    assert rmse < 0.9 * mean_rmse(scenario_of(HIGH_WIND_SCENARIO, *laps, "control.network=null", controller=controller))


def test_a_network_around_the_regulator_causes_no_algebraic_loop():
    """The correction may depend on `error`, `error_rate` and `pd`, because these do not depend on the correction."""
    scenario = scenario_of("laboratory.yaml:nominal")
    recipe = control_recipes(Batch.draw(scenario, [0]), plan_route(scenario))["regulator"]
    system = LinearQuadraticGaussian(**recipe.structure | {"takes_correction": True}, parameters=recipe.parameters)
    builder = DiagramBuilder()
    regulator = builder.AddNamedSystem("regulator", system)
    for name in ("measurement", "reference", "reference_jerk", "reference_snap"):
        builder.ExportInput(regulator.GetInputPort(name), name)
    network = builder.AddNamedSystem("network", Gain(-0.3, 3))
    builder.Connect(regulator.GetOutputPort("pd"), network.get_input_port())
    builder.Connect(network.get_output_port(), regulator.GetInputPort("correction"))
    builder.ExportOutput(regulator.GetOutputPort("wrench"), "wrench")
    assert builder.Build().num_output_ports() == 1


@pytest.mark.long
@pytest.mark.parametrize(("correction_fraction", "learned_fraction"), [(0.6, 0.6), (0.5, 0.2)])
def test_the_filter_estimates_the_disturbance_that_the_network_has_not_learned(correction_fraction, learned_fraction):
    """A steady wind v causes the acceleration c v / m. The filter subtracts the learned disturbance."""
    wind = np.array([1.5, -2.5, 0.0])
    scenario = scenario_of(
        "laboratory.yaml:nominal",
        *("route={kind: hover, position: [0, 0, 1], duration: 12}", "vehicle.quadratic_drag=0"),
        *("laboratory.motion_capture={position_noise: 0, attitude_noise: 0}", "laboratory.command_link.loss_rate=0"),
        f"laboratory.wind=[{{kind: steady, velocity: {wind.tolist()}}}]",
        controller="lqg_low_wind",
    )
    acceleration = 0.1 / 0.68 * wind
    recipe = control_recipes(Batch.draw(scenario, [0]), plan_route(scenario))["regulator"]
    system = LinearQuadraticGaussian(**recipe.structure | {"takes_correction": True}, parameters=recipe.parameters)
    builder = DiagramBuilder()
    regulator = builder.AddNamedSystem("regulator", system)
    for name, fraction in (("correction", correction_fraction), ("learned_disturbance", learned_fraction)):
        source = builder.AddNamedSystem(name, ConstantVectorSource(fraction * acceleration))
        builder.Connect(source.get_output_port(), regulator.GetInputPort(name))
    for name in ("measurement", "reference", "reference_jerk", "reference_snap"):
        builder.ExportInput(regulator.GetInputPort(name), name)
    for name in ("wrench", "acceleration_command", "error", "disturbance"):
        builder.ExportOutput(regulator.GetOutputPort(name), name)
    flight = simulate(scenario, control=builder.Build())
    np.testing.assert_allclose(flight["disturbance"][-1], (1.0 - learned_fraction) * acceleration, atol=0.03)
    # The total command at rest does not depend on `correction_fraction`.
    np.testing.assert_allclose(flight["acceleration_command"][-1], -acceleration, atol=0.03)
    if correction_fraction == learned_fraction:
        np.testing.assert_allclose(flight["state"][-1, :3], [0.0, 0.0, 1.0], atol=0.006)


@pytest.mark.long
def test_a_network_can_be_combined_with_the_regulator():
    """The network learns from the feedback, which includes the estimated disturbance."""
    network = (
        "control.network={kind: type_2, axes: [x, y], inputs: {error: {scale: 20, centres: [-1, 1], widths: [2, 2]},"
        " z: {scale: 2, centres: [-1, 1], widths: [2, 2]}}, lead: 0.1,"
        " learning: {kind: gradient, signal: feedback, rate: 2}}"
    )
    scenario = scenario_of("laboratory.yaml:high_wind", network, "duration=4")
    uncompiled, compiled = (simulate(scenario, compiled=is_compiled) for is_compiled in (False, True))
    assert np.abs(uncompiled["correction"]).max() > 0.05
    np.testing.assert_allclose(compiled["correction"], uncompiled["correction"], atol=1e-9)
    np.testing.assert_allclose(compiled["state"], uncompiled["state"], atol=1e-9)


def test_a_position_controller_cannot_replace_the_regulator():
    gains = PdGains(PerAxis(1.0, 1.0, 1.0), PerAxis(1.0, 1.0, 1.0))
    position_controller = build_position_controller(ProportionalDerivative(parameters=gains))
    with pytest.raises(
        InputError, match="control of nominal is of kind lqg, which has no position_controller to replace"
    ):
        build_tracking_diagram(scenario_of("laboratory.yaml:nominal"), position_controller=position_controller)
