"""Tests of error messages that explain why a path is infeasible and propose a remedy."""

import re

import numpy as np
import pytest

from drake_quad.reference import infeasibility
from drake_quad.reference.infeasibility import explain_infeasibility
from drake_quad.reference.minimum_snap import rest_at_ends
from drake_quad.reference.minimum_snap_program import InfeasibleError, SolverError, constrained_minimum_snap
from drake_quad.reference.path_problem import Box, PathLimits, PathProblem


def problem(points, velocity=None, **options):
    """Return a problem with stops at all waypoints, or with a given velocity at waypoint 1."""
    derivatives = np.zeros((len(points), 3, len(points[0])))
    if velocity is not None:
        derivatives = rest_at_ends(len(points), len(points[0]))
        derivatives[1, 0] = velocity
    return PathProblem([Box.point(point) for point in points], derivatives=derivatives, **options)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        # From rest to rest, 1 m in 1 s requires 35/16 m/s and 84 √5 / 25 m/s².
        (PathLimits(speed=1.0, acceleration=5.0), "the speed limit of 1 m/s cannot be kept on segment 1: "
         "at these times at least 2.19 m/s is needed; the flight is feasible if all durations are multiplied by 2.19"),
        (PathLimits(speed=2.0, acceleration=2.0), "the acceleration limit of 2 m/s² cannot be kept on segment 1: "
         "at these times at least 7.52 m/s² is needed; the flight is feasible if all durations are multiplied by 1.94"),
    ],
)  # fmt: skip
def test_the_most_violated_limit_and_its_segment_are_named(limits, words):
    assert explain_infeasibility(problem([[0.0], [0.5], [1.5], [2.2]], limits=limits), np.ones(3)) == words


@pytest.mark.parametrize("speed", [2.19, 3.01, 40.7, 511.0, 0.0633])
def test_rounding_up_leaves_values_with_three_digits_unchanged(speed):
    path_problem = problem([[0.0], [16.0 / 35.0 * speed]], limits=PathLimits(speed=0.5 * speed))
    assert f"at least {speed:g} m/s is needed; the flight is feasible " in explain_infeasibility(
        path_problem, np.ones(1)
    )


def test_the_smallest_feasible_slow_down_is_found_to_three_digits():
    path_problem = problem([[0.0], [4.0], [8.0]], [1.5], limits=PathLimits(speed=3.0, acceleration=1.0))
    durations = np.array([3.0, 3.2])
    match = re.search(
        r"on segment 0: .* the flight is feasible if all durations are multiplied by ([\d.]+)$",
        explain_infeasibility(path_problem, durations),
    )
    factor = float(match[1])
    constrained_minimum_snap(path_problem, factor * durations)
    with pytest.raises(InfeasibleError):
        constrained_minimum_snap(path_problem, (factor - 0.011) * durations)


def test_a_given_velocity_that_is_infeasible_for_all_durations_is_reported():
    """At 0.05 m/s², braking from 1.9 m/s needs 36 m."""
    path_problem = problem([[0.0], [0.2], [0.4]], [1.9], limits=PathLimits(acceleration=0.05))
    assert re.fullmatch(
        r"the acceleration limit of 0.05 m/s² cannot be kept on segment \d: at these times at least [\d.]+ m/s² is "
        r"needed; no slower flight was found that satisfies the derivatives given at the waypoints",
        explain_infeasibility(path_problem, np.array([1.0, 1.0])),
    )


def test_the_message_describes_the_smoothest_path_if_the_solver_fails():
    path_problem = problem([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], limits=PathLimits(acceleration=1.0))
    path_problem = PathProblem(path_problem.waypoints, limits=path_problem.limits)
    message = explain_infeasibility(path_problem, np.array([1e-9, 1e-9]))
    assert "at these times the smoothest path needs " in message


def test_the_message_states_by_how_much_a_corridor_must_be_wider():
    """The path passes the start of segment 1 backwards, at -1.5 m/s, so it must leave the corridor of this segment."""
    points, durations = [[0.0], [4.0], [8.0]], np.array([4.0, 4.0])

    def within(wider):
        return problem(points, [-1.5], corridors=[None, Box([4.0 - wider], [8.5 + wider])])

    match = re.fullmatch(
        r"the path cannot stay in the corridor of segment 1 at these times with the derivatives given at the "
        r"waypoints: the corridor would have to be ([\d.]+) m wider",
        explain_infeasibility(within(0.0), durations),
    )
    wider = float(match[1])
    constrained_minimum_snap(within(wider), durations)
    with pytest.raises(InfeasibleError):
        constrained_minimum_snap(within(0.98 * wider), durations)


@pytest.mark.parametrize("further_points", [[], [[9.0, 1.0]]])
def test_the_message_states_by_how_much_a_path_with_given_derivatives_leaves_a_corridor(further_points):
    """All derivatives at both ends of the first segment are given. The message does not depend on further segments."""
    points, durations = [[0.0, 0.0], [4.0, 0.0], *further_points], np.ones(1 + len(further_points))
    motion = np.full((len(points), 3, 2), np.nan)
    motion[:2] = 0.0
    motion[0, 0] = 0.0, 3.0

    def within(wider):
        corridors = [Box([-9.0, -0.2 - wider], [9.0, 0.2 + wider]), *(None for _ in further_points)]
        return PathProblem([Box.point(point) for point in points], derivatives=motion, corridors=corridors)

    match = re.fullmatch(
        r"the path cannot stay in the corridor of segment 0 .* ([\d.]+) m wider",
        explain_infeasibility(within(0.0), durations),
    )
    wider = float(match[1])
    constrained_minimum_snap(within(wider), durations)
    with pytest.raises(InfeasibleError):
        constrained_minimum_snap(within(0.98 * wider), durations)


@pytest.mark.parametrize("corridors", [None, [Box([-1.0], [5.0])]])
def test_no_corridor_is_named_if_only_the_solver_failed(monkeypatch, corridors):
    def gives_up(problem, durations):
        raise SolverError

    monkeypatch.setattr(infeasibility, "constrained_minimum_snap", gives_up)
    assert explain_infeasibility(problem([[0.0], [4.0]], corridors=corridors), np.ones(1)) == (
        "no path was found that satisfies the corridors and the derivatives given at the waypoints at these times"
    )
