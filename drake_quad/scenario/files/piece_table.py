"""Reading of the pieces of a trajectory from a CSV file in the format of Crazyswarm2."""

import re
from pathlib import Path

from drake_quad.reference.pieces import AXES, COLUMNS, POWERS
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.number_table import Row, TableFormat, table_rows

# The row of column names may follow empty lines and comments, and may be a comment itself.
_HEADING = re.compile(r"(?:\s*+#(?!\s*+duration\s*+,)[^\n]*+\n)*+\s*+(#?+)\s*+duration\s*+,", re.IGNORECASE)
_FORMAT = TableFormat(
    "pieces",
    COLUMNS,
    f"duration, x^0 to x^{POWERS - 1}, and the same powers of y, z and yaw",
    required=("duration", "x^0", "y^0", "z^0"),
    default=COLUMNS,
)


def is_piece_table(text: str) -> bool:
    """Return whether the text of a CSV file begins with the column names of a table of pieces."""
    return _HEADING.match(text) is not None


def parse_piece_table(text: str, path: Path) -> Tree:
    """Parse a table of pieces as the list `pieces` of a route.

    The first row names the columns, as in `duration,x^0,x^1,...,yaw^7`. It may begin with #, and capital letters are
    allowed. The columns duration, x^0, y^0 and z^0 are required, and other missing columns are zero. Without a row of
    names, the table must have all 33 columns in this order.

    Raises:
        InputError: if the text is not such a table, or has no rows or too many.
    """
    if (heading := _HEADING.match(text)) and heading[1]:
        text = text[: heading.start(1)] + " " + text[heading.end(1) :]
    return Tree([_piece(row) for row in table_rows(text, path, _FORMAT)], Mark(str(path), 1))


def _piece(row: Row) -> Tree:
    mark, numbers = row
    values = dict.fromkeys(COLUMNS, 0.0) | numbers
    fields = {
        axis: Tree([Tree(values[f"{axis}^{power}"], mark) for power in range(POWERS)], mark)
        for axis in AXES
        if any(name.startswith(f"{axis}^") for name in numbers)
    }
    return Tree({"duration": Tree(values["duration"], mark), **fields}, mark)
