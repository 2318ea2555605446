"""Error and warning classes for wrong input, and functions that format values, names and paths for messages."""

import difflib
from collections.abc import Iterable, Mapping
from numbers import Integral
from pathlib import Path
from typing import Any, TypeVar

_Entry = TypeVar("_Entry")

# Largest length of a message, in characters. It is long enough for a sentence that contains a long path.
_MAX_MESSAGE_LENGTH = 400


class InputError(ValueError):
    """Error caused by wrong input. The message is one sentence that says what is wrong and what is allowed.

    The message is a single line without control characters. The middle of a very long message is left out.
    """

    def __init__(self, message: str) -> None:
        super().__init__(shorten_text(message, _MAX_MESSAGE_LENGTH))


class InputWarning(UserWarning):
    """Warning about an input that is accepted but probably not intended, in one sentence.

    Commands print it as a remark.
    """


def check_integer(value: Any, name: str, *, minimum: int, maximum: int | None = None) -> int:
    """Return an argument as an int, after checking that it is a whole number within bounds.

    Args:
        value: value of the argument.
        name: name of the argument, for the message.
        minimum: smallest allowed number.
        maximum: largest allowed number; None for no limit.

    Raises:
        InputError: if the value is not a whole number, or is out of bounds.
    """
    bounds = f"at least {minimum}" if maximum is None else f"from {minimum} to {maximum}"
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise InputError(f"{name} is {short_repr(value)}, but must be a whole number, {bounds}")
    number = int(value)
    if number < minimum or (maximum is not None and number > maximum):
        raise InputError(f"{name} is {number}, but must be {bounds}")
    return number


def shortest_path(path: Path) -> Path:
    """Return a path, relative to the working directory if it is inside this directory."""
    folder = Path.cwd()
    return path.relative_to(folder) if path.is_relative_to(folder) else path


def not_connected(port: str, system: Any) -> InputError:
    """Return the error for an input port that has no value although its system needs one.

    Args:
        port: name of the port.
        system: Drake system with the port, or diagram that exports the port.
    """
    # The root of a diagram without a name is called "_", and the classes for other scalar types have a suffix.
    path = str(system.GetSystemPathname()).removeprefix("::_").removeprefix("::").replace("::", "/")
    kind = type(system).__name__.partition("_𝓣")[0]
    place = f"the {kind} {path}" if path else f"the {kind}"
    return InputError(f"the input port `{port}` of {place} is not connected; connect it, or fix its value")


def lookup(table: Mapping[str, _Entry], name: str, kind: str) -> _Entry:
    """Return the entry of a table with a given name.

    Args:
        table: entries by name.
        name: name of the entry.
        kind: noun for an entry in the error message, such as "signal".

    Raises:
        InputError: if the table has no such entry; the message lists similar names, or all names.
    """
    if name in table:
        return table[name]
    hint = did_you_mean(name, table) or f"there are {join_names([*table], 40) or 'none'}"
    raise InputError(f"there is no {kind} called {short_repr(name)}; {hint}")


def did_you_mean(name: Any, names: Iterable[str], max_suggestions: int = 2, *, similarity: float = 0.6) -> str:
    """Return a question with the names that are most similar to a misspelt one, such as "did you mean mass?".

    Args:
        name: misspelt name, which is not one of `names`.
        names: existing names.
        max_suggestions: largest number of suggested names.
        similarity: smallest similarity of a suggested name, from 0 to 1 for equal names.

    Returns:
        The question; empty if no name is similar.
    """
    close = difflib.get_close_matches(str(name), [*names], max_suggestions, similarity)
    return f"did you mean {' or '.join(close)}?" if close else ""


def shorten_text(text: str, max_length: int = 60) -> str:
    """Return a text for a message: unprintable characters are escaped, and the middle of a long text is left out.

    Args:
        text: text of any length, with any characters.
        max_length: largest number of characters that are kept; escaped characters can make the result longer.
    """
    if len(text) > max_length:
        end = (max_length - 3) // 3
        text = f"{text[: max_length - 3 - end]}...{text[-end:]}"
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape", "surrogatepass").decode()
        for character in text
    )


def short_repr(value: Any) -> str:
    """Return the shortened `repr` of a value for a message."""
    return shorten_text(repr(value))


def join_names(names: list[str], max_names: int = 8, *, max_length: int = 60) -> str:
    """Return names separated by commas for a message: the first `max_names`, and the number of further names.

    A name with more than `max_length` characters is shortened.
    """
    num_others = len(names) - max_names
    others = [f"and {num_others} more"] if num_others > 0 else []
    return ", ".join([shorten_text(name, max_length) for name in names[:max_names]] + others)
