"""The control of a scenario."""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram

from drake_quad.assembly.lqg import build_lqg_control, lqg_recipes
from drake_quad.assembly.mpc import mpc_recipes
from drake_quad.assembly.policy import build_policy_control_of, policy_recipes
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.control.attitude import AttitudeController, AttitudeNumbers
from drake_quad.control.axes import PerAngle, PerAxis
from drake_quad.control.cascade import build_cascade
from drake_quad.control.disturbance.estimator import DisturbanceEstimator, EstimatorNumbers
from drake_quad.control.disturbance.laws import AdaptiveLaw, IncrementalLaw, KalmanLaw, KalmanMemory
from drake_quad.control.disturbance.response import Command
from drake_quad.control.disturbance.tilt import TiltDisturbanceEstimator, TiltEstimatorNumbers
from drake_quad.control.fuzzy.adaptation import AdaptationRates
from drake_quad.control.fuzzy.inference import Antecedents, CircularSets, FuzzySets
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, Limits, SignLaw
from drake_quad.control.fuzzy.set_learning import AdaptationNumbers, SetLearning
from drake_quad.control.fuzzy.systems import (
    FuzzyRules,
    Lead,
    LearningNumbers,
    RulesNumbers,
    WeightLearning,
    build_fuzzy_network,
)
from drake_quad.control.geometric import (
    GeometricAttitudeController,
    IntegratingAttitudeController,
    IntegratingAttitudeNumbers,
)
from drake_quad.control.incremental_attitude import IncrementalAttitudeController, IncrementalAttitudeNumbers
from drake_quad.control.integral import IntegralCorrection, IntegralGains
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring, VectoringNumbers
from drake_quad.errors import InputError
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import layout_of
from drake_quad.planning.believed import nominal_parameters
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.lqg import LqgControl
from drake_quad.scenario.models import Control, Scenario
from drake_quad.scenario.policy import PolicyControl
from drake_quad.scenario.quantities import can_differ_from_zero
from drake_quad.vehicle.parameters import Inertia, QuadrotorParameters


def control_recipes(batch: Batch, plan: Plan) -> dict[str, Recipe]:
    """Recipes for what the control of a scenario is made of, by the path in its diagram; it believes the nominal.

    Args:
        batch: that is flown.
        plan: that is flown.
    """
    scenario, fleet = batch.scenario, batch.fleet_scenario
    if isinstance(scenario.control, LqgControl):
        recipes = lqg_recipes(batch)
        recipes |= mpc_recipes(batch, plan, recipes["regulator"].numbers)
        return {**recipes, **_network(scenario, fleet.control.network, plan)}
    believed = nominal_parameters(scenario)
    if isinstance(scenario.control, PolicyControl):
        recipes = policy_recipes(batch)
        if scenario.control.action.kind == "acceleration":
            recipes |= _vectoring(fleet, believed)
        commanded = scenario.control.commands_attitude
        return recipes | (_attitude(scenario, fleet.control.attitude, believed.inertia) if commanded else {})
    position = fleet.control.position
    derivative, feeds_forward = position.derivative, position.feed_forward != "none"
    return {
        "position.pd": Recipe(
            ProportionalDerivative,
            {"derivative": derivative, "feeds_forward": feeds_forward},
            PdGains(PerAxis(*position.k_p), PerAxis(*position.k_d)),
        ),
        **_integral(position, scenario.laboratory.command_link.period),
        **_estimator(scenario, position, plan),
        **_network(scenario, fleet.control.network, plan),
        **_vectoring(fleet, believed),
        **_attitude(scenario, fleet.control.attitude, believed.inertia),
    }


def build_control(
    scenario: Scenario, recipes: dict[str, Recipe], num_vehicles: int, own: UserSystems = UserSystems()
) -> Diagram:
    """Builds the control of a scenario.

    Args:
        scenario: it is of.
        recipes: of its parts.
        num_vehicles: N.
        own: systems of the user's: a position controller or a policy takes the place of the scenario's, for which there
            are no recipes then.

    Raises:
        InputError: there is a position controller, but no cascade.
    """
    position_controller = own.position_controller
    if not isinstance(scenario.control, Control) and position_controller is not None:
        kind = scenario.control.kind
        raise InputError(f"control of {scenario.name} is of kind {kind}: it has no place for a position_controller")
    systems = {path: recipe.build(num_vehicles) for path, recipe in recipes.items()}
    if isinstance(scenario.control, PolicyControl):
        return build_policy_control_of(scenario, systems, own.policy)
    network = None
    if "network.rules" in systems:
        parts = {name: systems.get(f"network.{name}") for name in ("rules", "learning", "sets")}
        network = build_fuzzy_network(**parts)
    if isinstance(scenario.control, LqgControl):
        return build_lqg_control(systems["regulator"], network, systems.get("programme"))
    if position_controller is None:
        position_controller = build_position_controller(
            systems["position.pd"],
            integral=systems.get("position.integral"),
            disturbance=systems.get("position.estimator"),
            takes_correction=network is not None,
        )
    return build_cascade(
        position=position_controller,
        network=network,
        thrust_vectoring=systems["thrust_vectoring"],
        attitude=systems.get("attitude"),
        feed_forward=scenario.cascade.position.feed_forward,
    )


def _vectoring(fleet: Any, believed: QuadrotorParameters) -> dict[str, Recipe]:
    """Return the recipe of thrust vectoring, based on the nominal vehicle."""
    limits, attitude = fleet.control.thrust_vectoring, fleet.control.attitude
    weight = believed.mass * believed.gravity
    thrust = ThrustLimits(np.tan(limits.max_tilt), limits.min_thrust * weight, limits.max_thrust * weight)
    structure: dict[str, Any] = {"projects": False}
    if attitude is not None and attitude.kind == "geometric":
        structure = {"projects": True, "sequence": attitude.euler_sequence}
    numbers = VectoringNumbers(believed.mass, believed.gravity, thrust)
    return {"thrust_vectoring": Recipe(ThrustVectoring, structure, numbers)}


def _attitude(scenario: Scenario, attitude: Any, inertia: Inertia) -> dict[str, Recipe]:
    """Return the recipe of the attitude controller on the ground; no recipe if attitude is controlled on board.

    Args:
        scenario: scenario with the controller.
        attitude: attitude controller of the scenario or of a `Batch.fleet_scenario`; None with an autopilot.
        inertia: inertia of the nominal vehicle.
    """
    if attitude is None:
        return {}
    numbers = AttitudeNumbers(PerAngle(*attitude.k_p), PerAngle(*attitude.k_d), *inertia)
    period = scenario.laboratory.command_link.period
    match attitude.kind:
        case "geometric" if attitude.k_i is None:
            return {"attitude": Recipe(GeometricAttitudeController, {"transports": attitude.transport_term}, numbers)}
        case "geometric":
            integrating = IntegratingAttitudeNumbers(numbers, PerAngle(*attitude.k_i), attitude.integral_limit)
            structure = {"integration": attitude.integration, "transports": attitude.transport_term}
            return {"attitude": Recipe(IntegratingAttitudeController, {"period": period, **structure}, integrating)}
        case "indi":
            structure = {"period": period, "delay_ticks": attitude.delay_ticks}
            law = IncrementalLaw(attitude.bandwidth)
            incremental = IncrementalAttitudeNumbers(numbers, law, attitude.lag, attitude.disturbance_limit)
            return {"attitude": Recipe(IncrementalAttitudeController, structure, incremental)}
    return {"attitude": Recipe(AttitudeController, {}, numbers)}


def _integral(position: Any, period: float) -> dict[str, Recipe]:
    """Return the recipe of the integral of a position controller; no recipe if it has no integral."""
    if position.kind != "pid":
        return {}
    gains = IntegralGains(PerAxis(*position.k_i), position.integral_limit)
    structure = {"period": period, "integration": position.integration}
    return {"position.integral": Recipe(IntegralCorrection, structure, gains)}


def _estimator(scenario: Scenario, position: Any, plan: Plan) -> dict[str, Recipe]:
    """The estimator of the disturbance, if a position controller has one."""
    if position.kind not in _LAWS:
        return {}
    period, response = scenario.laboratory.command_link.period, position.response
    laws = tuple([_LAWS[position.kind](position, axis, period) for axis in range(3)])
    limit, start = position.disturbance_limit, PerAxis(*map(float, plan.waypoints[0]))
    structure = {"period": period, "delay_ticks": response.delay_ticks}
    if response.kind == "tilt":
        by_tilt = TiltEstimatorNumbers(laws, response.lag, scenario.nominal.gravity, limit, start)
        return {"position.estimator": Recipe(TiltDisturbanceEstimator, structure, by_tilt)}
    fed_forward = response.lag if response.feed_forward_lag is None else response.feed_forward_lag
    lags = tuple([Command(*lags) for lags in zip(response.lag, fed_forward, strict=True)])
    return {"position.estimator": Recipe(DisturbanceEstimator, structure, EstimatorNumbers(laws, lags, limit, start))}


def _kalman_law(position: Any, axis: int, period: float) -> KalmanLaw:
    """The Kalman filter of an axis, vehicle by vehicle where its statistics vary."""
    statistics = position.deviation[axis], position.time_constant[axis], position.position_noise
    if not any(np.ndim(number) for number in statistics):
        return _kalman_filter(*statistics, period)
    laws = [_kalman_filter(*map(float, own), period) for own in np.broadcast(*statistics)]
    time_constant: Any = np.array([law.time_constant for law in laws])
    return KalmanLaw(time_constant, KalmanMemory(*np.transpose([law.gain for law in laws])))


@functools.lru_cache(maxsize=4096)
def _kalman_filter(deviation: float, time_constant: float, position_noise: float, period: float) -> KalmanLaw:
    return KalmanLaw.of(deviation=deviation, time_constant=time_constant, position_noise=position_noise, period=period)


def _adaptive_law(position: Any, axis: int, period: float) -> AdaptiveLaw:
    return AdaptiveLaw(position.adaptation, position.bandwidth[axis])


def _incremental_law(position: Any, axis: int, period: float) -> IncrementalLaw:
    return IncrementalLaw(position.bandwidth[axis])


_LAWS: dict[str, Callable[[Any, int, float], Any]] = {
    "disturbance_observer": _kalman_law,
    "l1": _adaptive_law,
    "indi": _incremental_law,
}


def _network(scenario: Scenario, network: Any, plan: Plan) -> dict[str, Recipe]:
    """The network around a controller, if there is one.

    Args:
        scenario: it is of.
        network: as a `Batch.fleet_scenario` has it.
        plan: that is flown.
    """
    own = scenario.control.network
    if own is None:
        return {}
    period = scenario.laboratory.command_link.period
    learning, sets = network.learning, antecedents(network)
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
    axes = tuple([axis for axis in ("x", "y", "z") if axis in network.axes])
    inputs = tuple(network.inputs.given)
    lap_times = plan.lap_times if "phase" in inputs else ()
    numbers = LearningNumbers(
        slope=0.0 if learning.kind == "sign" else learning.slope,
        law=law,
        limits=Limits(limit, learning.deadzone, learning.leakage),
        initial_weight=learning.initial_weight,
    )
    leads = can_differ_from_zero(own.lead)
    learns_from = "feedback" if learning.kind == "sign" else learning.signal
    timing = {"period": period, "axes": axes, "learns_from": learns_from}
    looks_at = {"axes": axes, "inputs": inputs, "lap_times": lap_times}
    resets_at = tuple(plan.leg_times[1:]) if resets else ()
    known, begun = (() if network.learned is None else tuple(network.learned.axes.values())), (sets,)
    if any(each.antecedents is not None for each in known):
        layout = layout_of(Antecedents, sets)
        begun = tuple([layout.build(each.antecedents) for each in known])
    found = {
        "network.rules": Recipe(
            FuzzyRules,
            {**looks_at, "adaptive": network.adaptive is not None, "leads": leads},
            RulesNumbers(begun, Lead(network.lead)),
        ),
        "network.learning": Recipe(
            WeightLearning,
            {
                **timing,
                "num_rules": sets.num_rules,
                "leads": leads,
                "reset_times": resets_at,
                "initial_weights": tuple([each.weights for each in known]),
            },
            numbers,
        ),
    }
    if network.adaptive is not None:
        parts = network.adaptive.parts
        rates = AdaptationRates(**{part: getattr(network.adaptive, part) for part in parts})
        adaptation = AdaptationNumbers(begun * len(axes) if len(begun) == 1 else begun, rates, numbers)
        found["network.sets"] = Recipe(SetLearning, {**timing, **looks_at, "parts": parts}, adaptation)
    return found


def antecedents(network: Any) -> Antecedents:
    """The antecedents of the network of a scenario, or of a `Batch.fleet_scenario`."""
    of_inputs = ((name, getattr(network.inputs, name)) for name in network.inputs.given)
    inputs = (
        (CircularSets if name == "phase" else FuzzySets)(sets.scale, tuple(sets.centres), tuple(sets.widths))
        for name, sets in of_inputs
    )
    a1, a2, q = (network.a1, network.a2, network.q) if network.kind == "type_2" else (1.0, 1.0, 0.0)
    return Antecedents(a1, a2, q, tuple(inputs))
