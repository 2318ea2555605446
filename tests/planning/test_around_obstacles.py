"""Tests of plans around obstacles."""

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.errors import InputError
from drake_quad.flight.hover_error import nominal_tracking_error
from drake_quad.flight.mission import plan_route, plan_route_with_problem
from drake_quad.reference.polynomial_path import evaluate, peak_norm
from drake_quad.scenario.models import Mission
from drake_quad.space.distance import nearest_approach

# All tests of this file are slow, since planning around obstacles takes seconds.
pytestmark = pytest.mark.slow

ROOM_SCENARIO = """
pillars:
  extends: figure_eight
  route: {kind: waypoints, waypoints: [[0, 0, 1], [3, 3, 1.2], [6, 0, 1]], top_speed: 2.0, top_acceleration: 2.0}
  space:
    bounds: {min: [-1, -2, 0.3], max: [7, 5, 2.2]}
    margin: 0.1
    obstacles:
      pillar: {kind: cylinder, centre: [1.5, 1.5, 1.25], radius: 0.25, height: 2.5}
      wall: {kind: box, centre: [4.5, 1.5, 1.25], size: [0.2, 3.0, 2.5], rotation: [0, 0, 0.3]}
      ball: {kind: sphere, centre: [2.5, 2.6, 1.2], radius: 0.2}
"""


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    path = tmp_path_factory.mktemp("rooms") / "pillars.yaml"
    path.write_text(ROOM_SCENARIO, encoding="utf-8")
    return lambda *overrides: load_scenario(path, list(overrides))


def smallest_clearance(scenario, plan):
    """Return the smallest distance between the centre of mass and an obstacle over dense samples of a plan, m."""
    space = scenario.flight_space()
    return space.nearest(evaluate(plan.path, np.linspace(0.0, plan.duration, 10_000)).T)[0].min()


# The other timings are tested in `tests/space/test_rooms.py`.
TIMING_OVERRIDES = {
    "heuristic": "route.times=heuristic",
    "given": "route.times=[0, 5, 12]",
}


@pytest.mark.long
@pytest.mark.parametrize("timing", TIMING_OVERRIDES.values(), ids=TIMING_OVERRIDES)
def test_plans_with_every_timing_keep_clearance_and_speed_and_acceleration_limits(room, timing):
    scenario = room(timing)
    plan, problem, waypoints, _ = plan_route_with_problem(scenario)
    assert scenario.flight_space().clearance == pytest.approx(0.27)
    assert smallest_clearance(scenario, plan) >= 0.27
    passed_waypoints = plan.waypoints[waypoints]
    np.testing.assert_allclose(passed_waypoints, [[0, 0, 1], [3, 3, 1.2], [6, 0, 1]], atol=1e-9)
    assert len(problem.waypoints) == len(plan.path.times) > 3
    if "[0, 5, 12]" in timing:
        np.testing.assert_allclose(plan.path.times[waypoints], [0, 5, 12])
    else:
        assert peak_norm(plan.path, 1) <= 2.0 + 1e-9
        assert peak_norm(plan.path, 2) <= 2.0 + 1e-9


@pytest.mark.long
def test_the_yaw_equals_the_given_yaw_at_each_waypoint(room):
    waypoints = (
        "route.waypoints=[{point: [0, 0, 1], yaw: 0}, {point: [3, 3, 1.2], yaw: 1.0}, {point: [6, 0, 1], yaw: 2}]"
    )
    plan, _, numbers, _ = plan_route_with_problem(room("route.heading=waypoints", waypoints, "route.times=heuristic"))
    yaws = evaluate(plan.yaw, plan.path.times[numbers])[0]
    np.testing.assert_allclose(yaws, [0.0, 1.0, 2.0], atol=1e-9)


@pytest.mark.long
def test_a_plan_around_obstacles_passes_gates_and_stays_in_corridors(room):
    waypoints = (
        "route.waypoints=[[0, 0, 1], {box: {min: [3, 2.6, 0.8], max: [3, 3.4, 1.6]}},"
        " {sphere: {centre: [5.5, 3.5, 1.2], radius: 0.3}}, [6, 0, 1], [0, 0, 1]]"
    )
    corridors = "route.corridors=[null, null, null, {min: [-1, -2, 0.3], max: [7, 0.5, 2.0]}]"
    scenario = room(waypoints, corridors, "route.times=heuristic")
    plan, _, numbers, _ = plan_route_with_problem(scenario)
    assert smallest_clearance(scenario, plan) >= 0.27
    gate_position, ball_position = plan.waypoints[numbers[1]], plan.waypoints[numbers[2]]
    np.testing.assert_array_compare(np.less_equal, [3.0 - 1e-9, 2.6, 0.8], gate_position)
    np.testing.assert_array_compare(np.less_equal, gate_position, [3.0 + 1e-9, 3.4, 1.6])
    assert np.linalg.norm(ball_position - [5.5, 3.5, 1.2]) <= 0.3 + 1e-6
    last_segment = evaluate(plan.path, np.linspace(plan.path.times[numbers[3]], plan.duration, 3000))
    assert last_segment[1].max() <= 0.5 + 1e-6


@pytest.mark.long
def test_the_path_passes_a_gate_where_no_obstacle_covers_it(room):
    gate = "route.waypoints=[[0, 0, 1], {box: {min: [3, 2.0, 0.8], max: [3, 3.4, 1.6]}}, [6, 0, 1]]"
    scenario = room(gate, "space.obstacles.ball.centre=[3, 2.7, 1.2]", "route.times=heuristic")
    plan, _, numbers, _ = plan_route_with_problem(scenario)
    assert smallest_clearance(scenario, plan) >= 0.27
    assert 2.0 - 1e-9 <= plan.waypoints[numbers[1]][1] <= 3.4 + 1e-9


def test_an_obstacle_far_from_the_path_does_not_change_the_plan(room):
    remote_obstacles = [f"space.obstacles.{name}.centre=[1, 9, 1]" for name in ("pillar", "wall", "ball")]
    plan_with_obstacles = plan_route(room("route.times=heuristic", "space.bounds=null", *remote_obstacles))
    plan_without_space = plan_route(room("route.times=heuristic").model_copy(update={"space": None}))
    np.testing.assert_array_equal(plan_without_space.path.coefficients, plan_with_obstacles.path.coefficients)


# A smaller room makes the search faster.
SMALL_ROOM_OVERRIDE = "space.bounds={min: [-0.5, -0.5, 0.5], max: [6.5, 3.6, 2.0]}"
IMPOSSIBLE_PLANS = {
    "a waypoint too near to an obstacle": (
        ["space.obstacles.ball.centre=[3, 3, 1.5]"],
        r"waypoint 1, \(3, 3, 1.2\) m, is 0.1 m from ball, but the clearance is 0.27 m \(radius 0.17 \+ margin 0.1\)",
    ),
    "a waypoint out of bounds": (["space.bounds.max=[5, 5, 2]"], r"waypoint 2, \(6, 0, 1\) m, lies outside the bounds"),
    "no bounds of the space": (
        ["space.bounds=null"],
        r"m from .* nearer than the clearance of 0.27 m; give space.bounds",
    ),
    "a wall across the room": (
        [SMALL_ROOM_OVERRIDE, "space.obstacles.wall.size=[0.2, 9, 2.6]", "space.obstacles.wall.rotation=[0, 0, 0]"],
        r"no route from waypoint 1 to waypoint 2 with a clearance of 0.27 m .* without wall, there would be a route",
    ),
    "a corridor that the wall closes": (
        [
            SMALL_ROOM_OVERRIDE,
            "route.corridors=[null, {min: [2.5, -0.5, 0.5], max: [6.5, 3.5, 2.0]}]",
            "space.obstacles.wall.size.1=4.5",
        ],
        r"no route from waypoint 1 to waypoint 2 in the corridor of segment 1 with .*"
        " without wall, there would be a route",
    ),
    "a gate inside an obstacle": (
        ["route.waypoints=[[0, 0, 1], {box: {min: [2.45, 2.55, 1.15], max: [2.55, 2.65, 1.25]}}, [6, 0, 1]]"],
        "waypoint 1, .* contains no point with a clearance of 0.27 m .*: ball is too near",
    ),
    "a route of another kind through obstacles": (
        ["route={kind: circle, radius: 2.1, height: 1.2}"],
        r"the route is 0 m from (pillar|ball) at .*, but the radius of the vehicle is 0.17 m",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize(("overrides", "message"), IMPOSSIBLE_PLANS.values(), ids=IMPOSSIBLE_PLANS)
def test_the_error_for_an_impossible_plan_gives_the_reason(room, overrides, message):
    with pytest.raises(InputError, match=message):
        plan_route(room("route.times=heuristic", *overrides))


@pytest.mark.long
def test_a_plan_around_obstacles_is_cached(room):
    assert plan_route_with_problem(room("route.times=heuristic")) is plan_route_with_problem(
        room("route.times=heuristic")
    )


@pytest.mark.long
def test_a_smaller_margin_makes_the_flight_faster(room):
    # The margin is 0.1 m because other tests use the same plan, which is cached.
    plan_with_margin, plan_without_margin = (
        plan_route(room(f"space.margin={margin}", "route.times=heuristic")) for margin in (0.1, 0.0)
    )
    approach = nearest_approach(plan_without_margin.path, room("space.margin=0").flight_space())
    assert plan_without_margin.duration < plan_with_margin.duration
    assert approach.distance >= 0.17


@pytest.mark.long
def test_the_clearance_includes_a_fraction_of_the_predicted_tracking_error(room):
    """Wind and control determine the predicted error, and therefore also the plan."""
    wind = "laboratory.wind=[{kind: dryden, level: light, intensity: 0.05, height: 3.048}]"
    dragged = ["vehicle.linear_drag=0.1", "route.times=heuristic"]
    calm, windy = (
        plan_route_with_problem(room("space.tracking_error_factor=0.5", *dragged, *each)) for each in ((), (wind,))
    )
    predicted_error = nominal_tracking_error(room(wind, *dragged)).rms.value
    # `tracking_error_factor` affects the plan, but not the clearance at which the flight detects a collision.
    assert room("space.tracking_error_factor=0.5").flight_space().clearance == pytest.approx(0.27)
    assert windy.space.tracking == pytest.approx(0.5 * predicted_error)
    assert windy.space.clearance > calm.space.clearance + 0.01
    distances = windy.space.nearest(evaluate(windy.plan.path, np.linspace(0.0, windy.plan.duration, 10_000)).T)[0]
    assert distances.min() >= windy.space.clearance


@pytest.mark.long
def test_the_planner_finds_a_path_through_the_shipped_forest():
    """Drake's search for a convex region around a point fails in this forest."""
    scenario = load_scenario("forest", ["route.times=heuristic"])
    planned_mission = plan_route_with_problem(scenario)
    assert smallest_clearance(scenario, planned_mission.plan) >= planned_mission.space.clearance


def test_a_clearance_for_the_tracking_error_requires_a_control_and_a_stationary_wind(room):
    scenario = room("space.tracking_error_factor=3")
    mission = Mission(**{name: getattr(scenario, name) for name in Mission.model_fields})
    with pytest.raises(InputError, match="space.tracking_error_factor multiplies a predicted tracking error"):
        plan_route(mission)
    gust = "laboratory.wind=[{kind: gust, speed: 1.0, heading: 0.0, start: 1.0, rise_time: 0.5}]"
    with pytest.raises(InputError, match=r"space\.tracking_error_factor: laboratory\.wind\.0 is a gust"):
        plan_route(room("space.tracking_error_factor=3", gust))
