"""Start and end of a command, with its error messages and exit status."""

import io
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from drake_quad.command_line.interruption import INTERRUPTION_MESSAGE, raise_interruptions
from drake_quad.command_line.output import remark
from drake_quad.errors import InputError, InputWarning
from drake_quad.extras import MissingLibraryError
from drake_quad.user_code import describe_error, user_traceback


def _show_warning(
    default: Callable[..., None], message: Any, category: type[Warning], *where: Any, **options: Any
) -> None:
    """Print an `InputWarning` as a remark, and any other warning as Python does."""
    if issubclass(category, InputWarning):
        remark(str(message))
    else:
        default(message, category, *where, **options)


def run(main: Callable[[], None]) -> None:
    """Run a command; exit with status 1 if the computation fails, and with status 2 if the input is wrong.

    The input includes the user's own Python code.
    """
    raise_interruptions()
    warnings.showwarning = partial(_show_warning, warnings.showwarning)
    with orderly_exit():
        main()


@contextmanager
def orderly_exit() -> Iterator[None]:
    """End the process with a message and no traceback if the body of a `with` statement fails.

    If the user's own Python code raised the error, the message includes the traceback of this code.

    Inside the statement, characters that the encoding of a terminal or file does not contain are printed as escape
    sequences. If the standard output cannot be written, for example to a full disk, the command fails.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # the stream was closed before Python started
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 - for the whole process
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    status: str | int | None = 0
    message, has_exited = "", False
    try:
        yield
    except SystemExit as stop:
        status, has_exited = stop.code, True
    except (InputError, MissingLibraryError) as error:
        status, message = 2, "\n".join(filter(None, [f"error: {error}", user_traceback(error)]))
    except BrokenPipeError:  # the process that reads the pipe has ended, so a message would not be read
        status = 1
    except MemoryError as error:
        status, message = 1, f"failed: {str(error) or 'not enough memory'}"
    except Exception as error:
        if trace := user_traceback(error):
            status, message = 2, f"error: {describe_error(error)}\n{trace}"
        elif isinstance(error, RuntimeError | OSError):
            status, message = 1, f"failed: {error}"
        else:
            raise
    except KeyboardInterrupt as interruption:
        status, message = 1, str(interruption) or INTERRUPTION_MESSAGE
    output_error = _flush_error()
    if output_error and not status:
        status, message = 1, output_error
    if message:
        with suppress(OSError):
            print(message, file=sys.stderr)
    if status or has_exited:
        sys.exit(status)


def _flush_error() -> str:
    """Flush the standard output. If this fails, discard the rest of the output.

    Returns:
        The error message; empty if the output has been written.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        reason = (error.strerror or str(error)).lower()
        return f"failed: cannot write to the standard output: {reason}"
    return ""
