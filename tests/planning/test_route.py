"""Tests of route plans: constraints, yaw, rotor limits, duration and saved trajectories."""

import math
import re

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.errors import InputError
from drake_quad.flight.mission import plan_route
from drake_quad.planning.duration import flight_duration, window_end, window_start
from drake_quad.planning.feasibility import plan_demand
from drake_quad.planning.nominal import nominal_parameters, planned_parameters
from drake_quad.reference.polynomial_path import evaluate, peak_norm
from drake_quad.reference.trajectory_files import save_plan
from drake_quad.scenario.files.loading import load_mission


@pytest.fixture
def slalom(diagrams):
    return lambda *overrides: load_mission(diagrams / "slalom.yaml", overrides)


def sample_times(plan):
    return np.linspace(*plan.path.times[[0, -1]], 500)


@pytest.mark.slow
def test_the_slalom_satisfies_all_its_constraints(slalom):
    mission = slalom()
    plan = plan_route(mission)
    problem = mission.route.problem()
    assert peak_norm(plan.path, 1) <= 2.0 * (1.0 + 1e-6)
    assert peak_norm(plan.path, 2) <= 1.5 * (1.0 + 1e-6)
    for waypoint, position in zip(problem.waypoints, evaluate(plan.path, plan.path.times).T, strict=True):
        np.testing.assert_allclose(waypoint.nearest(position), position, atol=1e-6)
    for order in (1, 2, 3):
        np.testing.assert_allclose(evaluate(plan.path, plan.path.times[4:5], order), 0.0, atol=1e-9)
    np.testing.assert_allclose(evaluate(plan.path, plan.path.times[5:6], 1)[:, 0], [-1.2, 0.0, 0.0], atol=1e-9)
    position = evaluate(plan.path, sample_times(plan)).T
    assert (position >= np.array([-1.0, -2.0, 0.5]) - 1e-5).all()
    assert (position <= np.array([9.0, 3.2, 2.5]) + 1e-5).all()


@pytest.mark.long
def test_the_yaw_profile_follows_the_heading_setting(slalom):
    yaws = {}
    for heading in ("constant", "along_path"):
        plan = plan_route(slalom(f"route.heading={heading}", "route.yaw=0.3"))
        yaws[heading] = evaluate(plan.yaw, sample_times(plan))[0]
    np.testing.assert_allclose(yaws["constant"], 0.3)
    v_x, v_y, _ = evaluate(plan.path, sample_times(plan), 1)
    fast = np.hypot(v_x, v_y) > 1.0
    assert np.mean(np.cos(yaws["along_path"] - np.arctan2(v_y, v_x))[fast]) > 0.95


def test_the_yaw_passes_through_waypoints_even_if_one_is_repeated(slalom):
    waypoints = "[{point: [0, 0, 1], yaw: 0}, [1, 0, 1], {point: [1, 0, 1], yaw: 1.0}, {point: [2, 0, 1], yaw: 4}]"
    route = f"{{kind: waypoints, waypoints: {waypoints}, heading: waypoints}}"
    plan = plan_route(slalom("route=" + route, "route.corridors=null", "route.space=null"))
    assert len(plan.path.times) == 3
    np.testing.assert_allclose(evaluate(plan.yaw, plan.path.times)[0], [0.0, 1.0, 4.0], atol=1e-12)


@pytest.mark.long
def test_a_saved_plan_gives_the_same_flight_as_the_original_plan(slalom, diagrams, tmp_path):
    plan = plan_route(slalom())
    save_plan(plan, tmp_path, name="slalom")
    path = tmp_path / "loop.yaml"
    path.write_text(f"loop:\n  extends: [{diagrams / 'figure_eight.yaml'}, trajectory.yaml:slalom]\n")
    loaded_plan = plan_route(load_mission(path))
    for order in range(5):
        expected = evaluate(plan.path, sample_times(plan), order)
        np.testing.assert_allclose(
            evaluate(loaded_plan.path, sample_times(plan), order), expected, atol=1e-9 * np.abs(expected).max()
        )
    np.testing.assert_allclose(
        evaluate(loaded_plan.yaw, sample_times(plan)), evaluate(plan.yaw, sample_times(plan)), atol=1e-12
    )
    table = np.genfromtxt(tmp_path / "trajectory.csv", delimiter=",", skip_header=1)
    assert table.shape[1] == 18
    np.testing.assert_allclose(table[:, 1:4].T, evaluate(plan.path, table[:, 0]), atol=1e-7)
    np.testing.assert_allclose(table[:, 13:16].T, evaluate(plan.path, table[:, 0], 4), atol=1e-5)
    np.testing.assert_allclose(table[:, 16], evaluate(plan.yaw, table[:, 0])[0], atol=1e-7)
    assert table[-1, 0] == pytest.approx(plan.path.times[-1])
    flights = [simulate(load_scenario(file, ["duration=4"])) for file in (path, diagrams / "slalom.yaml")]
    np.testing.assert_allclose(flights[0]["state"], flights[1]["state"], atol=1e-9)


@pytest.mark.long
def test_a_plan_created_in_python_can_be_flown(slalom, diagrams):
    scenario = load_scenario(diagrams / "slalom.yaml", ["duration=6", "route.heading=constant"])
    plan = plan_route(slalom("route.heading=constant", "route.top_acceleration=0.7"))
    flight = simulate(scenario, plan=plan)
    assert flight.plan is plan
    reference = flight.record("reference")
    np.testing.assert_allclose([reference.x, reference.y, reference.z], evaluate(plan.path, flight.time), atol=1e-9)


@pytest.mark.slow
def test_a_yaw_along_the_path_hardly_increases_the_tracking_error(diagrams):
    rmse = [
        simulate(load_scenario(diagrams / "figure_eight.yaml", [f"route.heading={heading}"])).metrics.rmse
        for heading in ("constant", "along_path")
    ]
    assert max(rmse) < 0.03


def test_the_yaw_of_a_trajectory_without_yaw_is_zero(slalom):
    knots = "[{time: 0.5, position: [0, 0, 1]}, {time: 4, position: [1, 0, 1]}]"
    plan = plan_route(slalom(f"route={{kind: trajectory, knots: {knots}}}"))
    np.testing.assert_array_equal(plan.path.times, [0.5, 4.0])
    np.testing.assert_array_equal(evaluate(plan.yaw, sample_times(plan)), 0.0)
    assert peak_norm(plan.path, 1) == pytest.approx(2.1875 / 3.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("route.times={kind: fixed, times: [0, 1, 2, 3, 4, 5, 6]}", "the .* limit of .* cannot be kept on segment"),
        ("route.times={kind: minimum_snap, duration: 8}", "feasible if all durations are multiplied by|cannot be kept"),
        ("route.top_acceleration={uniform: {min: 1, max: 2}}", "route.top_acceleration is a distribution"),
        ("nominal.max_rotor_speed=205", "the rotors cannot fly this route"),
    ],
)
def test_the_error_for_a_route_that_cannot_be_flown_gives_the_reason(slalom, override, words):
    with pytest.raises(InputError, match=words):
        plan_route(slalom(override))


def test_a_yaw_that_turns_too_fast_for_the_rotors_is_refused(slalom):
    waypoints = f"[{{point: [0, 0, 1], yaw: 0}}, {{point: [0.02, 0, 1], yaw: {math.pi / 2}}}]"
    route = f"{{kind: waypoints, waypoints: {waypoints}, heading: waypoints, times: [0, 0.8]}}"
    with pytest.raises(InputError, match="the rotors cannot fly this route"):
        plan_route(slalom("route=" + route, "route.corridors=null", "route.space=null"))


@pytest.mark.parametrize(
    ("overrides", "limit"),
    [
        ([], None),
        # Full throttle produces 1.66 N per rotor, but hover needs 1.668 N.
        (["nominal.motors.curve=[0.0, 0.3, 1.36]"], 200.49),
        (["nominal.motors.curve=[0.0, 0.3, 1.38]"], None),
        (["nominal.motors.curve=[1.68, 0.3, 2.0]"], 201.69),
        (["nominal.motors.curve=[1.66, 0.3, 2.0]"], None),
        (["nominal.max_rotor_speed=200"], 200.0),
        (["nominal.min_rotor_speed=202"], 202.0),
    ],
)
def test_a_plan_satisfies_the_stricter_of_the_rotor_speed_and_throttle_limits(diagrams, overrides, limit):
    """In hover, each rotor of the paper's vehicle produces m g / 4 = 1.668 N at 200.95 rad/s."""
    curve = "nominal.motors={kind: throttle, curve: [0.1, 0.3, 3.0]}"
    mission = load_mission(diagrams / "hover.yaml", [curve, *overrides])
    if limit is None:
        plan_route(mission)
        return
    with pytest.raises(InputError, match=r"rotor 1 would have to turn at 201 rad/s, but its limit") as refused:
        plan_route(mission)
    suffix = "" if limit in (200.0, 202.0) else ", which is the limit of the throttle"
    assert str(refused.value).endswith(f"but its limit is {limit:.0f} rad/s{suffix}")


def test_throttle_limits_are_converted_to_rotor_speeds_with_the_mean_thrust_factor(diagrams):
    rotor_data = [((0.2, 0.1), "clockwise", 4e-5), ((-0.1, -0.2), "anticlockwise", 4.4e-5)]
    rotor_data += [((-0.2, -0.1), "clockwise", 4.1e-5), ((0.1, 0.2), "anticlockwise", 3.9e-5)]
    rotors = [
        f"{{position: [{x}, {y}, 0], turns: {turns}, thrust_factor: {factor}}}" for (x, y), turns, factor in rotor_data
    ]
    layout = f"nominal.layout={{kind: rotors, rotors: [{', '.join(rotors)}]}}"
    mission = load_mission(diagrams / "hover.yaml", [layout, "nominal.motors={kind: throttle, curve: [0.2, 0.5, 2.3]}"])
    parameters, mean_factor = planned_parameters(mission), 4.1e-5
    assert parameters == nominal_parameters(mission)._replace(
        min_rotor_speed=pytest.approx(np.sqrt(0.2 / mean_factor)),
        max_rotor_speed=pytest.approx(np.sqrt(3.0 / mean_factor)),
    )


def test_rotor_speeds_of_a_vertical_oscillation_follow_from_weight_and_acceleration(diagrams):
    """For z = 0.3 sin(2π t / 3) and equal rotors, 4 b ω² = m (g + z̈) for all four speeds ω."""
    route = "{kind: lissajous, centre: [0, 0, 1], amplitude: [0, 0, 0.3], turns: [0, 0, 1], period: 3, laps: 2}"
    mission = load_mission(diagrams / "hover.yaml", [f"route={route}"])
    plan, parameters = plan_route(mission), nominal_parameters(mission)
    times = np.linspace(0.0, 6.0, 61)
    thrust = 0.68 * (9.81 + evaluate(plan.path, times, 2)[2])
    assert np.ptp(thrust) > 1.5
    speeds = np.array(plan_demand(plan, parameters, times).rotor_speed)
    np.testing.assert_allclose(speeds, np.sqrt(thrust / (4.0 * 4.13e-5)) * np.ones((4, 1)), rtol=1e-9)


def test_the_flight_duration_is_a_whole_number_of_control_ticks(diagrams):
    """In this scenario a tick takes 20 ms, but a time step and a frame take 10 ms."""
    for given_duration, duration in (
        (0.001, 0.02),
        (0.02, 0.02),
        (0.05, 0.06),
        (0.06, 0.06),
        (0.061, 0.08),
        (0.14, 0.14),
    ):
        scenario = load_scenario(diagrams / "hover.yaml", [f"duration={given_duration}"])
        assert flight_duration(scenario, plan_route(scenario)) == pytest.approx(duration, rel=1e-12)


def test_a_metric_window_of_laps_ends_with_the_tick_after_the_last_lap(diagrams):
    route = "route={kind: lissajous, amplitude: [0.4, 0.3, 0.0], period: 4.01, laps: 3}"

    def window(*metrics):
        scenario = load_scenario(diagrams / "hover.yaml", [route, *metrics])
        plan = plan_route(scenario)
        return window_start(scenario, plan), window_end(scenario, plan)

    for lap in (1, 2, 3):
        assert window(f"metrics={{first_lap: {lap}}}") == pytest.approx((4.01 * (lap - 1), 12.04))
    assert window("metrics={start: 1.5}") == (1.5, math.inf)
    assert window("metrics={start: 1.5, end: 6.0}") == (1.5, 6.0)
    assert window("metrics={first_lap: 2, end: 6.0}") == pytest.approx((4.01, 6.0))


def test_the_origin_shifts_the_knots_of_a_trajectory_and_the_time_scale_slows_the_trajectory(slalom):
    """The time scale s divides the k-th derivative by sᵏ."""
    first_knot = [[0.3, -0.2, 1.0], [0.4, 0.1, -0.1], [0.2, -0.3, 0.05], [0.1, 0.2, -0.15]]
    knots = [
        f"{{time: {time}, position: {position}, velocity: {velocity}, acceleration: {acceleration}, jerk: {jerk}}}"
        for time, (position, velocity, acceleration, jerk) in (
            (1.0, first_knot),
            (3.0, (np.array(first_knot) + 0.5).tolist()),
        )
    ]
    yaw_knots = "[{time: 1.0, yaw: 0.4, yaw_rate: 0.2}, {time: 2.0, yaw: 0.9}, {time: 3.0, yaw: 1.1, yaw_rate: -0.3}]"
    trajectory = f"knots: [{', '.join(knots)}], origin: [3.0, 2.0, 1.0], time_scale: 2.5"
    for yaws in (None, yaw_knots):
        plan = plan_route(slalom(f"route={{kind: trajectory, {trajectory}, yaw_knots: {yaws or 'null'}}}"))
        assert plan.path.times.tolist() == [2.5, 7.5]
        for order, first_value in enumerate(first_knot):
            expected = np.column_stack([first_value, np.array(first_value) + 0.5])
            if order == 0:
                expected = expected + np.array([[3.0], [2.0], [1.0]])
            np.testing.assert_allclose(evaluate(plan.path, [2.5, 7.5], order), expected / 2.5**order, atol=1e-9)
        if yaws is None:
            assert (plan.yaw.times[0], plan.yaw.times[-1]) == (2.5, 7.5)
            continue
        assert plan.yaw.times.tolist() == [2.5, 5.0, 7.5]
        np.testing.assert_allclose(evaluate(plan.yaw, [2.5, 5.0, 7.5])[0], [0.4, 0.9, 1.1], atol=1e-12)
        np.testing.assert_allclose(evaluate(plan.yaw, [2.5, 5.0, 7.5], 1)[0], [0.08, 0.0, -0.12], atol=1e-9)


def test_a_constant_yaw_lasts_from_the_beginning_to_the_end_of_the_path(diagrams):
    for route in ("{kind: figure_eight, yaw: 0.3}", "{kind: circle, yaw: 0.3}"):
        plan = plan_route(load_mission(diagrams / "figure_eight.yaml", [f"route={route}"]))
        assert plan.yaw.times.tolist() == plan.path.times[[0, -1]].tolist()
        assert plan.initial_yaw == 0.3


def test_a_flight_takes_at_least_one_tick(diagrams):
    """The planned trajectory is much shorter than a tick."""
    knots = "[{time: 0, position: [0, 0, 1]}, {time: 1, position: [0, 0, 1]}]"
    scenario = load_scenario(
        diagrams / "hover.yaml", [f"route={{kind: trajectory, knots: {knots}, time_scale: 1e-12}}"]
    )
    assert flight_duration(scenario, plan_route(scenario)) == 0.02


@pytest.mark.slow
def test_yaw_rate_along_a_path_includes_the_rate_of_its_direction():
    mission = load_scenario("figure_eight", ["route={kind: circle, heading: along_path}"])
    plan = plan_route(mission)
    demand = plan_demand(plan, planned_parameters(mission), sample_times(plan))
    (yaw,) = evaluate(plan.extended_yaw, sample_times(plan))
    assert np.ptp(yaw) > 2.0 * math.pi
    np.testing.assert_allclose(np.exp(1j * np.array(demand.attitude.yaw)), np.exp(1j * yaw), atol=1e-12)
    # For a small tilt, the body rate r is nearly the yaw rate.
    (yaw_rate,) = evaluate(plan.extended_yaw, sample_times(plan), 1)
    np.testing.assert_allclose(demand.body_rates.r, yaw_rate, atol=0.1 * np.abs(yaw_rate).max())


def test_a_metric_window_must_begin_before_the_end_of_the_flight(diagrams):
    route = "route={kind: lissajous, amplitude: [0.4, 0.3, 0.0], period: 4.0, laps: 3}"
    for window, words in (
        ("metrics={first_lap: 3}", "metrics.first_lap is 3, but this lap starts at 8 s and must start before the end"),
        ("metrics={start: 6}", "metrics.start is 6 s, but must be before the end of the flight at 6 s"),
    ):
        scenario = load_scenario(diagrams / "hover.yaml", [route, "duration=6", window])
        with pytest.raises(InputError, match=re.escape(words)):
            flight_duration(scenario, plan_route(scenario))
