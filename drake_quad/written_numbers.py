"""Numbers that people write: in cells of tables, in files and on the command line.

Python's own `float` and `int` also read underscores between digits and the digits of other scripts: "1_0" is 10 to
them, and "١" is 1. In a table or a file these are slips of the pen.
"""


def float_in(text: str) -> float:
    """Return the number that a text holds in ASCII digits; NaN and infinity count as numbers.

    Raises:
        ValueError: the text holds no such number.
    """
    _check(text)
    return float(text)


def int_in(text: str) -> int:
    """Return the whole number that a text holds in ASCII digits.

    Raises:
        ValueError: the text holds no such number.
    """
    _check(text)
    return int(text)


def _check(text: str) -> None:
    if "_" in text or not text.isascii():
        raise ValueError(f"{text!r} is not written in ASCII digits")
