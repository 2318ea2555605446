"""Planning of the route of a scenario in a space with obstacles."""

from drake_quad.errors import InputError
from drake_quad.planning.feasibility import check_obstacles, check_rotors
from drake_quad.reference.feasibility import sample_times
from drake_quad.scenario.limits import MAX_DURATION
from drake_quad.scenario.models import Mission
from drake_quad.scenario.paths import distributions_in
from drake_quad.scenario.routes.route import PlannedRoute
from drake_quad.space.space import Space


def plan_route_in_space(mission: Mission, space: Space | None) -> PlannedRoute:
    """Return the plan of a scenario's route around the obstacles of a space, for the nominal vehicle.

    To plan in the space of the scenario itself, use `drake_quad.flight.mission.plan_route`.

    Raises:
        InputError: if the route contains a distribution, no path satisfies the constraints of the route, the rotors
            cannot fly the path, or no path avoids the obstacles.
    """
    for field in distributions_in(mission):
        if field.startswith("route."):
            raise InputError(f"{field} is a distribution, but must be a number, since all vehicles fly the same plan")
    planned = mission.route.plan(space)
    plan = planned.plan
    if not plan.duration <= MAX_DURATION:
        raise InputError(
            f"the route would take {plan.duration:g} s within its limits, but a flight takes at most {MAX_DURATION:g} s"
        )
    check_rotors(plan, mission, sample_times(plan.path))
    if space is not None and planned.waypoints is None:
        check_obstacles(plan.path, space)
    return planned
