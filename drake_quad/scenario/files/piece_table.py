"""A trajectory from a CSV file of pieces, as Crazyswarm2 reads it."""

import re
from pathlib import Path

from drake_quad.errors import InputError, shown
from drake_quad.reference.pieces import AXES, COLUMNS, POWERS
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.waypoint_table import number_in, table_rows

# Behind empty lines and those that begin with # and are no heading themselves.
_HEADING = re.compile(r"(?:\s*+#(?!\s*+duration\s*+,)[^\n]*+\n)*+\s*+(#?+)\s*+duration\s*+,", re.IGNORECASE)


def is_piece_table(text: str) -> bool:
    """Does a CSV file begin with the names of the columns of pieces?"""
    return _HEADING.match(text) is not None


def parse_piece_table(text: str, path: Path) -> Tree:
    """Parses a table of pieces as the list `pieces` of a route.

    The first row names the columns, as in `duration,x^0,x^1,...,yaw^7`, also behind a # and with capitals. Duration and
    constants of x, y and z must be there, what else is not there is zero. Without such a row there are all 33 columns
    in this order. Empty lines, empty cells at the end of a row, and lines that begin with # do not count.

    Args:
        text: of the file.
        path: of the file.

    Raises:
        InputError: the text is not such a table, or has too many rows.
    """
    file = Mark(str(path), 0)
    if (heading := _HEADING.match(text)) and heading[1]:
        text = text[: heading.start(1)] + " " + text[heading.end(1) :]
    rows = list(table_rows(text, file, "pieces"))
    if not rows:
        raise InputError(f"{file}: holds no pieces of a trajectory")
    top, names = rows[0][0], [cell.lower() for cell in _without_empty_end(rows[0][1])]
    if all(number_in(name) is not None for name in names):
        if len(names) != len(COLUMNS):
            raise InputError(f"{top}: {len(names)} columns need a first row that names them: duration, x^0, x^1, ...")
        names = [*COLUMNS]
    else:
        _check_names(names, top)
        rows = rows[1:]
    if not rows:
        raise InputError(f"{file}: holds no pieces of a trajectory")
    return Tree([_piece(names, _without_empty_end(cells), mark) for mark, cells in rows], top)


def _piece(names: list[str], cells: list[str], mark: Mark) -> Tree:
    if len(cells) != len(names):
        raise InputError(f"{mark}: has {len(cells)} cells, but there are {len(names)} columns")
    values = dict.fromkeys(COLUMNS, 0.0)
    for name, cell in zip(names, cells, strict=True):
        number = number_in(cell)
        if number is None:
            raise InputError(f"{mark}: {name} is {shown(cell)}, but must be a finite number")
        values[name] = number
    fields = {
        axis: Tree([Tree(values[f"{axis}^{power}"], mark) for power in range(POWERS)], mark)
        for axis in AXES
        if any(name.startswith(f"{axis}^") for name in names)
    }
    return Tree({"duration": Tree(values["duration"], mark), **fields}, mark)


def _without_empty_end(cells: list[str]) -> list[str]:
    last = max((i for i, cell in enumerate(cells) if cell), default=-1)
    return cells[: last + 1]


def _check_names(names: list[str], mark: Mark) -> None:
    unknown = [name for name in names if name not in COLUMNS]
    if unknown:
        allowed = f"duration, x^0 to x^{POWERS - 1}, and likewise for y, z and yaw"
        raise InputError(f"{mark}: the column {shown(unknown[0])} is unknown; allowed are {allowed}")
    for name in ("duration", "x^0", "y^0", "z^0"):
        if name not in names:
            raise InputError(f"{mark}: there is no column {name}")
    if len(set(names)) < len(names):
        raise InputError(f"{mark}: two columns have the same name")
