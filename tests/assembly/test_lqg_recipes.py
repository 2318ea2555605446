"""Tests that recipes for linear-quadratic-Gaussian and model predictive control follow the scenario."""

import math

import numpy as np
import pytest

from drake_quad.assembly.control import build_control, control_recipes
from drake_quad.control.lqg.chains import (
    ChainNoise,
    Disturbances,
    SecondOrderResponse,
    attitude_model,
    lagging_attitude_model,
    torque_model,
    vertical_model,
)
from drake_quad.control.lqg.design import Timing, axis_loop, design_regulator
from drake_quad.control.lqg.laws import TargetParameters, ThrustParameters, TorqueParameters
from drake_quad.control.lqg.system import LinearQuadraticGaussian
from drake_quad.control.mpc.constraints import Corridor
from drake_quad.control.mpc.system import NO_WALLS, PredictiveProgramme
from drake_quad.flight.mission import plan_route
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.controls.mpc import MpcControl

WEIGHT = 0.7 * 9.79  # N, nominal weight
# Delay of a command, s. It takes effect after one tick of 20 ms and is held for one tick, which adds half a tick on
# average.
COMMAND_DELAY = 0.02 * (1 + 0.5)
LATERAL_DISTURBANCES = Disturbances(
    first=ChainNoise(deviation=0.01108, time=0.25),
    second=ChainNoise(deviation=0.8325, time=0.6),
    bias=ChainNoise(deviation=16.6, time=20.0),
    command_noise=3.296,
)
VERTICAL_DISTURBANCES = Disturbances(
    first=ChainNoise(deviation=0.4975, time=0.25),
    second=ChainNoise(deviation=0.7479, time=0.6),
    bias=None,
    command_noise=0.03164,
)


def regulator_of_scenario(scenario):
    return control_recipes(Batch(scenario, (0,), {}), plan_route(scenario))["regulator"]


def assert_nearly_equal(actual, expected):
    """Assert that two records have the same type and nearly equal values."""
    assert type(actual) is type(expected)
    for name, field, expected_field in zip(actual._fields, actual, expected, strict=True):
        np.testing.assert_allclose(field, expected_field, rtol=1e-12, err_msg=name)


@pytest.mark.slow
def test_without_an_autopilot_the_design_model_has_the_torques_of_the_nominal_vehicle_as_inputs(asymmetric):
    recipe = regulator_of_scenario(asymmetric("lqg", "control.network=null"))
    assert recipe.system is LinearQuadraticGaussian
    assert recipe.structure == {
        "signal": "wrench",
        "period": 0.01,
        "tick": 0.02,
        "takes_correction": False,
        "takes_perturbation": False,
        "loses_frames": True,
    }
    lateral, vertical, thrust, torques, target = recipe.parameters
    times = Timing(0.01, 0.02, 1)
    noise = np.array([0.0013, 0.0031 * 9.79])
    assert_nearly_equal(
        lateral, axis_loop(torque_model(0.043, LATERAL_DISTURBANCES), times, noise=noise, command_weight=2.0e-5)
    )
    noise = np.array([0.0011])
    assert_nearly_equal(
        vertical, axis_loop(vertical_model(0.037, VERTICAL_DISTURBANCES), times, noise=noise, command_weight=7.785e-4)
    )
    assert thrust == pytest.approx(
        ThrustParameters(0.7, 9.79, math.tan(0.2), 0.95 * WEIGHT, 1.11 * WEIGHT, COMMAND_DELAY + 0.037), rel=1e-12
    )
    assert torques == pytest.approx(
        TorqueParameters(0.0065, 0.0085, 0.0126, 5.0, 3.1, 40.0, COMMAND_DELAY + 0.043), rel=1e-12
    )
    assert target is None


@pytest.mark.parametrize("lag", [None, 0.043])
def test_with_an_autopilot_the_design_model_is_the_attitude_response_of_the_autopilot(asymmetric, lag):
    """The feed-forward compensates delay, lag and the attitude response 1 / (1 + (2 ζ / ω) s + s² / ω²)."""
    scenario = asymmetric("lqg_on_board", f"control.lateral.lag={'null' if lag is None else lag}")
    recipe = regulator_of_scenario(scenario)
    assert (recipe.structure["signal"], recipe.structure["period"]) == ("attitude_target", 0.01)
    lateral, _, thrust, torques, target = recipe.parameters
    response = SecondOrderResponse(9.0, 0.72)
    model = (
        attitude_model(response, LATERAL_DISTURBANCES)
        if lag is None
        else lagging_attitude_model(response, lag, LATERAL_DISTURBANCES)
    )
    noise = np.array([0.0013, 0.0031 * 9.79])
    assert_nearly_equal(lateral, axis_loop(model, Timing(0.01, 0.02, 1), noise=noise, command_weight=0.01))
    assert torques is None
    assert thrust.lead == pytest.approx(COMMAND_DELAY + 0.037)
    # These are the coefficients of exp(T s) (1 + (2 ζ / ω) s + s² / ω²) up to s².
    lead = COMMAND_DELAY + (lag or 0.0)
    exponential, inverse = [1.0, lead, lead**2 / 2.0], [1.0, 2.0 * 0.72 / 9.0, 1.0 / 9.0**2]
    _, jerk, snap, *_ = np.convolve(exponential, inverse)
    assert target == pytest.approx(TargetParameters(jerk, snap), rel=1e-12)


def test_a_regulator_accepts_the_correction_of_a_network_and_ignores_lost_frames_that_cannot_occur(asymmetric):
    network = "{kind: type_1, axes: [x], inputs: {error: {}}, learning: {kind: gradient, rate: 1.0, slope: 1.0}}"
    scenario = asymmetric("lqg", f"control.network={network}", "laboratory.motion_capture.dropout_rate=0")
    structure = regulator_of_scenario(scenario).structure
    assert structure["takes_correction"]
    assert not structure["loses_frames"]


@pytest.fixture(scope="module")
def scenario_with_mpc(asymmetric):
    """Return a function that builds a scenario with model predictive control, given fields of the control."""
    scenario = asymmetric("lqg")

    def mpc_scenario(**fields):
        control = scenario.control.model_dump(mode="json") | {"kind": "mpc", "horizon": 0.375, "tilt_weight": 7.0}
        return scenario.model_copy(update={"control": MpcControl.model_validate(control | fields)})

    return mpc_scenario


def programme_of(scenario):
    """Return a tuple: the recipe for the quadratic programme, the plan, and the parameters of the regulator."""
    plan = plan_route(scenario)
    recipes = control_recipes(Batch(scenario, (0,), {}), plan)
    assert recipes["regulator"].structure["takes_perturbation"]
    return recipes["programme"], plan, recipes["regulator"].parameters


@pytest.mark.slow
def test_the_quadratic_programme_is_built_from_the_regulator_the_horizon_and_the_tilt_weight(scenario_with_mpc):
    scenario = scenario_with_mpc()
    recipe, _, regulator_numbers = programme_of(scenario)
    assert (recipe.system, recipe.parameters) == (PredictiveProgramme, None)
    structure = recipe.structure
    assert structure["nominal"] is regulator_numbers
    # The horizon corresponds to 18.75 ticks, which is rounded.
    assert (structure["tick"], structure["num_ticks"], structure["tilt_weight"]) == (0.02, 19, 7.0)
    assert structure["corridor"] is NO_WALLS
    times, control = Timing(0.01, 0.02, 1), scenario.control
    assert_nearly_equal(structure["lateral"], design_regulator(control.lateral.model(), times, 2.0e-5))
    assert_nearly_equal(structure["vertical"], design_regulator(control.vertical.model(), times, 7.785e-4))
    assert programme_of(scenario_with_mpc(horizon=0.001))[0].structure["num_ticks"] == 1


def test_the_preview_contains_the_reference_of_each_tick_and_the_snap_of_the_previous_tick(scenario_with_mpc):
    """The preview begins at the first tick. In its last two entries the reference is at rest."""
    recipe, plan, _ = programme_of(scenario_with_mpc())
    preview, rest_time = recipe.structure["preview"], plan.rest_time
    ticks = np.arange(len(preview))
    assert 0.02 * (len(preview) - 3) < rest_time <= 0.02 * (len(preview) - 2)
    times = np.minimum(0.02 * ticks, rest_time)
    position, velocity, acceleration, jerk, expected_snap = (
        evaluate(plan.extended_path, times, order) for order in range(5)
    )
    (yaw,), (yaw_rate,), (yaw_acceleration,) = (evaluate(plan.extended_yaw, times, order) for order in range(3))
    scale = np.abs(expected_snap).max()
    np.testing.assert_allclose(
        np.array([each.reference for each in preview]).T,
        [*position, *velocity, *acceleration, yaw, yaw_rate],
        atol=1e-9,
    )
    np.testing.assert_allclose(np.array([each.jerk for each in preview]).T, jerk, atol=1e-9 * scale)
    snaps = np.array([each.snap for each in preview])
    np.testing.assert_allclose(snaps.T, [*expected_snap, yaw_acceleration], atol=1e-9 * scale)
    previous_snaps = np.array([each.before for each in preview])
    np.testing.assert_array_equal(previous_snaps[1:], snaps[:-1])
    # Before the plan begins, the snap is zero.
    np.testing.assert_array_equal(previous_snaps[0], 0.0)
    assert np.abs(snaps[0]).max() > 1.0


@pytest.mark.slow
def test_a_corridor_tube_moves_with_the_reference_and_a_room_stays_fixed(scenario_with_mpc):
    def corridor_of(**corridor):
        return programme_of(scenario_with_mpc(corridor=corridor))[0].structure["corridor"]

    inf = math.inf
    tube = corridor_of(kind="tube", half_width=[0.1, None, 0.3], weight=4.0)
    assert tube == Corridor(PerAxis(-0.1, -inf, -0.3), PerAxis(0.1, inf, 0.3), follows_reference=True, weight=4.0)
    room = corridor_of(kind="room", lower=[-2.0, None, 0.2], upper=[None, 3.0, 2.5], weight=5.0)
    assert room == Corridor(PerAxis(-2.0, -inf, 0.2), PerAxis(inf, 3.0, 2.5), follows_reference=False, weight=5.0)


def test_an_lqg_controller_has_no_quadratic_programme(asymmetric):
    scenario = asymmetric("lqg", "control.network=null")
    assert [*control_recipes(Batch(scenario, (0,), {}), plan_route(scenario))] == ["regulator"]


NETWORK_OVERRIDE = (
    "control.network={kind: type_1, axes: [x], inputs: {error: {}}, learning: {kind: gradient, signal: feedback}}"
)


@pytest.mark.slow
@pytest.mark.parametrize("added_part", [None, "network", "programme"])
def test_controller_network_and_programme_are_connected_and_their_outputs_exported(
    asymmetric, scenario_with_mpc, added_part
):
    """The diagram exports all outputs, and all inputs that are not connected inside the diagram."""
    scenario = (
        scenario_with_mpc()
        if added_part == "programme"
        else asymmetric("lqg", *([NETWORK_OVERRIDE] if added_part else []))
    )
    plan = plan_route(scenario)
    control = build_control(scenario, control_recipes(Batch(scenario, (0,), {}), plan), 2)
    assert control.get_name() == "control"
    assert {part.get_name() for part in control.GetSystems()} == {"regulator", *([added_part] if added_part else [])}
    inputs = {control.get_input_port(i).get_name() for i in range(control.num_input_ports())}
    assert inputs == {"measurement", "reference", "reference_jerk", "reference_snap"}
    outputs = {control.get_output_port(i).get_name() for i in range(control.num_output_ports())}
    assert {"wrench", "error", "disturbance"} <= outputs
    assert ("weights" in outputs) == (added_part == "network")
    context = control.CreateDefaultContext()
    for name in inputs:
        port = control.GetInputPort(name)
        port.FixValue(context, np.linspace(0.1, 0.2, port.size()))
    regulator = control.GetSubsystemByName("regulator")
    internal_inputs = [
        name for name in ("correction", "learned_disturbance", "perturbation") if regulator.HasInputPort(name)
    ]
    assert (
        internal_inputs
        == {None: [], "network": ["correction", "learned_disturbance"], "programme": ["perturbation"]}[added_part]
    )
    regulator_context = regulator.GetMyContextFromRoot(context)
    assert all(regulator.GetInputPort(name).HasValue(regulator_context) for name in internal_inputs)
    assert np.isfinite(control.GetOutputPort("wrench").Eval(context)).all()
