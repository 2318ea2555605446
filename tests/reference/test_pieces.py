"""Tests of the exchange of plans with Crazyswarm2 and minsnap-trajectories, as polynomial pieces."""

import sys

import minsnap_trajectories
import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.flight.mission import plan_route
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.pieces import (
    COLUMNS,
    minsnap_to_plan,
    minsnap_trajectory,
    minsnap_waypoints,
    pieces_to_plan,
    plan_to_pieces,
    save_pieces,
)
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path
from drake_quad.reference.trajectory_files import save_plan
from drake_quad.scenario.files.loading import load_mission

POSITION_PATH = minimum_snap([[0, 0, 1], [1, 2, 1.5], [3, 1, 2], [2, 0, 1]], [0.0, 1.7, 3.01, 5.2])
# Yaw and position have different knots.
YAW_PATH = hermite_path(
    np.array([0.0, 1.1, 1.7, 4.4, 5.2]), np.array([[[0.3], [0.0]], [[0.8], [0.2]], *[[[1.0], [-0.3]]] * 3])
)
EXAMPLE_PLAN = Plan(POSITION_PATH, YAW_PATH)

ZEROS = ",".join(["0.000000"] * 16)  # coefficients of y and z
# A piece over one metre along x, and a piece back. Numbers have six decimals, as in files of uav_trajectories.
ROUND_TRIP_CSV = f"""\
# {",".join(COLUMNS)}
2.000000,0.000000,0.000000,0.000000,0.000000,2.187500,-2.625000,1.093750,-0.156250,{ZEROS},{",".join(["0.000000"] * 8)}

4.000000,1.000000,0.000000,0.000000,0.000000,-0.136719,0.082031,-0.017090,0.001221,{ZEROS},0.000000,0.100000,0,0,0,0,0,0,
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name="course.csv"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


def assert_alike(one, other, start=0.0, atol=1e-12):
    """Assert that two plans agree in position, velocity, acceleration, jerk, snap, yaw and yaw rate.

    The tolerance is `atol` times the largest value of each quantity, or `atol` if this value is below 1.
    """
    times = np.linspace(start, one.path.times[-1], 2001)[1:-1]
    for part, orders in (("path", 5), ("yaw", 2)):
        for order in range(orders):
            expected, actual = (evaluate(getattr(plan, part), times, order) for plan in (one, other))
            scale = max(1.0, np.abs(expected).max())
            np.testing.assert_allclose(actual / scale, expected / scale, rtol=0.0, atol=atol, err_msg=f"{part} {order}")


def test_a_round_trip_through_a_file_keeps_the_plan(tmp_path):
    loaded_plan = plan_route(load_mission(save_pieces(EXAMPLE_PLAN, tmp_path / "mine.csv")))
    assert_alike(EXAMPLE_PLAN, loaded_plan)
    # A piece ends at each knot of position or yaw. The knots at 1.1 s and 4.4 s are knots of the yaw only.
    np.testing.assert_allclose(loaded_plan.path.times, [0.0, 1.1, 1.7, 3.01, 4.4, 5.2], rtol=1e-15)


def test_a_file_can_be_read_as_crazyswarm2_does(tmp_path):
    """Crazyswarm2 uses `numpy.loadtxt(filename, delimiter=",", skiprows=1)`. The lowest power comes first."""
    file = save_pieces(EXAMPLE_PLAN, tmp_path / "mine.csv")
    assert file.read_text().splitlines()[0] == ",".join(COLUMNS)
    assert COLUMNS[:3] + COLUMNS[-1:] == ("duration", "x^0", "x^1", "yaw^7")
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    assert rows.shape == (5, 33)
    start = 0.0
    for duration, *numbers in rows:
        polynomials = np.reshape(numbers, (4, 8))[:, ::-1]
        expected = np.vstack([evaluate(POSITION_PATH, [start + 0.3]), evaluate(YAW_PATH, [start + 0.3])])[:, 0]
        np.testing.assert_allclose([np.polyval(each, 0.3) for each in polynomials], expected, atol=1e-12)
        start += duration


@pytest.mark.parametrize("turns", [[0, 1, 1, 1, 1], [0, -1, 2, 0, -3], [1, 1, 1, 1, 1]])
def test_pieces_whose_yaws_differ_by_whole_turns_are_continuous(turns):
    """Other programs write yaw angles from -π to π."""
    rows = plan_to_pieces(EXAMPLE_PLAN)
    rows[:, COLUMNS.index("yaw^0")] += 2.0 * np.pi * np.array(turns)
    converted_plan = pieces_to_plan(rows)
    first = PolynomialPath(YAW_PATH.times, YAW_PATH.coefficients + 2.0 * np.pi * turns[0] * np.eye(1, 4).T)
    assert_alike(Plan(POSITION_PATH, first), converted_plan)


@pytest.mark.parametrize("end_yaw", [3.14159, -3.14159, 0.4])
def test_the_yaw_is_continuous_even_if_the_yaw_in_a_file_wraps(write, end_yaw):
    wrapped_yaw = end_yaw - np.copysign(6.28318, end_yaw) if abs(end_yaw) > 1.0 else end_yaw + 4.0 * np.pi
    text = f"duration,x^0,y^0,z^0,yaw^0,yaw^1\n1,0,0,1,{end_yaw - 0.1},0.1\n1,0,0,1,{wrapped_yaw},0.1\n"
    plan = plan_route(load_mission(write(text)))
    times = np.linspace(0.0, 2.0, 41)
    np.testing.assert_allclose(evaluate(plan.yaw, times)[0], end_yaw - 0.1 + 0.1 * times, atol=1e-5)
    np.testing.assert_allclose(evaluate(plan.yaw, times, 1)[0], 0.1, atol=1e-12)


def test_a_plan_that_begins_later_hovers_until_then():
    later = Plan(POSITION_PATH._replace(times=POSITION_PATH.times + 0.5), YAW_PATH._replace(times=YAW_PATH.times + 0.5))
    converted_plan = pieces_to_plan(plan_to_pieces(later))
    assert converted_plan.path.times[0] == 0.0
    assert_alike(later, converted_plan, start=0.5)
    np.testing.assert_array_equal(evaluate(converted_plan.path, [0.2])[:, 0], [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(evaluate(converted_plan.path, [0.2], 1)[:, 0], 0.0)
    assert evaluate(converted_plan.yaw, [0.2])[0, 0] == 0.3


def test_a_path_of_too_high_a_degree_cannot_be_written():
    coefficients = np.zeros((1, 10, 3))
    Plan.with_constant_yaw(PolynomialPath(np.array([0.0, 1.0]), coefficients))
    assert plan_to_pieces(Plan.with_constant_yaw(PolynomialPath(np.array([0.0, 1.0]), coefficients))).shape == (1, 33)
    coefficients[0, 9] = 1.0
    with pytest.raises(InputError, match="the path has degree 9, but a piece has at most degree 7"):
        plan_to_pieces(Plan.with_constant_yaw(PolynomialPath(np.array([0.0, 1.0]), coefficients)))


def test_files_written_by_other_programs_can_be_read(write):
    """The file has a # before the names, an empty line and a trailing comma.

    Its plan moves 1 m in 2 s, and back in 4 s.
    """
    plan = plan_route(load_mission(write(ROUND_TRIP_CSV)))
    np.testing.assert_array_equal(plan.path.times, [0.0, 2.0, 6.0])
    fractions = np.linspace(0.0, 1.0, 21)
    blend = 35 * fractions**4 - 84 * fractions**5 + 70 * fractions**6 - 20 * fractions**7
    np.testing.assert_allclose(evaluate(plan.path, 2.0 * fractions)[0], blend, atol=1e-12)
    np.testing.assert_allclose(evaluate(plan.path, 2.0 + 4.0 * fractions)[0], 1.0 - blend, atol=5e-3)
    np.testing.assert_allclose(evaluate(plan.yaw, [1.0, 4.0, 6.0])[0], [0.0, 0.2, 0.4], atol=1e-12)


def test_a_route_can_refer_to_a_file_in_its_own_folder(write, diagrams, tmp_path):
    write(ROUND_TRIP_CSV, "there.csv")
    loop = f"""\
there:
  extends: {diagrams / "figure_eight.yaml"}
  route: {{kind: trajectory, pieces: there.csv, origin: [0.1, 0.2, 1.0], time_scale: 2.0}}
"""
    scenario = load_scenario(write(loop, "loop.yaml"))
    plan = plan_route(scenario)
    assert plan.duration == 12.0
    np.testing.assert_allclose(evaluate(plan.path, [4.0])[:, 0], [1.1, 0.2, 1.0], atol=1e-9)
    flight = simulate(scenario, compiled=True)
    assert flight.metrics.rmse < 0.01
    folder = flight.save(tmp_path / "flown")[0].parent
    assert (
        load_scenario(folder / "scenario.yaml") == flight.scenario
    )  # the saved scenario contains the pieces of the trajectory


def test_a_trajectory_of_knots_also_has_an_origin_and_a_time_scale(diagrams):
    knots = [{"time": 0.0, "position": [0, 0, 0]}, {"time": 4.0, "position": [1, 0, 0]}]
    route = {"kind": "trajectory", "knots": knots, "yaw_knots": [{"time": 0, "yaw": 0}, {"time": 4, "yaw": 1}]}
    plain, moved = (
        plan_route(load_mission(diagrams / "figure_eight.yaml", {"route": {**route, **options}}))
        for options in ({}, {"origin": [1.0, 2.0, 3.0], "time_scale": 1.5})
    )
    assert moved.duration == 6.0
    position = evaluate(plain.path, [2.0])[:, 0]
    np.testing.assert_allclose(evaluate(moved.path, [3.0])[:, 0], position + np.array([1.0, 2.0, 3.0]), rtol=1e-14)
    np.testing.assert_allclose(evaluate(moved.yaw, [3.0]), evaluate(plain.yaw, [2.0]), rtol=1e-14)


def test_defaults_of_a_trajectory_are_not_written(diagrams):
    """Studies that are older than these options can therefore be continued."""
    knots = [{"time": 0.0, "position": [0, 0, 0]}, {"time": 4.0, "position": [1, 0, 0]}]
    route = load_mission(diagrams / "figure_eight.yaml", {"route": {"kind": "trajectory", "knots": knots}}).route
    assert [*route.model_dump()] == ["kind", "knots", "yaw_knots"]


def test_a_plan_is_saved_with_pieces_if_its_knots_do_not_determine_it(write, tmp_path, diagrams):
    plan = plan_route(load_mission(write(ROUND_TRIP_CSV)))
    assert "knots" not in save_plan(plan, tmp_path, name="there")[1].read_text()
    loaded_scenario = load_scenario(diagrams / "figure_eight.yaml", layers=[tmp_path / "trajectory.yaml"])
    assert_alike(plan, plan_route(loaded_scenario))
    save_plan(EXAMPLE_PLAN, tmp_path, name="there")
    assert_alike(EXAMPLE_PLAN, plan_route(load_mission(tmp_path / "trajectory.yaml")))


def test_a_file_of_pieces_without_rows_is_rejected(diagrams, tmp_path):
    (tmp_path / "empty.csv").write_text("# a comment\n\n")
    with pytest.raises(InputError, match=r"empty\.csv: contains no pieces$"):
        load_scenario(diagrams / "figure_eight.yaml", f"route={{kind: trajectory, pieces: {tmp_path / 'empty.csv'}}}")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("duration,x^0,y^0,z^0\n", r"course.csv: contains no pieces"),
        ("duration,x^0,y^0\n1,0,0\n", r"course.csv:1: the column z\^0 is missing$"),
        (
            "duration,x^0,y^0,z^0,w^0\n1,0,0,1,0\n",
            r"course.csv:1: the column 'w\^0' is unknown; allowed are duration, ",
        ),
        ("duration,x^0,y^0,z^0,x^0\n1,0,0,1,0\n", r"course.csv:1: two columns have the same name$"),
        ("duration,x^0,y^0,z^0\n1,0,0\n", r"course.csv:2: has 3 cells, but the table has 4 columns$"),
        ("duration,x^0,y^0,z^0\n1,0,here,1\n", r"course.csv:2: y\^0 is 'here', but must be a finite number$"),
        ("duration,x^0,y^0,z^0\n1,0,nan,1\n", r"course.csv:2: y\^0 is 'nan', but must be a finite number$"),
        ("duration,x^0,y^0,z^0\n0,0,0,1\n", r"course.csv:2: route.pieces.0.duration is 0.0, but must be .* 0.0001"),
        ("duration,x^0,y^0,z^0\n1,0,0,2e9\n", r"course.csv:2: route.pieces.0.z.0 is 2000000000.0, but must be "),
        (
            "duration,x^0,y^0,z^0\n1,0,0,1\n1,0,0.5,1\n",
            r"course.csv:3: .* its position jumps by 0.5 m, more than 0.001$",
        ),
        (
            "duration,x^0,x^1,y^0,z^0\n1,0,0,0,1\n1,0,1,0,1\n",
            r"course.csv:3: .* its velocity jumps by 1 m/s, more than 0.01",
        ),
        (
            "duration,x^0,y^0,z^0,yaw^0\n1,0,0,1,0\n1,0,0,1,3\n",
            r"course.csv:3: .* its yaw jumps by 3 rad, more than 0.01$",
        ),
        (
            "duration,x^0,y^0,z^0,yaw^0\n1,0,0,1,3.1\n1,0,0,1,-3\n",
            r"course.csv:3: .* its yaw jumps by 0.183 rad, more than 0.01$",
        ),
        ("duration,x^0,y^0,z^0\n" + "1,0,0,1\n" * 1001, r"too many rows: a route may have at most 1,000 pieces$"),
        ("duration,x^0,x^2,y^0,z^0\n1,0,-500,0,1\n", r"the rotors cannot fly this route"),
    ],
)
def test_errors_in_a_file_are_reported(write, text, words):
    with pytest.raises(InputError, match=words):
        plan_route(load_mission(write(text)))


@pytest.mark.parametrize(
    ("route", "words"),
    [
        ("{kind: trajectory}", "must have either knots or pieces, not neither"),
        ("{kind: trajectory, pieces: nowhere.csv}", "route.pieces refers to .*nowhere.csv, which does not exist"),
        ("{kind: trajectory, pieces: loop.yaml}", "loop.yaml:1: "),
        (
            "{kind: trajectory, pieces: short.csv}",
            "short.csv:1: a table with 4 columns needs a first row with their names: duration, ",
        ),
        ("{kind: trajectory, pieces: []}", "2: route.pieces is .* at least 1 item"),
        ("{kind: trajectory, pieces: 3}", "2: route.pieces is 3, but must be a list"),
        ("{kind: trajectory, pieces: [{duration: 1, x: [0], y: [0], z: []}]}", "2: route.pieces.0.z is .* at least 1"),
        (
            "{kind: trajectory, pieces: [{duration: 1, x: [0], y: [0], z: [1]}], yaw_knots: [{time: 0, yaw: 0},"
            " {time: 1, yaw: 0}]}",
            "2: route.yaw_knots .* must be left out, since pieces contain the yaw",
        ),
        (
            "{kind: trajectory, time_scale: 0, pieces: [{duration: 1, x: [0], y: [0], z: [1]}]}",
            "2: route.time_scale is 0, but must be",
        ),
    ],
)
def test_errors_in_a_route_are_reported(write, route, words):
    write("1,0,0,1\n", "short.csv")
    with pytest.raises(InputError, match=words):
        load_mission(write(f"a:\n  route: {route}\n", "loop.yaml"))


@pytest.mark.parametrize("lines", ["# a course\n\n", "# two lines, of\n# duration\n"])
def test_lines_before_the_header_are_ignored(write, lines):
    write(lines + ROUND_TRIP_CSV, "noted.csv")
    loop = write("a:\n  route: {kind: trajectory, pieces: noted.csv}\n", "loop.yaml")
    for file in (write(lines + ROUND_TRIP_CSV), loop):
        assert_alike(plan_route(load_mission(write(ROUND_TRIP_CSV, "bare.csv"))), plan_route(load_mission(file)))


def test_many_empty_lines_are_read_quickly(write):
    """The time is proportional to the number of lines. With a quadratic algorithm, the test would take minutes."""
    with pytest.raises(InputError, match="contains no waypoints"):
        load_mission(write("\n" * 300_000))


def test_a_table_without_a_header_must_have_all_columns(write):
    write("\n".join(ROUND_TRIP_CSV.splitlines()[1:]), "bare.csv")
    loop = write("a:\n  route: {kind: trajectory, pieces: bare.csv}\n", "loop.yaml")
    assert_alike(plan_route(load_mission(write(ROUND_TRIP_CSV))), plan_route(load_mission(loop)))


def test_a_plan_converted_to_minsnap_trajectories_has_the_same_values():
    times = np.linspace(0.0, 5.2, 301)
    sampled = minsnap_trajectories.compute_trajectory_derivatives(minsnap_trajectory(EXAMPLE_PLAN), times, 5)
    for order in range(5):
        np.testing.assert_allclose(sampled[order].T, evaluate(POSITION_PATH, times, order), rtol=1e-11, atol=1e-10)
    actual = minsnap_to_plan(minsnap_trajectory(EXAMPLE_PLAN), 0.4)
    assert_alike(Plan.with_constant_yaw(POSITION_PATH, 0.4), actual)
    np.testing.assert_array_equal(actual.yaw.times, POSITION_PATH.times[[0, -1]])


def test_minsnap_trajectories_plans_the_same_path_from_exported_waypoints():
    made = minsnap_trajectories.generate_trajectory(minsnap_waypoints(EXAMPLE_PLAN), degree=7, num_continuous_orders=4)
    assert_alike(Plan.with_constant_yaw(POSITION_PATH), minsnap_to_plan(made), atol=1e-9)


def test_an_invalid_trajectory_of_minsnap_trajectories_is_rejected(monkeypatch):
    flat = minsnap_trajectory(EXAMPLE_PLAN)._replace(coefficients=np.zeros((3, 8, 2)))
    with pytest.raises(InputError, match=r"shape \(3, 8, 2\), but must have \(pieces, powers, 3\)"):
        minsnap_to_plan(flat)
    monkeypatch.setitem(sys.modules, "minsnap_trajectories", None)
    with pytest.raises(ImportError, match=r"^minsnap_trajectories is not installed; .*'drake_quad\[minsnap\]'"):
        minsnap_trajectory(EXAMPLE_PLAN)
