"""How a command runs and ends."""

import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drake_quad.command_line.interruption import SENTENCE, raise_interruptions
from drake_quad.errors import InputError


def run(main: Callable[[], None]) -> None:
    """Run a command and exit if it fails: with 1 if the computation failed, with 2 if the input was wrong."""
    raise_interruptions()
    with orderly_exit():
        main()


@contextmanager
def orderly_exit() -> Iterator[None]:
    """Have whatever goes wrong inside a `with` statement end the process with a sentence and without a traceback.

    Whatever is printed inside is printed to any terminal or file: a character that its encoding lacks is escaped. A
    standard output that cannot be written, such as a file on a full disk, is a failure, too.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # it was closed before Python began
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
    except BrokenPipeError:  # nobody reads what would still be printed
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
    """Write out what was printed; return why that is not possible, and forget what is left."""
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        reason = (error.strerror or str(error)).lower()
        return f"failed: the standard output cannot be written: {reason}"
    return ""
