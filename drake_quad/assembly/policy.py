"""The policy of a scenario."""

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram

from drake_quad.control.axes import PerAngle
from drake_quad.control.policy.actions import (
    AccelerationScale,
    AttitudeScale,
    PerRotor,
    RatesScale,
    SpeedScale,
    ThrustRange,
)
from drake_quad.control.policy.actuation import (
    ROWS,
    AccelerationActuation,
    AttitudeActuation,
    RatesFromTheGround,
    RatesOnBoard,
    RotorSpeedActuation,
)
from drake_quad.control.policy.observation import ObservationNumbers
from drake_quad.control.policy.systems import Observation, Policy, build_policy_control
from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.flight_monitor import Solid, nearest_solid
from drake_quad.planning.believed import nominal_parameters
from drake_quad.planning.space import space_of
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.policy import AccelerationAction, AttitudeAction, PolicyControl, RatesAction, RotorSpeedsAction
from drake_quad.signals import BodyRates, RotorSpeed, Row, Wrench
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.parameters import QuadrotorParameters


class Clearance(NamedTuple):
    """How far a vehicle is from obstacles: a function of X, Y and Z, m.

    Attributes:
        solids: that it must not touch.
        radius: of the vehicle, m.
    """

    solids: tuple[Solid, ...]
    radius: float

    def __call__(self, x: Row, y: Row, z: Row) -> Row:
        """The distance between the surfaces, m."""
        distance, _ = nearest_solid(x, y, z, self.solids)
        return distance - self.radius


def policy_recipes(batch: Batch) -> dict[str, Recipe]:
    """Recipes for what a policy needs around it, and for the policy if there is one, by their paths in the diagram.

    Args:
        batch: that is flown, of a scenario with a `PolicyControl`.
    """
    scenario, fleet = batch.scenario, batch.fleet_scenario
    control = scenario.control
    assert isinstance(control, PolicyControl)
    believed, period = nominal_parameters(scenario), scenario.laboratory.command_link.period
    clearance = None
    if "clearance" in control.observation.signals:
        space = space_of(scenario)
        assert space is not None
        clearance = Clearance(tuple([obstacle.shape for obstacle in space.obstacles]), space.radius)
    structure = {
        "period": period,
        "spec": control.observation.spec(),
        "num_actions": ROWS[control.action.kind],
        "num_ahead": len(control.observation.ahead),
        "clearance": clearance,
    }
    numbers = ObservationNumbers(believed.max_rotor_speed, hovering_action(control, believed))
    recipes = {"observation": Recipe(Observation, structure, numbers)}
    if control.policy is not None:
        recipes["policy"] = Recipe(Policy, {"period": period, "network": control.policy.network()}, None)
    return recipes | {"actuation": _actuation(scenario, fleet, believed)}


def policy_rows(scenario: Scenario) -> dict[str, int]:
    """Rows of what a policy sees and of what it does; nothing if the scenario's control is another."""
    control = scenario.control
    if not isinstance(control, PolicyControl):
        return {}
    return {"observation": control.observation.num_rows(control.action), "action": ROWS[control.action.kind]}


def build_policy_control_of(scenario: Scenario, systems: dict[str, Any], policy: Any = None) -> Diagram:
    """Builds the control of a scenario with a `PolicyControl`.

    Args:
        scenario: it is of.
        systems: its parts, by their paths.
        policy: of the user's, in place of the scenario's.
    """
    control = scenario.control
    assert isinstance(control, PolicyControl)
    return build_policy_control(
        observation=systems["observation"],
        policy=systems.get("policy", policy),
        actuation=systems["actuation"],
        sees=control.observation.sees,
        thrust_vectoring=systems.get("thrust_vectoring"),
        attitude=systems.get("attitude"),
    )


def _actuation(scenario: Scenario, fleet: Any, believed: QuadrotorParameters) -> Recipe:
    """Return the recipe of the system that converts the actions of a policy to commands."""
    control: Any = scenario.control
    action, weight = control.action, believed.mass * believed.gravity
    match action:
        case AccelerationAction():
            axes = {"frame": action.frame, "turn": control.observation.turn}
            return Recipe(AccelerationActuation, axes, AccelerationScale(*action.most))
        case AttitudeAction():
            return Recipe(
                AttitudeActuation, {}, AttitudeScale(_thrusts(action, weight), action.max_tilt, action.max_yaw)
            )
        case RatesAction():
            own, on_board = fleet.control, scenario.laboratory.autopilot.kind != "none"
            gains = (0.0, 0.0, 0.0)
            if not on_board:
                gains = own.attitude.k_d if action.k_rate is None else own.action.k_rate
            rates = BodyRates(*action.max_rates)
            scale = RatesScale(_thrusts(action, weight), rates, PerAngle(*gains), *believed.inertia)
            return Recipe(RatesOnBoard if on_board else RatesFromTheGround, {}, scale)
    units = [RotorSpeed._make(np.eye(4)[rotor].tolist()) for rotor in range(4)]
    wrenches = PerRotor._make(Wrench._make(map(float, rotor_action(unit, believed).wrench)) for unit in units)
    order = tuple([action.order.index(rotor) for rotor in (1, 2, 3, 4)])
    speeds = SpeedScale(_least(action, believed), believed.max_rotor_speed, wrenches)
    return Recipe(RotorSpeedActuation, {"order": order}, speeds)


def _thrusts(action: Any, weight: float) -> ThrustRange:
    return ThrustRange(action.min_thrust * weight, action.max_thrust * weight)


def _least(action: RotorSpeedsAction, believed: QuadrotorParameters) -> float:
    return float(believed.min_rotor_speed if action.least is None else action.least)


def hovering_action(control: PolicyControl, believed: QuadrotorParameters) -> tuple[float, ...]:
    """The action that is believed to hold a vehicle in hover."""
    action = control.action
    match action:
        case AccelerationAction():
            return (0.0, 0.0, 0.0)
        case RotorSpeedsAction():
            least, most = _least(action, believed), float(believed.max_rotor_speed)
            speeds = hover_rotor_speeds(believed)
            return tuple([2.0 * (float(speeds[rotor - 1]) - least) / (most - least) - 1.0 for rotor in action.order])
    return (2.0 * (1.0 - action.min_thrust) / (action.max_thrust - action.min_thrust) - 1.0, 0.0, 0.0, 0.0)
