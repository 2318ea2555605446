"""Tests of rest before and after a route, and of braking after a route that ends in motion."""

import math

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.flight.mission import plan_route
from drake_quad.flight.remarks import flight_remarks
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.pieces import pieces_to_plan
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate, hermite_path, peak_norm
from drake_quad.reference.rest import moves_at_end, with_rest
from drake_quad.reference.source import build_reference
from drake_quad.scenario.routes.route import ROUTES as ROUTE_KINDS
from drake_quad.signals import Reference

ROUTES = {
    "figure eight": {"kind": "figure_eight"},
    "figure eight in laps": {"kind": "figure_eight", "laps": 3, "heading": "along_path"},
    "circle": {"kind": "circle", "heading": "along_path"},
    "hover": {"kind": "hover", "yaw": 0.4},
    "Lissajous": {"kind": "lissajous", "amplitude": [1.0, 0.5, 0.2], "phase": [0.3, 1.1, 0.0], "period": 6.0},
    "late start": {"kind": "waypoints", "waypoints": [[0, 0, 1], [1, 0, 1], [1, 1, 2]], "times": [1.5, 4.0, 7.0]},
    "end in motion": {
        "kind": "waypoints",
        "waypoints": [[0, 0, 1], {"point": [3, 1, 2], "velocity": [1.0, 0.3, 0.0], "acceleration": [0.2, 0, -0.1]}],
        "heading": "along_path",
    },
    "turning pieces": {
        "kind": "trajectory",
        "pieces": [{"duration": 3.0, "x": [0, 0, 0.1], "y": [0.0], "z": [1.0], "yaw": [0.1, 0.5]}],
    },
    "setpoints": {"kind": "setpoints", "setpoints": [[0, 0, 0, 1, 0], [2, 1, 0, 1, 0.5]]},
    "knots in steady flight": {
        "kind": "trajectory",
        "knots": [{"time": t, "position": [0.5 * t, 0, 1], "velocity": [0.5, 0, 0]} for t in (1.0, 4.0)],
    },
}


def test_every_kind_of_route_is_tested_here():
    assert {route["kind"] for route in ROUTES.values()} == ROUTE_KINDS.members.keys()


def plan_of(route):
    return plan_route(load_scenario("figure_eight", {"route": route}))


def reference_at(plan, time):
    source = build_reference(plan, ahead=(0.0, 2.0))
    context = source.CreateDefaultContext()
    context.SetTime(time)
    return [source.GetOutputPort(f"reference{part}").Eval(context) for part in ("", "_jerk", "_snap", "_ahead")]


@pytest.mark.parametrize("route", ROUTES.values(), ids=ROUTES)
def test_the_reference_is_at_rest_before_and_after_every_route(route):
    plan = plan_of(route)
    start, end = plan.path.times[[0, -1]]
    end_position = plan.extended_path.waypoints[-1]
    for time in (plan.rest_time + 1e-9, plan.rest_time + 0.7, 100.0):
        reference, jerk, snap, reference_ahead = reference_at(plan, time)
        np.testing.assert_allclose(reference[:3], end_position, atol=1e-9)
        np.testing.assert_array_equal(reference[3:9], 0.0)
        np.testing.assert_array_equal([reference[10], *jerk, *snap], 0.0)
        np.testing.assert_allclose(reference_ahead, [*end_position, *end_position], atol=1e-9)
    if start > 0.0:
        reference, jerk, snap, _ = reference_at(plan, 0.5 * start)
        np.testing.assert_array_equal([*reference[3:9], reference[10], *jerk, *snap], 0.0)
    assert (plan.rest_time > end) == plan.brakes


@pytest.mark.parametrize("route", ROUTES.values(), ids=ROUTES)
def test_the_snap_is_the_lowest_derivative_that_jumps_at_the_end_of_a_route(route):
    plan = plan_of(route)
    for time in {plan.path.times[-1], plan.rest_time}:
        before, after = reference_at(plan, time - 1e-7), reference_at(plan, time + 1e-7)
        np.testing.assert_allclose(before[0], after[0], atol=1e-5)
        np.testing.assert_allclose(before[1], after[1], atol=1e-4)


@pytest.mark.parametrize("name", ["Lissajous", "end in motion", "knots in steady flight"])
def test_braking_stays_within_the_speed_and_acceleration_of_the_route(name):
    plan = plan_of(ROUTES[name])
    assert plan.brakes
    assert peak_norm(plan.extended_path, 1) <= peak_norm(plan.path, 1) * (1.0 + 1e-6)
    assert peak_norm(plan.extended_path, 2) <= max(peak_norm(plan.path, 2), 0.7) * (1.0 + 1e-6)


def test_braking_from_steady_motion_is_the_minimum_snap_motion():
    steady = hermite_path(np.array([0.0, 2.0]), np.array([[[0.0], [1.5]], [[3.0], [1.5]]]))
    path = with_rest(steady, orders=4, acceleration=0.7)
    duration = path.durations[2]
    # The speed is the only quintic from v to 0 whose first two derivatives are zero at both ends.
    s = np.linspace(0.0, 1.0, 20)
    np.testing.assert_allclose(
        evaluate(path, 2.0 + duration * s, 1)[0], 1.5 * (1 - 10 * s**3 + 15 * s**4 - 6 * s**5), atol=1e-9
    )
    assert path.waypoints[-1, 0] == pytest.approx(3.0 + 0.5 * 1.5 * duration)
    assert peak_norm(path, 2) == pytest.approx(1.875 * 1.5 / duration)


def test_there_is_no_braking_after_a_path_that_ends_at_rest():
    assert not plan_of(ROUTES["figure eight"]).brakes
    assert not plan_of(ROUTES["circle"]).brakes  # a yaw acceleration at the end does not require braking
    assert moves_at_end(plan_of(ROUTES["Lissajous"]).path, 4)
    assert not moves_at_end(plan_of(ROUTES["Lissajous"]).yaw, 2)


def test_a_plan_that_ends_in_motion_brakes_identically_after_saving_and_loading():
    plan = plan_of(ROUTES["turning pieces"])
    rows = np.array([[3.0, *plan.path.coefficients[0].T.flatten()]])
    assert rows.shape == (1, 25)
    loaded_plan = pieces_to_plan(
        np.array([[3.0, *[0, 0, 0.1, 0, 0, 0, 0, 0], *[0] * 8, *[1, *[0] * 7], *[0.1, 0.5, *[0] * 6]]])
    )
    np.testing.assert_allclose(loaded_plan.extended_path.coefficients, plan.extended_path.coefficients, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, True])
def test_a_flight_longer_than_its_route_ends_where_the_route_ends(compiled):
    scenario = load_scenario("figure_eight", {"duration": 35.0})
    flight = simulate(scenario, compiled=compiled)
    assert flight.euclidean_error[-1] < 1e-3
    assert flight.remarks == ()


@pytest.mark.slow
def test_a_flight_brakes_and_prints_a_remark_if_it_continues_after_a_route_that_ends_in_motion():
    route = {**ROUTES["Lissajous"], "laps": 1}
    flight = simulate(load_scenario("figure_eight", {"route": route, "duration": 20.0}), compiled=True)
    is_at_rest = flight.time > flight.plan.rest_time
    reference: Reference = flight.record("reference")
    assert np.ptp(reference.x[is_at_rest]) == 0.0
    assert flight.euclidean_error[-1] < 1e-3
    (remark,) = flight.remarks
    assert "ends in motion" in remark
    assert f"{flight.plan.rest_time:.2f} s" in remark
    end = flight.plan.path.times[-1:]
    speed = np.linalg.norm(evaluate(flight.plan.path, end, 1))
    assert f"ends in motion ({speed:.2f} m/s) at {end.item():.2f} s," in remark
    braking_distance = np.linalg.norm(evaluate(flight.plan.extended_path, [99.0]) - evaluate(flight.plan.path, end))
    assert remark.endswith(f", {braking_distance:.2f} m beyond the end of the route")
    assert flight_remarks(load_scenario("figure_eight", {"route": route})) == ()


def test_the_remark_on_braking_states_a_yaw_rate():
    yaw_knots = [{"time": 0, "yaw": 0}, {"time": 4, "yaw": 3.0, "yaw_rate": 2.0}]
    knots = [{"time": 0, "position": [0, 0, 1]}, {"time": 4, "position": [2, 0, 1]}]
    route = {"kind": "trajectory", "knots": knots, "yaw_knots": yaw_knots}
    (remark,) = flight_remarks(load_scenario("figure_eight", {"route": route, "duration": 15.0}))
    assert "ends in motion (0.00 m/s, 2.00 rad/s of yaw)" in remark


def test_braking_that_the_rotors_cannot_fly_is_rejected():
    """Rotors with a thrust of at most 1.05 times the weight can fly an accelerating descent, but cannot stop it."""
    knots = [
        {
            "time": 4.0 * i,
            "position": [0, 0, 90 - 2.0 * (4.0 * i) ** 2 / 2],
            "velocity": [0, 0, -8.0 * i],
            "acceleration": [0, 0, -2],
        }
        for i in range(3)
    ]
    overrides = {"route": {"kind": "trajectory", "knots": knots}, "nominal.max_rotor_speed": 206.0}
    scenario = load_scenario("figure_eight", overrides)
    plan = plan_route(scenario)
    assert flight_duration(scenario, plan) == pytest.approx(8.0)
    with pytest.raises(InputError, match="ends in motion at 8.00 s, and the vehicle cannot brake after it"):
        flight_duration(load_scenario("figure_eight", {**overrides, "duration": 10.0}), plan)


def test_braking_into_an_obstacle_is_rejected():
    knots = [
        {"time": 0.0, "position": [0, 0, 1]},
        {"time": 4.0, "position": [3, 0, 1], "velocity": [1.2, 0, 0]},
    ]
    wall = {"kind": "box", "centre": [3.7, 0, 1.5], "size": [0.2, 4, 3]}
    overrides = {"route": {"kind": "trajectory", "knots": knots}, "space": {"obstacles": {"wall": wall}}}
    scenario = load_scenario("figure_eight", overrides)
    assert flight_duration(scenario, plan_route(scenario)) == pytest.approx(4.0)
    longer = load_scenario("figure_eight", {**overrides, "duration": 10.0})
    with pytest.raises(InputError, match=r"the vehicle cannot brake after it \(the route is .* from wall"):
        flight_duration(longer, plan_route(longer))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["space.bounds", "route.space"])
@pytest.mark.parametrize("beyond", [0.21, 1.21])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_braking_that_leaves_the_bounds_is_rejected(name, beyond, side):
    """The route ends at x = 2 m or -2 m, and braking from 1 m/s needs another 1.41 m."""
    near, far = sorted((side * -1.0, side * (3.41 - beyond)))
    room = {"min": [near, -1.0, 0.0], "max": [far, 1.0, 2.0]}
    last = {"point": [2.0 * side, 0, 1], "velocity": [side, 0, 0]}
    obstacles = {"wall": {"kind": "box", "centre": [9, 0, 1], "size": [0.1, 2, 2]}}
    route = {"kind": "waypoints", "waypoints": [[0, 0, 1], last]}
    overrides = {"duration": 15.0, "route": route, "space": {"obstacles": obstacles}}
    part, field = name.split(".")
    overrides[part] = {**overrides[part], field: room}
    scenario = load_scenario("figure_eight", overrides)
    words = f"ends in motion at .* cannot brake after it \\(the braking path leaves {name} by {beyond:.2f} m\\)"
    with pytest.raises(InputError, match=words):
        flight_duration(scenario, plan_route(scenario))


def test_braking_below_the_crash_height_is_rejected():
    """The route ends at a height of 0.2 m while the vehicle descends at 0.9 m/s."""
    pieces = [{"duration": 2.0, "x": [0], "y": [0], "z": [2, -0.9], "yaw": [0]}]
    overrides = {"duration": 15.0, "route": {"kind": "trajectory", "pieces": pieces}, "crash": {"height": 0.0}}
    scenario = load_scenario("figure_eight", overrides)
    plan = plan_route(scenario)
    lowest = plan.extended_path.waypoints[-1, 2]
    with pytest.raises(InputError, match=f"the braking path descends to {lowest:.2f} m, below crash.height, 0 m"):
        flight_duration(scenario, plan)


def test_metrics_of_laps_exclude_the_rest_after_the_last_lap():
    laps = {"route.laps": 2, "metrics.first_lap": 2}
    flown = simulate(load_scenario("figure_eight", laps), compiled=True).metrics
    longer = simulate(load_scenario("figure_eight", {**laps, "duration": 80.0}), compiled=True).metrics
    assert longer.rmse == flown.rmse
    assert math.isfinite(flown.rmse)


def test_a_hover_is_always_at_rest():
    plan = Plan.hover([1.0, 2.0, 3.0], duration=5.0)
    for time in (0.0, 2.0, 5.0, 9.0):
        reference, jerk, snap, _ = reference_at(plan, time)
        np.testing.assert_array_equal(reference[:3], [1.0, 2.0, 3.0])
        np.testing.assert_array_equal([*reference[3:9], *jerk, *snap], 0.0)
