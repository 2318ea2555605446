"""Reading of waypoints from a CSV file, as the document of a scenario that only has a route."""

import re
from pathlib import Path

from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.number_table import Row, TableFormat, table_rows

_AXES = ("x", "y", "z")
_FORMAT = TableFormat(
    "waypoints", ("time", *_AXES, "yaw"), "time, x, y, z, yaw", required=_AXES, default=_AXES, optional=("yaw",)
)


def parse_waypoint_table(text: str, path: Path) -> Tree:
    """Parse a table of waypoints.

    The first row names the columns. x, y and z (m) are required, time (s) and yaw (rad) are optional, and the cell of a
    free yaw is empty. Without a row of names, the table must have the three columns x, y and z.

    Returns:
        A document with one scenario that has the name of the file and a route of kind `waypoints`.

    Raises:
        InputError: if the text is not such a table, or has no rows or too many.
    """
    rows, top = table_rows(text, path, _FORMAT), Mark(str(path), 1)
    route = {"kind": Tree("waypoints", top), "waypoints": Tree([_waypoint(row) for row in rows], top)}
    if any(numbers.get("yaw") is not None for _, numbers in rows):
        route["heading"] = Tree("waypoints", top)
    if "time" in rows[0][1]:
        route["times"] = Tree([Tree(numbers["time"], mark) for mark, numbers in rows], top)
    return Tree({scenario_name(path): Tree({"route": Tree(route, top)}, top)}, top)


def scenario_name(path: Path) -> str:
    """Return the name of the scenario in a table, which follows from the name of the file."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", path.stem)


def _waypoint(row: Row) -> Tree:
    mark, numbers = row
    point, yaw = Tree([Tree(numbers[axis], mark) for axis in _AXES], mark), numbers.get("yaw")
    return point if yaw is None else Tree({"point": point, "yaw": Tree(yaw, mark)}, mark)
