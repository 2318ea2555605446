"""Names of lines of a listing, taken from the local variables of the formula that is traced."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from drake_quad.framework.symbols import Listing, Symbol

# Local variables of this package's tools are not named after quantities of a formula.
_IGNORED_MODULES = ("drake_quad.framework", "drake_quad.compilation")
# Deepest nesting of records and tuples whose fields are named.
_MAX_DEPTH = 4


@contextmanager
def collect_names(listing: Listing) -> Iterator[dict[int, str]]:
    """Collect the names of local variables of all functions that return while the `with` statement is executed.

    The value is a mapping from lines of the listing to names. If several variables contain a line, the variable of the
    function that returns last determines its name, which is the outermost function. A field of a record has the name
    of the variable, an underscore, and the name of the field.
    """
    names: dict[int, str] = {}

    def collect(name: str, value: Any, depth: int) -> None:
        if value.__class__ is Symbol:
            if value.listing is listing:
                names[value.line] = name
        elif isinstance(value, tuple | list) and depth < _MAX_DEPTH:
            fields = getattr(value, "_fields", None) or range(len(value))
            for field, part in zip(fields, value):
                collect(f"{name}_{field}", part, depth + 1)

    def profile(frame: FrameType, event: str, _: Any) -> None:
        if event == "return" and not str(frame.f_globals.get("__name__", "")).startswith(_IGNORED_MODULES):
            for name, value in frame.f_locals.items():
                if name.isidentifier() and not name.startswith("_"):
                    collect(name, value, 0)

    previous = sys.getprofile()
    sys.setprofile(profile)
    try:
        yield names
    finally:
        sys.setprofile(previous)
