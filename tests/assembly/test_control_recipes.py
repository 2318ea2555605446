"""Tests that the recipes for a scenario's control contain the scenario's parameters."""

import math

import numpy as np
import pytest

from drake_quad.assembly.control import control_recipes
from drake_quad.control.attitude import AttitudeController, AttitudeParameters
from drake_quad.control.disturbance.laws import AdaptiveLaw, IncrementalLaw, KalmanLaw
from drake_quad.control.disturbance.response import AxisCommand
from drake_quad.control.disturbance.tilt import TiltDisturbanceEstimator, TiltEstimatorParameters
from drake_quad.control.fuzzy.adaptation import AdaptationRates
from drake_quad.control.fuzzy.inference import Antecedents, CircularSets, FuzzySets
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, LearningLimits, SignLaw
from drake_quad.control.fuzzy.set_learning import AdaptationParameters, SetLearning
from drake_quad.control.fuzzy.systems import FuzzyRules, FuzzyRulesParameters, Lead, LearningParameters, WeightLearning
from drake_quad.control.geometric import (
    GeometricAttitudeController,
    IntegratingAttitudeController,
    IntegratingAttitudeParameters,
)
from drake_quad.control.incremental_attitude import IncrementalAttitudeController, IncrementalAttitudeParameters
from drake_quad.control.integral import IntegralCorrection, IntegralGains
from drake_quad.control.position import PdGains, ProportionalDerivative
from drake_quad.control.thrust_vectoring import ThrustVectoring
from drake_quad.flight.mission import plan_route
from drake_quad.framework.records import layout_of
from drake_quad.geometry.per_axis import PerAngle, PerAxis
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.files.loading import with_fields

WEIGHT = 0.7 * 9.79  # N, nominal weight


def recipes_of(scenario):
    plan = plan_route(scenario)
    return control_recipes(Batch.draw(scenario, [0]), plan), plan


def test_the_cascade_has_the_gains_and_the_nominal_parameters_of_the_scenario(asymmetric):
    recipes, _ = recipes_of(asymmetric("pid"))
    assert {path: recipe.system for path, recipe in recipes.items()} == {
        "position.pd": ProportionalDerivative,
        "position.integral": IntegralCorrection,
        "thrust_vectoring": ThrustVectoring,
        "attitude": AttitudeController,
    }
    pd, integral, vectoring, attitude = recipes.values()
    assert pd.parameters == PdGains(PerAxis(1.3, 1.0, 5.0), PerAxis(1.5, 1.3, 3.2))
    assert pd.structure == {"derivative": "tracking_error", "feeds_forward": True}
    assert integral.parameters == IntegralGains(PerAxis(0.3, 0.2, 1.5), 0.6)
    assert integral.structure == {"period": 0.02, "integration": "forward_euler"}
    backward_euler = "control.position.integration=backward_euler"
    assert (
        recipes_of(asymmetric("pid", backward_euler))[0]["position.integral"].structure["integration"]
        == "backward_euler"
    )
    assert (vectoring.parameters.mass, vectoring.parameters.gravity) == (0.7, 9.79)
    assert tuple(vectoring.parameters.limits) == pytest.approx((math.tan(0.2), 0.975 * WEIGHT, 1.11 * WEIGHT))
    k_p, k_d = PerAngle(17.0, 14.0, 5.0), PerAngle(7.5, 6.8, 3.1)
    assert attitude.parameters == AttitudeParameters(k_p, k_d, 0.0065, 0.0085, 0.0126)


def test_a_pd_without_feed_forward_may_differentiate_the_measurement(asymmetric):
    position = "{kind: pd, k_p: [1, 2, 3], k_d: [4, 5, 6], feed_forward: none, derivative: measurement}"
    recipes, _ = recipes_of(asymmetric("pid", f"control.position={position}"))
    assert [*recipes] == ["position.pd", "thrust_vectoring", "attitude"]
    assert recipes["position.pd"].structure == {"derivative": "measurement", "feeds_forward": False}


PD_GAINS = "k_p: [1.3, 1.0, 5.0], k_d: [1.5, 1.3, 3.2]"


def test_a_disturbance_estimator_has_the_gains_and_lags_of_the_scenario_and_starts_at_the_first_waypoint(asymmetric):
    response = "response: {kind: commanded, delay_ticks: 3, lag: [0.2, 0.3, 0.1], feed_forward_lag: [0.06, 0.07, 0.05]}"
    parameters = "adaptation: 2.0, bandwidth: [1.0, 2.0, 3.0], disturbance_limit: 0.8"
    recipes, _ = recipes_of(asymmetric("pid", f"control.position={{kind: l1, {PD_GAINS}, {response}, {parameters}}}"))
    assert [*recipes] == ["position.pd", "position.estimator", "thrust_vectoring", "attitude"]
    estimator = recipes["position.estimator"]
    assert estimator.structure == {"period": 0.02, "delay_ticks": 3}
    laws, lags, limit, start = estimator.parameters
    assert laws == (AdaptiveLaw(2.0, 1.0), AdaptiveLaw(2.0, 2.0), AdaptiveLaw(2.0, 3.0))
    assert lags == (AxisCommand(0.2, 0.06), AxisCommand(0.3, 0.07), AxisCommand(0.1, 0.05))
    assert (limit, start) == (0.8, PerAxis(0.3, -0.2, 1.0))
    # If the feedforward has no lag of its own, it uses the lag of the feedback.
    without_feed_forward_lag = "bandwidth: [1.0, 2.0, 3.0], response: {kind: commanded, lag: [0.2, 0.3, 0.1]}"
    recipes, _ = recipes_of(
        asymmetric("pid", f"control.position={{kind: indi, {PD_GAINS}, {without_feed_forward_lag}}}")
    )
    laws, lags, *_ = recipes["position.estimator"].parameters
    assert laws == (IncrementalLaw(1.0), IncrementalLaw(2.0), IncrementalLaw(3.0))
    assert lags == (AxisCommand(0.2, 0.2), AxisCommand(0.3, 0.3), AxisCommand(0.1, 0.1))


def test_a_kalman_filter_has_a_separate_gain_for_each_axis(asymmetric):
    parameters = "position_noise: 0.002, deviation: [0.3, 0.4, 0.5], time_constant: [1.0, 2.0, 3.0]"
    position = (
        f"{{kind: disturbance_observer, {PD_GAINS}, {parameters}, response: {{kind: commanded, lag: [0.2, 0.3, 0.1]}}}}"
    )
    recipes, _ = recipes_of(asymmetric("pid", f"control.position={position}"))
    expected = [
        KalmanLaw.of(deviation=deviation, time_constant=T, position_noise=0.002, period=0.02)
        for deviation, T in ((0.3, 1.0), (0.4, 2.0), (0.5, 3.0))
    ]
    assert recipes["position.estimator"].parameters.laws == tuple(expected)


def test_attitude_controller_and_thrust_vectoring_follow_the_kind_in_the_scenario(asymmetric):
    gains = "k_p: [17.0, 14.0, 5.0], k_d: [7.5, 6.8, 3.1]"
    pd, _ = recipes_of(asymmetric("pid", f"control.attitude={{kind: pd, {gains}}}"))
    assert pd == recipes_of(asymmetric("pid"))[0]
    geometric, _ = recipes_of(asymmetric("pid", f"control.attitude={{kind: geometric, {gains}}}"))
    assert geometric["attitude"].system is GeometricAttitudeController
    assert geometric["attitude"].parameters == pd["attitude"].parameters
    assert geometric["attitude"].structure == {"transports": True}
    structures = [recipes["thrust_vectoring"].structure for recipes in (pd, geometric)]
    assert structures == [{"projects": False}, {"projects": True, "sequence": "zyx"}]
    integral = (
        "k_i: [3.0, 2.0, 1.0], integral_limit: 7.0, integration: backward_euler, euler_sequence: zxy,"
        " transport_term: false"
    )
    recipes, _ = recipes_of(asymmetric("pid", f"control.attitude={{kind: geometric, {gains}, {integral}}}"))
    attitude = recipes["attitude"]
    assert attitude.system is IntegratingAttitudeController
    assert attitude.structure == {"period": 0.02, "integration": "backward_euler", "transports": False}
    assert attitude.parameters == IntegratingAttitudeParameters(pd["attitude"].parameters, PerAngle(3.0, 2.0, 1.0), 7.0)
    assert recipes["thrust_vectoring"].structure == {"projects": True, "sequence": "zxy"}
    parameters = "delay_ticks: 2, lag: 0.08, bandwidth: 6.0, disturbance_limit: 9.0"
    recipes, _ = recipes_of(asymmetric("pid", f"control.attitude={{kind: indi, {gains}, {parameters}}}"))
    attitude = recipes["attitude"]
    assert attitude.system is IncrementalAttitudeController
    assert attitude.structure == {"period": 0.02, "delay_ticks": 2}
    assert attitude.parameters == IncrementalAttitudeParameters(
        pd["attitude"].parameters, IncrementalLaw(6.0), 0.08, 9.0
    )
    assert not recipes["thrust_vectoring"].structure["projects"]


def test_a_network_has_the_fuzzy_sets_and_the_learning_law_of_the_scenario(asymmetric):
    recipes, plan = recipes_of(asymmetric("pd_t2fnn"))
    rules, learning = recipes["network.rules"], recipes["network.learning"]
    assert (rules.system, learning.system) == (FuzzyRules, WeightLearning)
    error = FuzzySets(2.4, (-1.0, -0.1, 0.8), (1.1, 0.9, 1.0))
    rate = FuzzySets(1.4, (-0.9, -0.4, 0.3, 1.1), (0.8, 0.7, 0.9, 1.2))
    assert rules.parameters == FuzzyRulesParameters((Antecedents(1.3, 0.7, 0.4, (error, rate)),), Lead(0.0))
    assert not rules.structure["leads"]
    assert not learning.structure["leads"]
    assert rules.structure["axes"] == learning.structure["axes"] == ("x", "y", "z")
    assert (learning.structure["num_rules"], learning.structure["period"]) == (12, 0.02)
    law, limits = CovarianceLaw(0.8, 5.0, 0.997), LearningLimits(0.9, 0.01, 0.02)
    assert learning.parameters == LearningParameters(1.4, law, limits, 0.05)
    # The first leg starts with the flight, before the network has learned anything, so no reset is needed.
    assert learning.structure["reset_times"] == tuple(plan.leg_times[1:])
    assert len(plan.leg_times) > 3
    recipes_without_reset, _ = recipes_of(asymmetric("pd_t2fnn", "control.network.learning.reset=never"))
    assert recipes_without_reset["network.learning"].structure["reset_times"] == ()


def test_a_type_1_network_has_triangular_sets_and_each_learning_law_has_its_parameters(asymmetric):
    recipes, _ = recipes_of(asymmetric("pd_t1fnn"))
    (sets,) = recipes["network.rules"].parameters.antecedents
    assert (sets.a1, sets.a2, sets.q) == (1.0, 1.0, 0.0)
    # The network learns from the command, so the slope λ of eq (15) is not used.
    learning = recipes["network.learning"].parameters
    assert learning == LearningParameters(0.0, SignLaw(0.05, 0.2), LearningLimits(1.5, 0.03, 0.0), -0.04)
    gradient = "control.network.learning={kind: gradient, rate: 0.4, slope: 1.7}"
    learning = recipes_of(asymmetric("pd_t1fnn", gradient))[0]["network.learning"].parameters
    assert (learning.law, learning.slope, learning.limits) == (GradientLaw(0.4), 1.7, LearningLimits())


def test_a_varying_parameter_is_an_array_with_an_entry_for_each_vehicle(asymmetric):
    """The gains and the parameters of a control law vary and become arrays.

    Nominal parameters are the same for all vehicles.
    """
    distributions = [
        "control.position.k_p.1={uniform: {min: 0.8, max: 1.2}}",
        "control.network.learning.gain={uniform: {min: 0.5, max: 1.0}}",
        "control.network.inputs.error.scale={uniform: {min: 2.0, max: 3.0}}",
        "vehicle.mass={uniform: {min: 0.6, max: 0.8}}",
    ]
    scenario = asymmetric("pd_t2fnn", *distributions)
    batch = Batch.draw(scenario, [4, 0, 7])
    recipes = control_recipes(batch, plan_route(scenario))
    k_p = recipes["position.pd"].parameters.k_p
    np.testing.assert_array_equal(k_p.y, batch.varying["control.position.k_p.1"])
    assert (k_p.x, k_p.z) == (1.3, 5.0)
    law = recipes["network.learning"].parameters.law
    np.testing.assert_array_equal(law.gain, batch.varying["control.network.learning.gain"])
    (sets,) = recipes["network.rules"].parameters.antecedents
    error, rate = sets.inputs
    np.testing.assert_array_equal(error.scale, batch.varying["control.network.inputs.error.scale"])
    assert (rate.scale, error.centres) == (1.4, (-1.0, -0.1, 0.8))
    assert recipes["thrust_vectoring"].parameters.mass == 0.7


@pytest.mark.parametrize("field", ["position_noise", "deviation.1", "time_constant.1"])
def test_a_kalman_filter_is_designed_for_each_vehicle_of_a_fleet(asymmetric, field):
    parameters = "position_noise: 0.002, deviation: [0.3, 0.4, 0.5], time_constant: [1.0, 2.0, 3.0]"
    position = (
        f"{{kind: disturbance_observer, {PD_GAINS}, {parameters}, response: {{kind: commanded, lag: [0.2, 0.3, 0.1]}}}}"
    )
    scenario = asymmetric("pid", f"control.position={position}")
    numbers_of_vehicles = np.array([0.1, 0.5])
    batch = Batch(scenario, (0, 1), {f"control.position.{field}": numbers_of_vehicles})
    laws = control_recipes(batch, plan_route(scenario))["position.estimator"].parameters.laws
    for vehicle, varied_number in enumerate(numbers_of_vehicles):
        law_numbers = {
            "position_noise": 0.002,
            "deviation": 0.4,
            "time_constant": 2.0,
            field.removesuffix(".1"): varied_number,
        }
        expected = KalmanLaw.of(**law_numbers, period=0.02)
        assert laws[1].gain.position[vehicle] == expected.gain.position


def test_adaptive_fuzzy_sets_initially_have_learned_parameters_or_else_equal_parameters_on_all_axes(asymmetric):
    adaptive = "control.network.adaptive={centres: 0.4, exponents: 0.2}"
    recipes, _ = recipes_of(asymmetric("pd_t2fnn", adaptive))
    rules, learning, set_learning = (recipes[f"network.{part}"] for part in ("rules", "learning", "sets"))
    assert rules.structure["adaptive"]
    (initial_sets,) = rules.parameters.antecedents
    assert set_learning.system is SetLearning
    assert set_learning.parameters == AdaptationParameters(
        (initial_sets,) * 3, AdaptationRates(centres=0.4, exponents=0.2), learning.parameters
    )
    assert (set_learning.structure["parts"], set_learning.structure["axes"]) == (
        ("centres", "exponents"),
        ("x", "y", "z"),
    )
    assert (set_learning.structure["period"], set_learning.structure["inputs"]) == (0.02, ("error", "error_rate"))
    layout = layout_of(Antecedents, initial_sets)
    parameters = np.linspace(0.5, 1.5, layout.num_rows)
    axes = {
        axis: {"weights": (index + np.linspace(0.1, 0.9, 12)).tolist(), "antecedents": (index + parameters).tolist()}
        for index, axis in enumerate("xyz")
    }
    learned_network = {"kind": "type_2", "inputs": ["error", "error_rate"], "sets": [3, 4], **axes}
    scenario = asymmetric("pd_t2fnn", adaptive)
    control = scenario.control.model_dump(mode="json")
    control["network"]["learned"] = learned_network
    recipes, _ = recipes_of(with_fields(scenario, {"control": control}))
    learned_sets = recipes["network.sets"].parameters.antecedents
    assert recipes["network.rules"].parameters.antecedents == learned_sets
    for index, axis_sets in enumerate(learned_sets):
        a1, a2, q, inputs = axis_sets
        sets = (number for scale, centres, widths in inputs for number in (scale, *centres, *widths))
        np.testing.assert_allclose([a1, a2, q, *sets], index + parameters)
    weights = recipes["network.learning"].structure["initial_weights"]
    np.testing.assert_allclose(weights, np.arange(3)[:, np.newaxis] + np.linspace(0.1, 0.9, 12))


def test_a_network_with_the_phase_as_input_receives_the_lap_times(asymmetric):
    laps = ("route={kind: lissajous, amplitude: [0.1, 0.2, 0], period: 5, laps: 2}", "metrics={start: 0}")
    for inputs, kinds in (
        ("{error_rate: null}", [FuzzySets]),
        ("{error_rate: null, phase: {}}", [FuzzySets, CircularSets]),
    ):
        learning = "{kind: gradient, rate: 1.0, signal: feedback}"
        network = f"{{kind: type_1, axes: [y], lead: 0.1, inputs: {inputs}, learning: {learning}}}"
        recipes, plan = recipes_of(asymmetric("pd_t1fnn", *laps, f"control.network={network}"))
        rules, learning = recipes["network.rules"], recipes["network.learning"]
        assert rules.structure["lap_times"] == (plan.lap_times if CircularSets in kinds else ())
        assert [type(sets) for sets in rules.parameters.antecedents[0].inputs] == kinds
        assert rules.structure["leads"]
        assert learning.structure["leads"]
        assert rules.parameters.lead == Lead(0.1)
        assert learning.structure["learns_from"] == "feedback"
    surface, sign = (recipes_of(asymmetric(name))[0]["network.learning"].structure for name in ("pd_t2fnn", "pd_t1fnn"))
    assert (surface["learns_from"], sign["learns_from"]) == ("surface", "feedback")
    assert surface["initial_weights"] == ()


def test_a_control_without_a_network_has_no_network_recipe(asymmetric):
    for name in ("pid", "lqg"):
        assert not any(path.startswith("network") for path in recipes_of(asymmetric(name, "control.network=null"))[0])


def test_a_tilt_estimator_uses_the_nominal_gravity(asymmetric):
    response = "response: {kind: tilt, delay_ticks: 2, lag: 0.13}"
    parameters = "bandwidth: [1.0, 2.0, 3.0], disturbance_limit: 0.8"
    recipes, _ = recipes_of(asymmetric("pid", f"control.position={{kind: indi, {PD_GAINS}, {response}, {parameters}}}"))
    estimator = recipes["position.estimator"]
    assert estimator.system is TiltDisturbanceEstimator
    assert estimator.structure == {"period": 0.02, "delay_ticks": 2}
    laws = (IncrementalLaw(1.0), IncrementalLaw(2.0), IncrementalLaw(3.0))
    assert estimator.parameters == TiltEstimatorParameters(laws, 0.13, 9.79, 0.8, PerAxis(0.3, -0.2, 1.0))
