"""Checks of functions that users pass to the package, and messages about errors in users' Python code."""

import inspect
import os
import sysconfig
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from drake_quad.errors import InputError, shortest_path

_PACKAGE = str(Path(__file__).parent) + os.sep
# The function `run` in this file calls the main function of a command or script. Stack frames in this file are skipped,
# so that the main function does not count as user code that the package calls.
_RUNNER = str(Path(__file__).parent / "command_line" / "running.py")
# Folders of the standard library and of installed packages.
_LIBRARIES = tuple({sysconfig.get_path(name) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib")})

# Libraries that are written in Cython report files that are not installed, such as scipy/spatial/_qhull.pyx.
_CYTHON_SUFFIX = ".pyx"


def takes_one_argument(function: Any) -> bool:
    """Return whether a function accepts a single positional argument; True if its signature is unknown."""
    try:
        inspect.signature(function).bind(None)
    except TypeError:  # also raised for objects that are not callable
        return False
    except ValueError:  # functions implemented in C++ may have no signature
        return True
    return True


def describe_callable(thing: Any) -> str:
    """Return the name and the signature of a function, or the type of another object, without its memory address."""
    if not callable(thing):
        return "None" if thing is None else f"an object of type {type(thing).__name__}"
    name = getattr(thing, "__name__", type(thing).__name__)
    try:
        return f"{name}{inspect.signature(thing)}"
    except (TypeError, ValueError):
        return str(name)


def user_frames(error: BaseException) -> list[traceback.FrameSummary]:
    """Return the stack frames of user code that this package called and that raised an error, outermost first.

    The result skips frames of this package, of installed packages and of the standard library. It also skips the frames
    above the first frame of this package, since they belong to the program that called this package. If one error was
    raised from another, the frames of the original error are returned. The result is empty if no user code is involved.
    """
    for each in _chain(error):
        frames, is_inside = [], False
        for frame in traceback.extract_tb(each.__traceback__):
            if frame.filename == _RUNNER:
                continue
            if frame.filename.startswith(_PACKAGE):
                # A frame that stops at `yield` is a context manager. The next frames belong to the body of its `with`
                # statement, which this package did not call.
                is_inside = is_inside or not (frame.line or "").startswith("yield")
            elif is_inside and not (
                frame.filename.startswith(("<", *_LIBRARIES)) or frame.filename.endswith(_CYTHON_SUFFIX)
            ):
                frames.append(frame)
        if frames:
            return frames
    return []


def describe_error(error: BaseException) -> str:
    """Return the type and the message of an error in one line, with file and line if the user's code raised it.

    An example is "mine.py:12: KeyError: 'gain'". The type is left out for an `InputError`, whose message is a sentence.
    """
    kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
    text = " ".join(f"{kind}{error}".split()).removesuffix(":")
    frames = user_frames(error)
    if isinstance(error, SyntaxError) and error.filename:
        return f"{shortest_path(Path(error.filename))}:{error.lineno}: SyntaxError: {error.msg}"
    return f"{shortest_path(Path(frames[-1].filename))}:{frames[-1].lineno}: {text}" if frames else text


def user_traceback(error: BaseException) -> str:
    """Return the part of a traceback that concerns the user's code, as lines of text; empty if there is none."""
    return "".join(traceback.format_list(user_frames(error))).rstrip("\n")


def _chain(error: BaseException) -> Iterator[BaseException]:
    """Yield an error and all errors that led to it, starting with the original one."""
    chain: list[BaseException] = []
    each: BaseException | None = error
    while each is not None and each not in chain:
        chain.append(each)
        each = each.__cause__ or (None if each.__suppress_context__ else each.__context__)
    return reversed(chain)
