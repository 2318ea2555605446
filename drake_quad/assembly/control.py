"""The control of a scenario."""

from pydrake.systems.framework import Diagram

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.framework.recipe import Recipe
from drake_quad.planning.believed import nominal_parameters
from drake_quad.planning.space import space_of
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.quantities import can_differ_from_zero
from drake_quad.scenario.setting import ControlSetting


def control_setting(scenario: Scenario, plan: Plan) -> ControlSetting:
    """Return the properties of a scenario that its control depends on, given the plan that is flown."""
    laboratory = scenario.laboratory
    return ControlSetting(
        believed=nominal_parameters(scenario),
        plan=plan,
        tick=laboratory.command_link.period,
        frame=laboratory.motion_capture.period,
        loses_frames=can_differ_from_zero(laboratory.motion_capture.dropout_rate),
        autopilot=laboratory.autopilot,
        space=space_of(scenario),
    )


def control_recipes(batch: Batch, plan: Plan, own: UserSystems = UserSystems()) -> dict[str, Recipe]:
    """Return the recipes for the systems of a control, by their paths in its diagram.

    Args:
        batch: batch that is flown.
        plan: plan that is flown.
        own: systems of the user's. There are no recipes for systems whose places they take.
    """
    if own.control is not None:
        return {}
    places = batch.scenario.control.places
    taken = tuple([start for name in own.given for start in places.get(name, ())])
    recipes: dict[str, Recipe] = batch.fleet_scenario.control.recipes(control_setting(batch.scenario, plan))
    return {path: recipe for path, recipe in recipes.items() if not path.startswith(taken)}


def build_control(
    scenario: Scenario, recipes: dict[str, Recipe], num_vehicles: int, own: UserSystems = UserSystems()
) -> Diagram:
    """Build the control of a scenario.

    Args:
        scenario: scenario with the control.
        recipes: recipes for its systems, from `control_recipes`.
        num_vehicles: N.
        own: systems of the user's.

    Raises:
        InputError: if there is a position controller of the user's, but no cascade.
    """
    control = scenario.control
    if own.position_controller is not None and "position_controller" not in control.places:
        raise InputError(
            f"control of {scenario.name} is of kind {control.kind}: it has no place for a position_controller"
        )
    return control.build({path: recipe.build(num_vehicles) for path, recipe in recipes.items()}, own.given)
