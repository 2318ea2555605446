"""Start and end of a command, with its exit status."""

import io
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from drake_quad.command_line.interruption import SENTENCE, raise_interruptions
from drake_quad.command_line.output import remark
from drake_quad.errors import InputError, InputWarning


def _show(otherwise: Callable[..., None], message: Any, category: type[Warning], *where: Any, **options: Any) -> None:
    """Print an `InputWarning` as a remark, and any other warning as Python does."""
    if issubclass(category, InputWarning):
        remark(str(message))
    else:
        otherwise(message, category, *where, **options)


def run(main: Callable[[], None]) -> None:
    """Run a command; if it fails, exit with status 1 for a failed computation and with status 2 for wrong input."""
    raise_interruptions()
    warnings.showwarning = partial(_show, warnings.showwarning)
    with orderly_exit():
        main()


@contextmanager
def orderly_exit() -> Iterator[None]:
    """End the process with a sentence, without a traceback, if the body of a `with` statement fails.

    Inside the statement, printing works for any terminal or file: characters that its encoding lacks are escaped. A
    standard output that cannot be written, such as a file on a full disk, counts as a failure.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # the stream was closed before Python started
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 - for the whole process
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    status: str | int | None = 0
    sentence, exits = "", False
    try:
        yield
    except SystemExit as stop:
        status, exits = stop.code, True
    except InputError as error:
        status, sentence = 2, f"error: {error}"
    except BrokenPipeError:  # the reader of the pipe has ended, so further output is useless
        status = 1
    except MemoryError as error:
        status, sentence = 1, f"failed: {str(error) or 'the memory does not suffice'}"
    except (RuntimeError, OSError) as error:
        status, sentence = 1, f"failed: {error}"
    except KeyboardInterrupt as interruption:
        status, sentence = 1, str(interruption) or SENTENCE
    unwritten = _flushed()
    if unwritten and not status:
        status, sentence = 1, unwritten
    if sentence:
        with suppress(OSError):
            print(sentence, file=sys.stderr)
    if status or exits:
        sys.exit(status)


def _flushed() -> str:
    """Flush the standard output.

    Returns:
        The reason why this fails; empty if it succeeds. The rest of the output is discarded if it fails.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        reason = (error.strerror or str(error)).lower()
        return f"failed: the standard output cannot be written: {reason}"
    return ""
