"""Tests of the built-in routes, by comparison with the figures of the paper."""

import numpy as np
import pytest

from drake_quad.flight.mission import plan_route
from drake_quad.reference.polynomial_path import evaluate, peak_norm
from drake_quad.reference.routes import circle, figure_eight
from drake_quad.scenario.files.loading import load_scenario


def test_the_figure_eight_agrees_with_the_paper(diagrams):
    """The extent is taken from the paper's figures.

    With limits of 2 m/s and 0.7 m/s², a path of this extent is 20 to 31 m long and takes 21 to 26 s.
    """
    plan = plan_route(load_scenario(diagrams / "figure_eight.yaml"))
    times = np.linspace(0.0, plan.duration, 5000)
    position = evaluate(plan.path, times)
    np.testing.assert_allclose(position.min(axis=1), [-1.5, -3.3, 0.0], atol=0.12)
    np.testing.assert_allclose(position.max(axis=1), [1.3, 3.3, 2.0], atol=0.12)
    assert peak_norm(plan.path, 1) <= 2.0
    assert peak_norm(plan.path, 2) == pytest.approx(0.7, rel=1e-12)
    assert 21.0 <= plan.duration <= 26.0
    assert 20.0 <= np.linalg.norm(np.diff(position, axis=1), axis=0).sum() <= 31.0
    assert [leg.name for leg in plan.legs] == [
        "rise",
        "climb",
        "circle",
        "straight",
        "descent",
        "turn",
        "curve",
        "return",
    ]


def test_the_circles_of_the_figure_eight_are_flown_in_opposite_directions(diagrams):
    plan = plan_route(load_scenario(diagrams / "figure_eight.yaml"))
    starts = [plan.path.times[leg.first] for leg in plan.legs]
    for leg, direction in ((2, 1.0), (5, -1.0), (6, -1.0)):
        times = np.linspace(starts[leg], starts[leg + 1], 50)
        (v_x, v_y, _), (a_x, a_y, _) = evaluate(plan.path, times, 1), evaluate(plan.path, times, 2)
        turn_direction = v_x * a_y - v_y * a_x
        assert np.mean(np.sign(turn_direction)) == direction


def test_the_straight_parts_of_the_figure_eight_are_tangents_to_its_circles():
    route = figure_eight(radius=1.0, offset=2.0, lower_height=1.0, upper_height=3.0)
    upper = route.waypoints[2:9]
    np.testing.assert_allclose(np.hypot(upper[:, 0], upper[:, 1] - 2.0), 1.0)
    radius = upper[0, :2] - [0.0, 2.0]
    assert radius @ upper[0, :2] == pytest.approx(0.0, abs=1e-12)


def test_a_minimum_snap_circle_is_round(diagrams):
    scenario = load_scenario(diagrams / "figure_eight.yaml", ["route={kind: circle, radius: 2.0, laps: 3}"])
    plan = plan_route(scenario)
    middle = np.linspace(0.3 * plan.duration, 0.7 * plan.duration, 500)
    x, y, z = evaluate(plan.path, middle)
    np.testing.assert_allclose(np.hypot(x, y), 2.0, rtol=5e-3)
    np.testing.assert_allclose(z, 1.0, atol=1e-9)


def test_a_circle_is_flown_anticlockwise_from_the_x_axis_in_steps_of_45_degrees():
    route = circle(radius=2.0, height=1.5, laps=3)
    angle = np.radians(45.0 * np.arange(25))
    expected = np.column_stack([2.0 * np.cos(angle), 2.0 * np.sin(angle), np.full(25, 1.5)])
    np.testing.assert_allclose(route.waypoints, expected, atol=1e-12)
    assert route.legs == (("lap 1", 0), ("lap 2", 8), ("lap 3", 16))


def test_by_default_the_figure_eight_has_the_extent_in_the_paper():
    waypoints = figure_eight().waypoints
    np.testing.assert_allclose(waypoints[1], [0.0, 0.0, 1.0])
    upper, lower = waypoints[2:9], waypoints[10:17]
    np.testing.assert_allclose(np.hypot(upper[:, 0], upper[:, 1] - 1.9), 1.4)
    np.testing.assert_allclose(np.hypot(lower[:, 0], lower[:, 1] + 1.9), 1.4)
    np.testing.assert_allclose([upper[:, 2], lower[:, 2]], [[2.0] * 7, [1.0] * 7])


def test_each_leg_of_the_figure_eight_begins_at_the_place_in_its_name():
    route = figure_eight(radius=1.0, offset=2.0, lower_height=1.0, upper_height=3.0)
    start_points = {leg.name: route.waypoints[leg.first] for leg in route.legs}
    x, y = np.sqrt(0.75), 1.5  # point at which a tangent from the start touches a circle
    expected = {
        "rise": [0.0, 0.0, 0.0], "climb": [0.0, 0.0, 1.0],
        "circle": [x, y, 3.0], "straight": [-x, y, 3.0],
        "descent": [0.0, 0.0, 3.0], "turn": [x, -y, 1.0],
        "curve": [0.0, -3.0, 1.0], "return": [-x, -y, 1.0],
    }  # fmt: skip
    assert list(start_points) == list(expected)
    np.testing.assert_allclose(list(start_points.values()), list(expected.values()), atol=1e-12)
    np.testing.assert_array_equal(route.waypoints[-1], [0.0, 0.0, 1.0])


def test_the_circles_of_the_figure_eight_have_equal_steps_and_mirror_each_other():
    waypoints = figure_eight(radius=1.0, offset=2.0, lower_height=1.0, upper_height=3.0).waypoints
    upper, lower = waypoints[2:9], waypoints[10:17]
    angle = np.degrees(np.unwrap(np.arctan2(upper[:, 1] - 2.0, upper[:, 0])))
    np.testing.assert_allclose(angle, -30.0 + 40.0 * np.arange(7))
    np.testing.assert_allclose(lower[:, :2], upper[:, :2] * [1.0, -1.0])
