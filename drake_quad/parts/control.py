"""The control of a scenario."""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram

from drake_quad.control.attitude import AttitudeController
from drake_quad.control.cascade import build_cascade
from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, Limits, SignLaw
from drake_quad.control.fuzzy.systems import FuzzyRules, WeightLearning, build_fuzzy_network
from drake_quad.control.integral import IntegralCorrection
from drake_quad.control.position import ProportionalDerivative, build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring
from drake_quad.elementary import Row
from drake_quad.parts.part import Part
from drake_quad.planning import nominal_parameters
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario, controllers


def control_parts(scenario: Scenario, plan: Plan, num_vehicles: int) -> dict[str, Part]:
    """What the cascade of a scenario is made of, by the path in its diagram; it believes the nominal numbers.

    Args:
        scenario: of numbers.
        plan: that is flown.
        num_vehicles: N.
    """
    position, attitude = scenario.control.position, scenario.control.attitude
    common = {"num_vehicles": num_vehicles}
    believed = nominal_parameters(scenario)
    limits = scenario.control.thrust_vectoring
    weight = believed.mass * believed.gravity
    thrust = ThrustLimits(np.tan(limits.max_tilt), limits.min_thrust * weight, limits.max_thrust * weight)
    gains = {"k_p": position.k_p, "k_d": position.k_d, "derivative": position.derivative}
    vectoring = {"mass": believed.mass, "gravity": believed.gravity, "limits": thrust}
    return {
        "position.pd": Part(
            ProportionalDerivative, {**common, **gains, "feed_forward": position.feed_forward != "none"}
        ),
        **_correction(position, plan, {**common, "period": scenario.laboratory.command_link.period}),
        "thrust_vectoring": Part(ThrustVectoring, {**common, **vectoring}),
        "attitude": Part(
            AttitudeController, {**common, "k_p": attitude.k_p, "k_d": attitude.k_d, "inertia": believed.inertia}
        ),
    }


def build_control(scenario: Scenario, parts: dict[str, Part], position_controller: Any = None) -> Diagram:
    """The cascade of a scenario.

    Args:
        scenario: it is of.
        parts: of its control.
        position_controller: takes the place of the scenario's.
    """
    if position_controller is None:
        correction = None
        if "position.integral" in parts:
            correction = parts["position.integral"].build()
            correction.set_name("integral")
        elif "position.network.rules" in parts:
            correction = build_fuzzy_network(
                rules=parts["position.network.rules"].build(), learning=parts["position.network.learning"].build()
            )
        position_controller = build_position_controller(parts["position.pd"].build(), correction=correction)
    return build_cascade(
        position=position_controller,
        thrust_vectoring=parts["thrust_vectoring"].build(),
        attitude=parts["attitude"].build(),
        feed_forward=scenario.control.position.feed_forward,
    )


def _correction(position: controllers.PositionController, plan: Plan, common: dict[str, Any]) -> dict[str, Part]:
    """What is subtracted from a position controller's PD, if anything is."""
    match position:
        case controllers.PidPosition():
            integral = {**common, "k_i": position.k_i, "limit": position.integral_limit}
            return {"position.integral": Part(IntegralCorrection, integral)}
        case controllers.Type1Position() | controllers.Type2Position():
            return _network(position, plan, common)
    return {}


def _network(
    position: controllers.Type1Position | controllers.Type2Position, plan: Plan, common: dict[str, Any]
) -> dict[str, Part]:
    learning = position.learning
    law: Any
    slope: Row = 1.0
    reset_times: list[float] = []
    match learning:
        case controllers.CovarianceLearning():
            law = CovarianceLaw(learning.gain, learning.initial_covariance, learning.forgetting)
            slope = learning.slope
            if learning.reset == "at_segments":
                reset_times = plan.leg_times[1:]
        case controllers.GradientLearning():
            law, slope = GradientLaw(learning.rate), learning.slope
        case controllers.SignLearning():
            law = SignLaw(learning.rate, learning.initial_slope)
    limit = math.inf if learning.weight_limit is None else learning.weight_limit
    sets = antecedents(position)
    rules = {"num_vehicles": common["num_vehicles"], "axes": position.axes, "antecedents": sets}
    learner = {
        "axes": position.axes,
        "num_rules": sets.num_rules,
        "law": law,
        "slope": slope,
        "limits": Limits(limit, learning.deadzone, learning.leakage),
        "initial_weight": learning.initial_weight,
        "reset_times": reset_times,
    }
    return {
        "position.network.rules": Part(FuzzyRules, rules),
        "position.network.learning": Part(WeightLearning, {**common, **learner}),
    }


def antecedents(position: controllers.Type1Position | controllers.Type2Position) -> Antecedents:
    """The antecedents of a controller's network."""
    network = position.network
    inputs = (FuzzySets(sets.scale, sets.centres, sets.widths) for sets in (network.error, network.rate))
    exponents = (network.a1, network.a2, network.q) if isinstance(network, controllers.Ellipses) else (1.0, 1.0, 0.0)
    return Antecedents(*exponents, *inputs)
