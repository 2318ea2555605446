"""The error that a person can cause, and how its sentence shows what was written."""

import difflib
from collections.abc import Mapping
from numbers import Integral
from typing import Any, TypeVar

_Entry = TypeVar("_Entry")

# Largest number of characters of an error message, which is a sentence that may contain a long path.
_MOST = 400


class InputError(ValueError):
    """Something that a person wrote is wrong; the message is one sentence that says what and what is allowed.

    It is on one line, without control characters, and its middle is left out if it gets very long.
    """

    def __init__(self, message: str) -> None:
        super().__init__(shortened(message, _MOST))


class InputWarning(UserWarning):
    """Warning about an input that is accepted but probably not intended, in one sentence.

    Commands print it as a remark.
    """


def whole_number(value: Any, name: str, *, least: int, most: int | None = None) -> int:
    """Return a whole number that a caller gave.

    Args:
        value: that was given.
        name: of the argument.
        least: that it may be.
        most: that it may be, if there is a limit.

    Raises:
        InputError: it is none, or out of bounds.
    """
    bounds = f"at least {least}" if most is None else f"from {least} to {most}"
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise InputError(f"{name} is {shown(value)}, but must be a whole number, {bounds}")
    number = int(value)
    if number < least or (most is not None and number > most):
        raise InputError(f"{name} is {number}, but must be {bounds}")
    return number


def entry(table: Mapping[str, _Entry], name: str, kind: str) -> _Entry:
    """Return the entry of a table with a given name.

    Args:
        table: entries by name.
        name: name of the entry.
        kind: kind of the entries for the error message, as in "signal".

    Raises:
        InputError: if the table has no such entry; the message lists similar names, or all names.
    """
    if name in table:
        return table[name]
    close = difflib.get_close_matches(str(name), table, 2)
    hint = f"did you mean {' or '.join(close)}?" if close else f"there are {listed([*table], 40) or 'none'}"
    raise InputError(f"there is no {kind} called {shown(name)}; {hint}")


def shortened(text: str, most: int = 60) -> str:
    """Return a text as part of a sentence: what cannot be printed escaped, and the middle left out if it is too long.

    Args:
        text: of any length, with any characters.
        most: characters that are left of it.
    """
    if len(text) > most:
        end = (most - 3) // 3
        text = f"{text[: most - 3 - end]}...{text[-end:]}"
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape", "surrogatepass").decode() for each in text
    )


def shown(value: Any) -> str:
    """Return a value as part of a sentence."""
    return shortened(repr(value))


def listed(names: list[str], most: int = 8) -> str:
    """Names as part of a sentence, the first of them if there are many."""
    more = len(names) - most
    return ", ".join([shortened(name) for name in names[:most]] + ([f"and {more} more"] if more > 0 else []))
