"""From a scenario's route to a plan that its vehicle can fly."""

from drake_quad.errors import InputError
from drake_quad.planning.feasibility import check_obstacles, check_rotors
from drake_quad.reference.feasibility import sample_times
from drake_quad.scenario.limits import LONGEST
from drake_quad.scenario.models import Mission
from drake_quad.scenario.paths import distributions_in
from drake_quad.scenario.routes.route import Planned
from drake_quad.space.space import Space


def plan_in(mission: Mission, space: Space | None) -> Planned:
    """Return the plan for the route of a scenario around the obstacles of a space, for the nominal vehicle.

    `drake_quad.flight.mission.plan_route` plans in the space of the scenario.

    Raises:
        InputError: if the route contains a distribution, no path or no rotors can satisfy the constraints of the
            route, or the obstacles leave no way.
    """
    for field in distributions_in(mission):
        if field.startswith("route."):
            raise InputError(
                f"{field} is a distribution, but all vehicles fly the same plan, which needs a number there"
            )
    planned = mission.route.plan(space)
    plan = planned.plan
    if not plan.duration <= LONGEST:
        raise InputError(f"within its limits the route would take {plan.duration:g} s, more than {LONGEST:g} s")
    check_rotors(plan, mission, sample_times(plan.path))
    if space is not None and planned.waypoints is None:
        check_obstacles(plan.path, space)
    return planned
