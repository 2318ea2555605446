"""Tests that attributes and methods of every kind of route, including a user's kind, agree with the plan."""

from functools import reduce
from typing import Literal

import numpy as np
import pytest

from drake_quad import InputError, load_mission, plan_route
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.models import Mission
from drake_quad.scenario.quantities import Positive
from drake_quad.scenario.routes.route import ROUTES, MissionRoute, MovingRoute, PlannedRoute
from drake_quad.scenario.routes.waypoint_times import WaypointTimes
from drake_quad.scenario.schema import file_schema

ROUTE_FIELDS = {
    "lissajous": [{"amplitude": (1.0, 0.5, 0.2), "period": 8.0}],
    "waypoints": [
        {"waypoints": [(0.0, 0.0, 1.0), (1.0, 0.5, 1.0), (0.0, 1.0, 1.5)], "times": times}
        for times in ([1.0, 5.0, 9.0], "heuristic", "minimum_time", {"kind": "minimum_snap", "duration": 8.0})
    ],
    "trajectory": [
        {"knots": [{"time": 0.0, "position": (0.0, 0.0, 1.0)}, {"time": 3.0, "position": (1.0, 0.0, 1.0)}]},
        {"pieces": [{"duration": 3.0, "x": (0.0, 0.1), "y": (0.0,), "z": (1.0,)}], "time_scale": 2.0},
    ],
    "setpoints": [{"setpoints": [(0.0, 0.0, 0.0, 1.0, 0.0), (2.0, 1.0, 0.0, 1.0, 0.5)], "last_hold": 2.0}],
}


class LineRoute(MovingRoute):
    """Straight line to a point on the x axis, from rest to rest."""

    kind: Literal["line"]
    length: Positive = 2.0

    def plan(self, space):
        """Return the plan with the shortest duration within the speed limit."""
        ends = np.array([[0.0, 0.0, 1.0], [self.length, 0.0, 1.0]])
        path = minimum_snap(ends, np.array([0.0, 35.0 / 16.0 * self.length / self.top_speed]))
        return PlannedRoute(Plan(path, self.yaw_profile(path)))


def check_member(kind, fields):
    mission = Mission.model_validate({"route": {"kind": kind, **fields}})
    route = mission.route
    plan = route.plan(None).plan
    assert plan.waypoints[0] == pytest.approx(evaluate(plan.path, [plan.path.times[0]])[:, 0])
    path, end = route.known_end_time()
    assert end is None or end == pytest.approx(plan.path.times[-1], rel=1e-12)
    steps = [int(step) if isinstance(step, int) else step for step in path]
    assert reduce(lambda part, step: part[step] if isinstance(step, int) else getattr(part, step), steps, mission)
    times = np.linspace(plan.path.times[0], plan.path.times[-1], 500)
    for order, limit in route.limits().by_order.items():
        assert np.linalg.norm(evaluate(plan.path, times, order), axis=0).max() <= limit * (1.0 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "fields"), [(kind, fields) for kind in ROUTES.members for fields in ROUTE_FIELDS.get(kind, [{}])]
)
def test_declarations_of_every_kind_of_route_agree_with_its_plan(kind, fields):
    """The plan ends at the known end of the route and satisfies its limits."""
    check_member(kind, fields)


@pytest.mark.slow
def test_a_user_s_kind_of_route_is_checked_and_planned_and_is_part_of_the_language():
    with pytest.raises(InputError, match="route.kind is 'line', but must be one of"):
        load_mission("hover", {"route": {"kind": "line"}})
    ROUTES.register(LineRoute)
    check_member("line", {"top_acceleration": 10.0})
    plan = plan_route(load_mission("hover", {"route": {"kind": "line", "length": 3.0, "heading": "along_path"}}))
    assert plan.path.waypoints[-1].tolist() == pytest.approx([3.0, 0.0, 1.0])
    assert "LineRoute" in file_schema()["$defs"]
    blocked = {"obstacles": {"ball": {"kind": "sphere", "centre": [1.5, 0.0, 1.0], "radius": 0.2}}}
    with pytest.raises(InputError, match="the route is 0 m from ball"):
        plan_route(load_mission("hover", {"route": {"kind": "line", "length": 3.0}, "space": blocked}))


def test_a_kind_of_route_without_a_plan_method_is_refused():
    class RouteWithoutPlan(MissionRoute):
        kind: Literal["without_plan"]

    with pytest.raises(TypeError, match="RouteWithoutPlan must define plan"):
        ROUTES.register(RouteWithoutPlan)
    assert WaypointTimes.__abstractmethods__ == {"timing"}
