"""Tests of CSV tables with waypoints."""

import pytest

from drake_quad.errors import InputError
from drake_quad.scenario.files.loading import load_mission


@pytest.fixture
def write(tmp_path):
    def write(text, name="course.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def points(mission):
    return [waypoint.point for waypoint in mission.route.waypoints]


def test_a_waypoint_table_with_three_columns_needs_no_header(write):
    mission = load_mission(write("0,0,1\n\n# a comment\n 1.5 , -2 ,1e0\n"))
    assert mission.name == "course"
    assert points(mission) == [(0.0, 0.0, 1.0), (1.5, -2.0, 1.0)]
    assert mission.route.times.kind == "minimum_time"


def test_columns_have_any_order_and_may_contain_times_and_yaws(write):
    text = "\ufeffyaw, Z,y,x,time\n,1,2,3,0\n0.5,4,5,6,7\n"
    mission = load_mission(write(text, "a course.csv"), ["route.top_speed=3"])
    assert mission.name == "a_course"
    assert points(mission) == [(3.0, 2.0, 1.0), (6.0, 5.0, 4.0)]
    assert mission.route.times.times == (0.0, 7.0)
    assert [waypoint.yaw for waypoint in mission.route.waypoints] == [None, 0.5]
    assert mission.route.heading == "waypoints"
    assert mission.route.top_speed == 3.0


def test_an_override_can_change_an_item_of_a_list(write):
    path = write("0,0,1\n1,0,1\n2,0,1\n")
    mission = load_mission(path, ["route.waypoints.1=[5, 5, 5]", "route.waypoints.2.0=7"])
    assert points(mission) == [(0.0, 0.0, 1.0), (5.0, 5.0, 5.0), (7.0, 0.0, 1.0)]
    words = "override route.waypoints.3=.*: route.waypoints has no item 3; its items are route.waypoints.0 to "
    with pytest.raises(InputError, match=words):
        load_mission(path, ["route.waypoints.3=[5, 5, 5]"])
    with pytest.raises(InputError, match="override route.waypoints.x=1: route.waypoints is .*must be a list"):
        load_mission(path, ["route.waypoints.x=1"])
    with pytest.raises(InputError, match="must be field.path=value"):
        load_mission(path, ["route.top_speed="])


def test_times_may_name_a_timing_method(write):
    mission = load_mission(write("0,0,1\n1,0,1\n"), ["route.times=heuristic"])
    assert mission.route.times.kind == "heuristic"


def test_a_scenario_can_extend_a_waypoint_table(write, diagrams):
    write("0,0,1\n1,0,1\n")
    path = write(f"a:\n  extends: [{diagrams / 'hover.yaml'}, course.csv]\n", "a.yaml")
    assert points(load_mission(path)) == [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "course.csv: contains no waypoints"),
        ("x,y,z\n", "course.csv: contains no waypoints$"),
        ("0,0,1\n", "course.csv:1: route.waypoints is .* at least 2 items"),
        ("0,0\n1,1\n", "course.csv:1: a table with 2 columns needs a first row with their names"),
        ("0,0,1,5\n1,1,1,6\n", "course.csv:1: a table with 4 columns needs a first row with their names"),
        ("x,y,height\n0,0,1\n", "course.csv:1: the column 'height' is unknown; allowed are time, x, y, z, yaw"),
        ("x,y,time\n0,0,1\n", "course.csv:1: the column z"),
        ("x,y,z,x\n0,0,1,2\n", "course.csv:1: two columns have the same name"),
        ("x,y,z\n0,0,1\n0,0\n", "course.csv:3: has 2 cells, but the table has 3 columns"),
        ("x,y,z\n0,0,1\n0,zero,1\n", "course.csv:3: y is 'zero', but must be a finite number"),
        ("x,y,z\n0,0,1\n0,nan,1\n", "course.csv:3: y is 'nan', but must be a finite number"),
        ("x,y,z,time\n0,0,1,\n1,0,1,2\n", "course.csv:2: time is '', but must be a finite number"),
        ("x,y,z,time\n0,0,1,1\n1,0,1,1\n", "course.csv:1: route.times is .* must increase"),
    ],
)
def test_errors_for_invalid_waypoint_tables_give_the_reason(write, text, words):
    with pytest.raises(InputError, match=words):
        load_mission(write(text))


def test_the_error_for_a_binary_file_gives_the_reason(tmp_path):
    path = tmp_path / "course.csv"
    path.write_bytes(b"0,0,1\n\xff\xfe,0,1\n")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        load_mission(path)
    with pytest.raises(InputError, match="cannot be read: no such file"):
        load_mission(tmp_path / "none.csv")


def test_a_table_with_a_very_long_cell_is_refused(write):
    with pytest.raises(InputError, match=r"course\.csv: is not a CSV file"):
        load_mission(write("0,0,1\n" + "1" * 200_000 + ",0,1\n"))
