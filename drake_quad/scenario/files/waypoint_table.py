"""Waypoints from a CSV file, as the tree of a scenario that has a route only."""

import csv
import io
import math
import re
from collections.abc import Iterator
from pathlib import Path

from drake_quad.errors import InputError, shown
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.limits import MOST_WAYPOINTS
from drake_quad.written_numbers import float_in

_COLUMNS = ("time", "x", "y", "z", "yaw")
_Row = tuple[Mark, list[str]]


def parse_waypoint_table(text: str, path: Path) -> Tree:
    """Parses a table of waypoints.

    The first row names the columns: x, y and z (m); time (s), if it is given; yaw (rad), empty where it is free.
    Without such a row there are the three columns x, y and z. Empty lines, and those that begin with #, do not count.

    Args:
        text: of the file.
        path: of the file.

    Returns:
        A document with one scenario, called after the file, that has a route of kind `waypoints`.

    Raises:
        InputError: the text is not such a table, or has too many rows.
    """
    file = Mark(str(path), 0)
    rows = list(table_rows(text, file, "waypoints"))
    if not rows:
        raise InputError(f"{file}: holds no waypoints")
    names = [cell.lower() for cell in rows[0][1]]
    if all(number_in(name) is not None for name in names):
        if len(names) != 3:
            raise InputError(f"{rows[0][0]}: {len(names)} columns need a first row that names them: x, y, z, time, yaw")
        names = ["x", "y", "z"]
    else:
        _check_names(names, rows[0][0])
        rows = rows[1:]
    columns: dict[str, list[Tree]] = {name: [] for name in names}
    for mark, cells in rows:
        if len(cells) != len(names):
            raise InputError(f"{mark}: has {len(cells)} cells, but there are {len(names)} columns")
        for name, cell in zip(names, cells, strict=True):
            number = number_in(cell)
            if number is None and not (name == "yaw" and not cell):
                raise InputError(f"{mark}: {name} is {shown(cell)}, but must be a finite number")
            columns[name].append(Tree(number, mark))
    top = Mark(str(path), 1)
    scenario = Tree({"route": Tree(_route(columns, [mark for mark, _ in rows], top), top)}, top)
    return Tree({name_of(path): scenario}, top)


def name_of(path: Path) -> str:
    """What the scenario of a table is called."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", path.stem)


def _route(columns: dict[str, list[Tree]], marks: list[Mark], top: Mark) -> dict[str, Tree]:
    route = {"kind": Tree("waypoints", top)}
    points = [
        Tree(list(point), mark) for *point, mark in zip(columns["x"], columns["y"], columns["z"], marks, strict=True)
    ]
    yaws = columns.get("yaw", [])
    if any(yaw.value is not None for yaw in yaws):
        route["heading"] = Tree("waypoints", top)
        points = [
            Tree({"point": point, "yaw": yaw}, point.mark) if yaw.value is not None else point
            for point, yaw in zip(points, yaws, strict=True)
        ]
    route["waypoints"] = Tree(points, top)
    if "time" in columns:
        route["times"] = Tree(columns["time"], top)
    return route


def table_rows(text: str, file: Mark, what: str) -> Iterator[_Row]:
    """The cells of each row with where it is, without empty lines and those that begin with #.

    Args:
        text: of a CSV file.
        file: what errors call it.
        what: stands in a row.

    Raises:
        InputError: it is not CSV, or has too many rows.
    """
    reader = csv.reader(io.StringIO(text, newline=""))
    count = 0
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if not any(cells) or cells[0].startswith("#"):
                continue
            mark = file._replace(line=reader.line_num)
            count += 1
            if count > MOST_WAYPOINTS + 1:  # the names of the columns are a row
                raise InputError(f"{mark}: there are too many rows: a route may have {MOST_WAYPOINTS:,} {what}")
            yield mark, cells
    except csv.Error:
        raise InputError(f"{file}: is not a CSV file") from None


def _check_names(names: list[str], mark: Mark) -> None:
    unknown = [name for name in names if name not in _COLUMNS]
    if unknown:
        raise InputError(f"{mark}: the column {shown(unknown[0])} is unknown; allowed are {', '.join(_COLUMNS)}")
    for name in ("x", "y", "z"):
        if name not in names:
            raise InputError(f"{mark}: there is no column {name}")
    if len(set(names)) < len(names):
        raise InputError(f"{mark}: two columns have the same name")


def number_in(cell: str) -> float | None:
    """Return the number in a cell; None if the cell does not contain a finite number."""
    try:
        number = float_in(cell)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
