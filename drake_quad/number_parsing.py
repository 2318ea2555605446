"""Strict conversion of texts to numbers, for table cells, files and the command line.

Python's `float` and `int` also accept underscores between digits and digits of other scripts: they read "1_0" as 10
and "١" as 1. In a table or a file, such a text is probably a mistake.
"""


def parse_float(text: str) -> float:
    """Convert a text in ASCII digits to a number, which may be NaN or infinite.

    Raises:
        ValueError: if the text does not represent a number in ASCII digits.
    """
    _check(text)
    return float(text)


def parse_int(text: str) -> int:
    """Convert a text in ASCII digits to an integer.

    Raises:
        ValueError: if the text does not represent an integer in ASCII digits.
    """
    _check(text)
    return int(text)


def _check(text: str) -> None:
    if "_" in text or not text.isascii():
        raise ValueError(f"{text!r} is not written in ASCII digits")
