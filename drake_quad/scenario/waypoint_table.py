"""Waypoints from a CSV file, as the tree of a scenario that has a route only."""

import csv
import math
import re
from pathlib import Path

from drake_quad.errors import InputError
from drake_quad.scenario.trees import Mark, Tree

_COLUMNS = ("time", "x", "y", "z", "yaw")
_Row = tuple[Mark, list[str]]


def read_waypoint_table(path: Path) -> Tree:
    """Reads a table of waypoints.

    The first row names the columns: x, y and z (m); time (s), if it is given; yaw (rad), empty where it is free.
    Without such a row there are the three columns x, y and z. Empty lines, and those that begin with #, do not count.

    Returns:
        A document with one scenario, called after the file, that has a route of kind `waypoints`.

    Raises:
        InputError: the file cannot be read, or is not such a table.
    """
    rows = _rows(path)
    if not rows:
        raise InputError(f"{path}: holds no waypoints")
    names = [cell.lower() for cell in rows[0][1]]
    if all(_number(name) is not None for name in names):
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
            number = _number(cell)
            if number is None and not (name == "yaw" and not cell):
                raise InputError(f"{mark}: {name} is {cell!r}, but must be a finite number")
            columns[name].append(Tree(number, mark))
    top = Mark(str(path), 1)
    scenario = Tree({"route": Tree(_route(columns, [mark for mark, _ in rows], top), top)}, top)
    return Tree({re.sub(r"[^A-Za-z0-9_.-]", "_", path.stem): scenario}, top)


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


def _rows(path: Path) -> list[_Row]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            rows = [(Mark(str(path), reader.line_num), [cell.strip() for cell in row]) for row in reader]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"{path}: is not a CSV file of UTF-8 text") from None
    return [(mark, cells) for mark, cells in rows if any(cells) and not cells[0].startswith("#")]


def _check_names(names: list[str], mark: Mark) -> None:
    unknown = [name for name in names if name not in _COLUMNS]
    if unknown:
        raise InputError(f"{mark}: the column {unknown[0]!r} is unknown; allowed are {', '.join(_COLUMNS)}")
    for name in ("x", "y", "z"):
        if name not in names:
            raise InputError(f"{mark}: there is no column {name}")
    if len(set(names)) < len(names):
        raise InputError(f"{mark}: two columns have the same name")


def _number(cell: str) -> float | None:
    try:
        number = float(cell)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
