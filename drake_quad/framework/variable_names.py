"""Names for the lines of a listing, taken from the local variables of the traced formula."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from drake_quad.framework.symbols import Listing, Symbol

# Local variables of these packages do not name quantities of a formula, so they are ignored.
_IGNORED_MODULES = ("drake_quad.framework", "drake_quad.compilation")
# Deepest nesting of records and tuples whose fields are named.
_MAX_DEPTH = 4


@contextmanager
def collect_names(listing: Listing) -> Iterator[dict[int, str]]:
    """Collect the local variable names of all functions that return during the `with` statement.

    The `with` statement yields a mapping from line numbers of the listing to names. If variables of several functions
    contain the result of the same line, the name comes from the function that returns last, which is the outermost
    function. The name of a record's field consists of the variable's name, an underscore, and the field's name.
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
