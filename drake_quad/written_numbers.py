"""Strict conversion of text to numbers, for table cells, files and the command line.

Python's `float` and `int` also accept underscores between digits and digits of other scripts: they read "1_0" as 10
and "١" as 1. In a table or a file such text is more likely a typing error.
"""


def float_in(text: str) -> float:
    """Return the number that a text represents in ASCII digits; NaN and infinity count as numbers.

    Raises:
        ValueError: if the text does not represent a number in ASCII digits.
    """
    _check(text)
    return float(text)


def int_in(text: str) -> int:
    """Return the integer that a text represents in ASCII digits.

    Raises:
        ValueError: if the text does not represent an integer in ASCII digits.
    """
    _check(text)
    return int(text)


def _check(text: str) -> None:
    if "_" in text or not text.isascii():
        raise ValueError(f"{text!r} is not written in ASCII digits")
