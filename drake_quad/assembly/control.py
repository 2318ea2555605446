"""The control of a scenario."""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram

from drake_quad.assembly.lqg import build_lqg_control, lqg_recipes
from drake_quad.assembly.planning import nominal_parameters
from drake_quad.assembly.recipe import FleetScenario, Recipe
from drake_quad.control.attitude import AttitudeController, AttitudeNumbers
from drake_quad.control.axes import PerAngle, PerAxis
from drake_quad.control.cascade import build_cascade
from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, Limits, SignLaw
from drake_quad.control.fuzzy.systems import FuzzyRules, LearningNumbers, WeightLearning, build_fuzzy_network
from drake_quad.control.integral import IntegralCorrection, IntegralGains
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring, VectoringNumbers
from drake_quad.errors import InputError
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Batch, Scenario
from drake_quad.vehicle.parameters import Inertia


def control_recipes(batch: Batch, plan: Plan) -> dict[str, Recipe]:
    """Recipes for what the control of a scenario is made of, by the path in its diagram; it believes the nominal.

    Args:
        batch: that is flown.
        plan: that is flown.
    """
    scenario, fleet = batch.scenario, FleetScenario(batch)
    if scenario.control.kind == "lqg":
        return lqg_recipes(batch)
    position = fleet.control.position
    believed = nominal_parameters(scenario)
    limits = fleet.control.thrust_vectoring
    weight = believed.mass * believed.gravity
    thrust = ThrustLimits(np.tan(limits.max_tilt), limits.min_thrust * weight, limits.max_thrust * weight)
    derivative, feeds_forward = position.derivative, position.feed_forward != "none"
    return {
        "position.pd": Recipe(
            ProportionalDerivative,
            {"derivative": derivative, "feeds_forward": feeds_forward},
            PdGains(PerAxis(*position.k_p), PerAxis(*position.k_d)),
        ),
        **_correction(scenario, position, plan),
        "thrust_vectoring": Recipe(ThrustVectoring, {}, VectoringNumbers(believed.mass, believed.gravity, thrust)),
        **_attitude(fleet.control.attitude, believed.inertia),
    }


def build_control(
    scenario: Scenario, recipes: dict[str, Recipe], num_vehicles: int, position_controller: Any = None
) -> Diagram:
    """Builds the control of a scenario.

    Args:
        scenario: it is of.
        recipes: of its parts.
        num_vehicles: N.
        position_controller: takes the place of the scenario's, for which there are no recipes then.

    Raises:
        InputError: there is a position controller, but no cascade.
    """
    if scenario.control.kind == "lqg":
        if position_controller is not None:
            raise InputError(f"control of {scenario.name} is of kind lqg: it has no place for a position_controller")
        return build_lqg_control(recipes, num_vehicles)
    systems = {path: recipe.build(num_vehicles) for path, recipe in recipes.items()}
    if position_controller is None:
        correction = None
        if "position.integral" in systems:
            correction = systems["position.integral"]
            correction.set_name("integral")
        elif "position.network.rules" in systems:
            correction = build_fuzzy_network(
                rules=systems["position.network.rules"], learning=systems["position.network.learning"]
            )
        position_controller = build_position_controller(systems["position.pd"], correction=correction)
    return build_cascade(
        position=position_controller,
        thrust_vectoring=systems["thrust_vectoring"],
        attitude=systems.get("attitude"),
        feed_forward=scenario.cascade.position.feed_forward,
    )


def _attitude(gains: Any, inertia: Inertia) -> dict[str, Recipe]:
    """The attitude controller on the ground; none if attitude is controlled on board.

    Args:
        gains: of a scenario or a `FleetScenario`; None with an autopilot.
        inertia: believed.
    """
    if gains is None:
        return {}
    numbers = AttitudeNumbers(PerAngle(*gains.k_p), PerAngle(*gains.k_d), *inertia)
    return {"attitude": Recipe(AttitudeController, {}, numbers)}


def _correction(scenario: Scenario, position: Any, plan: Plan) -> dict[str, Recipe]:
    """What is subtracted from a position controller's PD, if anything is."""
    period = scenario.laboratory.command_link.period
    match position.kind:
        case "pid":
            gains = IntegralGains(PerAxis(*position.k_i), position.integral_limit)
            return {"position.integral": Recipe(IntegralCorrection, {"period": period}, gains)}
        case "pd_t1fnn" | "pd_t2fnn":
            return _network(position, plan, period)
    return {}


def _network(position: Any, plan: Plan, period: float) -> dict[str, Recipe]:
    learning, sets = position.learning, antecedents(position)
    law: Any
    match learning.kind:
        case "covariance":
            law = CovarianceLaw(learning.gain, learning.initial_covariance, learning.forgetting)
        case "gradient":
            law = GradientLaw(learning.rate)
        case "sign":
            law = SignLaw(learning.rate, learning.initial_slope)
    limit = math.inf if learning.weight_limit is None else learning.weight_limit
    resets = learning.kind == "covariance" and learning.reset == "at_segments"
    axes = tuple([axis for axis in ("x", "y", "z") if axis in position.axes])
    numbers = LearningNumbers(
        slope=0.0 if learning.kind == "sign" else learning.slope,
        law=law,
        limits=Limits(limit, learning.deadzone, learning.leakage),
        initial_weight=learning.initial_weight,
    )
    structure = {
        "period": period,
        "axes": axes,
        "num_rules": sets.num_rules,
        "reset_times": tuple(plan.leg_times[1:]) if resets else (),
    }
    return {
        "position.network.rules": Recipe(FuzzyRules, {"axes": axes}, sets),
        "position.network.learning": Recipe(WeightLearning, structure, numbers),
    }


def antecedents(position: Any) -> Antecedents:
    """The antecedents of the network of a position controller of a scenario, or of a `FleetScenario`."""
    network = position.network
    inputs = (FuzzySets(sets.scale, tuple(sets.centres), tuple(sets.widths)) for sets in (network.error, network.rate))
    exponents = (network.a1, network.a2, network.q) if position.kind == "pd_t2fnn" else (1.0, 1.0, 0.0)
    return Antecedents(*exponents, *inputs)
