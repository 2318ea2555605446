"""Tests of paths with several laps: the motion between laps, times and stops."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.flight.mission import plan_route
from drake_quad.reference.laps import LapDurations, path_of_laps, periodic_boundary_derivatives
from drake_quad.reference.minimum_snap import MinimumSnap, rest_at_ends, snap_cost
from drake_quad.reference.polynomial_path import evaluate, peak_norm
from drake_quad.reference.time_allocation import trapezoid_times

LAP_WAYPOINTS = np.array([[0.0, 0.0, 1.0], [1.0, 0.2, 1.2], [1.1, 1.5, 1.0], [-0.3, 0.9, 0.8], [0.0, 0.0, 1.0]])
SEGMENT_DURATIONS = np.array([1.1, 1.6, 2.0, 1.3])  # s
FREE_DERIVATIVES = np.full((5, 3, 3), np.nan)  # NaN for each derivative that the planner may choose


def closed_path(boundary_derivatives, derivatives=FREE_DERIVATIVES):
    all_derivatives = derivatives.copy()
    all_derivatives[[0, -1]] = boundary_derivatives
    return MinimumSnap(LAP_WAYPOINTS, SEGMENT_DURATIONS, all_derivatives).path()


def test_motion_between_two_laps_agrees_with_the_middle_of_a_long_path():
    """The test plans 24 laps from rest to rest. The effect of the ends vanishes after a dozen laps."""
    points, durations = np.vstack([LAP_WAYPOINTS, *[LAP_WAYPOINTS[1:]] * 23]), np.tile(SEGMENT_DURATIONS, 24)
    path = MinimumSnap(points, durations, rest_at_ends(len(points), 3)).path()
    middle_time = [12 * SEGMENT_DURATIONS.sum()]
    expected = np.array([evaluate(path, middle_time, order)[:, 0] for order in (1, 2, 3)])
    np.testing.assert_allclose(
        periodic_boundary_derivatives(LAP_WAYPOINTS, SEGMENT_DURATIONS, FREE_DERIVATIVES), expected, atol=1e-6
    )


def test_no_other_motion_between_two_laps_has_less_snap():
    boundary_derivatives = periodic_boundary_derivatives(LAP_WAYPOINTS, SEGMENT_DURATIONS, FREE_DERIVATIVES)
    min_cost = snap_cost(closed_path(boundary_derivatives))
    for change in 1e-2 * np.eye(3):
        for side in (1.0, -1.0):
            assert (snap_cost(closed_path(boundary_derivatives + side * change[:, np.newaxis])) > min_cost).all()


def test_derivatives_given_between_two_laps_are_kept():
    stop = FREE_DERIVATIVES.copy()
    stop[[0, -1]] = 0.0
    np.testing.assert_array_equal(periodic_boundary_derivatives(LAP_WAYPOINTS, SEGMENT_DURATIONS, stop), 0.0)
    given_velocity = FREE_DERIVATIVES.copy()
    given_velocity[-1, 0] = 0.25
    boundary_derivatives = periodic_boundary_derivatives(LAP_WAYPOINTS, SEGMENT_DURATIONS, given_velocity)
    np.testing.assert_array_equal(boundary_derivatives[0], 0.25)
    path = closed_path(boundary_derivatives)
    for order in (4, 5):
        np.testing.assert_allclose(
            evaluate(path, [0.0], order), evaluate(path, [SEGMENT_DURATIONS.sum() - 1e-9], order), atol=1e-4
        )


@pytest.mark.parametrize("laps", [2, 5])
def test_the_first_lap_starts_and_the_last_ends_at_rest_and_middle_laps_are_equal(laps):
    first_waypoint = np.array([[0.2, -0.1, 0.0]])
    durations = LapDurations(np.array([1.5, 1.8, 1.6, 2.0, 1.3]), SEGMENT_DURATIONS, 1.2 * SEGMENT_DURATIONS[::-1])
    path, lap_starts = path_of_laps(np.vstack([first_waypoint, LAP_WAYPOINTS]), durations, laps, lead=1)
    assert lap_starts[0] == 1.5
    assert len(lap_starts) == laps + 1
    np.testing.assert_allclose(np.diff(lap_starts), [6.7] + [6.0] * (laps - 2) + [7.2])
    inside = path.times[1:-1]
    for order in range(4):
        before, after = (evaluate(path, inside + side * 1e-9, order) for side in (-1.0, 1.0))
        np.testing.assert_allclose(before, after, atol=1e-5)
        if order:
            np.testing.assert_allclose(evaluate(path, path.times[[0, -1]], order), 0.0, atol=1e-9)
        elapsed = np.linspace(0.0, 6.0, 50)
        for start in lap_starts[2:-2]:
            np.testing.assert_allclose(
                evaluate(path, start + elapsed, order), evaluate(path, lap_starts[1] + elapsed, order), atol=1e-9
            )
    assert np.linalg.norm(evaluate(path, [lap_starts[1]], 1)) > 0.2
    np.testing.assert_allclose(
        evaluate(path, lap_starts, 0), np.repeat(LAP_WAYPOINTS[:1], laps + 1, axis=0).T, atol=1e-12
    )


LAP_WAYPOINTS_YAML = "waypoints: [[0, 0, 1], [1, 0, 1.2], [1, 1.5, 1], [0, 0, 1]]"


def route(diagrams, text, *overrides):
    return load_scenario(diagrams / "figure_eight.yaml", [f"route={{{text}}}", *overrides])


@pytest.mark.parametrize(
    "text",
    [
        "kind: figure_eight, laps: 4",
        f"kind: waypoints, laps: 4, {LAP_WAYPOINTS_YAML}",
        f"kind: waypoints, laps: 4, times: heuristic, heading: along_path, {LAP_WAYPOINTS_YAML}",
        f"kind: waypoints, laps: 4, times: [1, 5, 8, 13], {LAP_WAYPOINTS_YAML}",
    ],
)
def test_laps_of_closed_routes_satisfy_the_limits(diagrams, text):
    plan = plan_route(route(diagrams, text))
    first, *between, last = np.diff(plan.lap_times)
    assert between == pytest.approx([between[0]] * 2)
    assert plan.lap_times[0] == plan.path.times[plan.legs[-4 if "waypoints" in text else 1].first]
    speed, acceleration = peak_norm(plan.path, 1), peak_norm(plan.path, 2)
    assert speed <= 2.0 * (1.0 + 1e-9)
    assert acceleration <= 0.7 * (1.0 + 1e-9)
    if "times: [" not in text:
        # A lap without stops takes no longer than a lap with a stop.
        assert between[0] <= min(first, last) * (1.0 + 1e-12)
        assert max(speed / 2.0, acceleration / 0.7) == pytest.approx(1.0)
    assert np.linalg.norm(evaluate(plan.path, plan.lap_times[1:-1], 1), axis=0).min() > 0.1


def test_three_laps_of_the_figure_eight_have_a_trapezoidal_profile_scaled_to_the_limits(diagrams):
    plan = plan_route(route(diagrams, "kind: figure_eight, laps: 3, cruise_speed: 1.1, top_acceleration: 0.6"))
    profile_times = trapezoid_times(plan.path.waypoints, speed=1.1, acceleration=0.6)
    factors = np.diff(plan.path.times) / np.diff(profile_times)
    np.testing.assert_allclose(factors, factors[0], rtol=1e-9)


def test_the_vehicle_rests_between_laps_if_the_last_waypoint_is_a_stop(diagrams):
    stopping = LAP_WAYPOINTS_YAML.replace("[0, 0, 1]]", "{point: [0, 0, 1], stop: true}]")
    plan = plan_route(route(diagrams, f"kind: waypoints, laps: 3, {stopping}"))
    for order in (1, 2, 3):
        np.testing.assert_allclose(evaluate(plan.path, plan.lap_times, order), 0.0, atol=1e-9)
    one_lap = plan_route(route(diagrams, f"kind: waypoints, {LAP_WAYPOINTS_YAML}"))
    np.testing.assert_allclose(np.diff(plan.lap_times), one_lap.duration, rtol=1e-3)


def test_the_vehicle_stays_at_a_repeated_waypoint_if_times_are_given(diagrams):
    """Two waypoints are repeated: the waypoint at which laps begin, and a waypoint within the lap."""
    waypoints = "waypoints: [[0, 0, 1], [0, 0, 1], [1, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 1]]"
    times = "times: [2, 3, 7, 8, 13, 17], top_speed: null, top_acceleration: null"
    plan = plan_route(route(diagrams, f"kind: waypoints, laps: 2, {times}, {waypoints}"))
    assert plan.lap_times == (2.0, 17.0, 32.0)
    for start in plan.lap_times[:-1]:
        for stay_start, stay_end in ((0.0, 1.0), (5.0, 6.0)):
            stay_times = np.linspace(start + stay_start, start + stay_end, 9)
            np.testing.assert_allclose(evaluate(plan.path, stay_times, 1), 0.0, atol=1e-9)
        assert np.linalg.norm(evaluate(plan.path, [start + 11.0], 1)) > 0.01


def test_legs_and_yaws_are_repeated_in_each_lap(diagrams):
    eight = plan_route(route(diagrams, "kind: figure_eight, laps: 3"))
    climbs = [leg.first for leg in eight.legs if leg.name == "climb"]
    np.testing.assert_allclose(eight.path.times[climbs], eight.lap_times[:-1])
    assert len(eight.legs) == 1 + 3 * 7
    waypoints_with_yaws = LAP_WAYPOINTS_YAML.replace("[1, 0, 1.2]", "{point: [1, 0, 1.2], yaw: 0.7}").replace(
        "[0, 0, 1]]", "{point: [0, 0, 1], yaw: -0.2}]"
    )
    plan = plan_route(route(diagrams, f"kind: waypoints, laps: 3, heading: waypoints, {waypoints_with_yaws}"))
    np.testing.assert_allclose(evaluate(plan.yaw, plan.lap_times[1:])[0], -0.2, atol=1e-9)
    passing_times = plan.path.times[[leg.first + 1 for leg in plan.legs]]
    np.testing.assert_allclose(evaluate(plan.yaw, passing_times)[0], 0.7, atol=1e-9)


def test_circles_and_lissajous_figures_have_several_laps_and_other_routes_have_one(diagrams):
    circle = plan_route(route(diagrams, "kind: circle, laps: 3"))
    np.testing.assert_allclose(circle.path.waypoints[[0, 8, 16, 24]], np.tile([1.5, 0.0, 1.0], (4, 1)), atol=1e-12)
    np.testing.assert_allclose(circle.lap_times, circle.path.times[[0, 8, 16, 24]])
    waves = plan_route(route(diagrams, "kind: lissajous, amplitude: [0.1, 0.1, 0], period: 5, laps: 3"))
    assert waves.lap_times == pytest.approx((0.0, 5.0, 10.0, 15.0))
    hover = plan_route(route(diagrams, "kind: hover, duration: 4"))
    assert hover.lap_times == (0.0, 4.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("laps: 2, waypoints: [[0, 0, 1], [1, 0, 1]]", "laps is 2, but must be 1, since the route does not end"),
        (
            f"laps: 2, space: {{min: [-9, -9, 0], max: [9, 9, 9]}}, {LAP_WAYPOINTS_YAML}",
            "space .*must be left out, since it cannot be",
        ),
        (
            f"laps: 2, times: {{kind: minimum_snap, duration: 9}}, {LAP_WAYPOINTS_YAML}",
            "must be fixed, heuristic or minimum_time",
        ),
        (
            f"laps: 2, {LAP_WAYPOINTS_YAML.replace('[1, 0, 1.2]', '{point: [1, 0, 1], velocity: [1, 0, 0]}')}",
            "velocity .*left out",
        ),
        (f"laps: 2, times: [0, 1, 2, 3], {LAP_WAYPOINTS_YAML}", "the (path|segment|times|limits)|too"),
        (f"laps: 0, {LAP_WAYPOINTS_YAML}", "laps is 0"),
    ],
)
def test_a_route_that_cannot_have_laps_is_rejected_with_the_reason(diagrams, text, words):
    with pytest.raises(InputError, match=words) as caught:
        plan_route(route(diagrams, f"kind: waypoints, {text}"))
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_metrics_can_start_at_a_later_lap(diagrams):
    """The metrics cover the part of the flight from the start of this lap."""
    lap = "kind: lissajous, amplitude: [0.4, 0.3, 0.0], period: 4, laps: 2"
    from_second_lap, from_start_time, whole_flight = (
        simulate(route(diagrams, lap, *window)).metrics.rmse
        for window in (["metrics.first_lap=2"], ["metrics.start=4"], [])
    )
    assert from_second_lap == from_start_time < whole_flight


@pytest.mark.parametrize(
    ("window", "words"),
    [
        ("{first_lap: 3}", "metrics.first_lap is 3, but the route has 2 laps"),
        ("{first_lap: 2, start: 1.0}", "must not be combined with a start, 1"),
    ],
)
def test_metrics_cannot_start_at_a_lap_that_does_not_exist(diagrams, window, words):
    with pytest.raises(InputError, match=words):
        simulate(route(diagrams, "kind: circle", f"metrics={window}"))


@pytest.mark.parametrize(("fraction", "is_feasible"), [(1.0, True), (1.0 / 1.2, False)])
def test_the_error_for_lap_times_that_violate_a_limit_gives_the_necessary_factor(diagrams, fraction, is_feasible):
    route_text = (
        f"kind: waypoints, laps: 3, times: [1, 5, 8, 13], {LAP_WAYPOINTS_YAML}, top_acceleration: null, top_speed: "
    )
    fastest = float(peak_norm(plan_route(route(diagrams, route_text + "null")).path, 1))
    limited_route = route_text + repr(fraction * fastest)
    if is_feasible:
        assert plan_route(route(diagrams, limited_route)).lap_times[-1] == pytest.approx(37.0)
    else:
        with pytest.raises(
            InputError, match=r"the path through all laps exceeds its limits; multiply route\.times by 1\.2"
        ):
            plan_route(route(diagrams, limited_route))


def test_a_stop_applies_to_the_same_waypoint_in_every_lap_and_to_no_other(diagrams):
    for number in (1, 2):
        points = ["[0, 0, 1]", "[1, 0, 1.2]", "[1, 1.5, 1]", "[0, 0, 1]"]
        points[number] = f"{{point: {points[number]}, stop: true}}"
        plan = plan_route(route(diagrams, f"kind: waypoints, laps: 3, waypoints: [{', '.join(points)}]"))
        speeds = np.linalg.norm(evaluate(plan.path, plan.path.times, 1), axis=0)
        assert len(speeds) == 10
        for index, speed in enumerate(speeds):
            is_stop = index in (0, 9) or index % 3 == number
            assert speed == pytest.approx(0.0, abs=1e-9) if is_stop else speed > 0.05


@pytest.mark.parametrize(
    ("points", "is_at_rest"),
    [
        ("[0, 0, 1], [1, 0, 1], [1, 0, 1], [0, 1, 1], [0, 1, 1], [0, 0, 1]", False),
        ("[0, 0, 1], [1, 0, 1], [0.5, 1, 1], [0, 1, 1], [0, 0, 1], [0, 0, 1]", True),
    ],
)
def test_the_vehicle_rests_between_laps_only_if_it_stays_at_the_first_waypoint(diagrams, points, is_at_rest):
    times = "times: [0, 4, 5, 9, 10, 14], top_speed: null, top_acceleration: null"
    plan = plan_route(route(diagrams, f"kind: waypoints, laps: 2, {times}, waypoints: [{points}]"))
    speed = np.linalg.norm(evaluate(plan.path, [14.0], 1))
    assert speed == pytest.approx(0.0, abs=1e-9) if is_at_rest else speed > 0.05
