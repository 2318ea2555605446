"""Assembly of a scenario's control diagram."""

from pydrake.systems.framework import Diagram

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.framework.recipe import Recipe
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.quantities import can_differ_from_zero
from drake_quad.scenario.setting import ControlSetting


def control_setting(scenario: Scenario, plan: Plan) -> ControlSetting:
    """Return those properties of a scenario and its plan that the control depends on."""
    laboratory = scenario.laboratory
    return ControlSetting(
        nominal=nominal_parameters(scenario),
        plan=plan,
        tick=laboratory.command_link.period,
        frame=laboratory.motion_capture.period,
        loses_frames=can_differ_from_zero(laboratory.motion_capture.dropout_rate),
        autopilot=laboratory.autopilot,
        space=scenario.flight_space(),
    )


def control_recipes(batch: Batch, plan: Plan, user_systems: UserSystems = UserSystems()) -> dict[str, Recipe]:
    """Return a `Recipe` for each system in the control diagram, keyed by the system's path.

    Args:
        batch: samples to fly, with one vehicle for each.
        plan: plan that the vehicles follow.
        user_systems: the user's systems. The result contains no recipe for a system that one of them replaces.
    """
    if user_systems.control is not None:
        return {}
    user_system_paths = batch.scenario.control.user_system_paths
    replaced_paths = tuple([start for name in user_systems.specified for start in user_system_paths.get(name, ())])
    recipes: dict[str, Recipe] = batch.fleet_scenario.control.recipes(control_setting(batch.scenario, plan))
    return {path: recipe for path, recipe in recipes.items() if not path.startswith(replaced_paths)}


def build_control(
    scenario: Scenario, recipes: dict[str, Recipe], num_vehicles: int, user_systems: UserSystems = UserSystems()
) -> Diagram:
    """Build the control diagram of a scenario.

    Args:
        scenario: scenario with the control.
        recipes: recipes from `control_recipes`, keyed by path.
        num_vehicles: number of vehicles N.
        user_systems: the user's systems, which replace systems of the control diagram.

    Raises:
        InputError: if the user passes a position controller, but the control is not a cascade.
    """
    control = scenario.control
    if user_systems.position_controller is not None and "position_controller" not in control.user_system_paths:
        raise InputError(
            f"control of {scenario.name} is of kind {control.kind}, which has no position_controller to replace; use a"
            " cascade"
        )
    return control.build({path: recipe.build(num_vehicles) for path, recipe in recipes.items()}, user_systems.specified)
