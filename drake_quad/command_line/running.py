"""How a command runs and ends."""

import os
import sys
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

from drake_quad.command_line.interruption import SENTENCE, raise_interruptions
from drake_quad.command_line.output import remark
from drake_quad.errors import InputError, InputWarning


def _show(otherwise: Callable[..., None], message: Any, category: type[Warning], *where: Any, **options: Any) -> None:
    """Print what is said of an input as a remark, and any other warning as Python does."""
    if issubclass(category, InputWarning):
        remark(str(message))
    else:
        otherwise(message, category, *where, **options)


def run(main: Callable[[], None]) -> None:
    """Runs a command and exits: with 0 if all went well, 1 if the computation failed, 2 if the input was wrong.

    An error is told in one sentence.
    """
    raise_interruptions()
    warnings.showwarning = partial(_show, warnings.showwarning)
    try:
        main()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nobody reads what would still be printed
        sys.exit(1)
    except (RuntimeError, OSError) as error:
        print(f"failed: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt as interruption:
        print(str(interruption) or SENTENCE, file=sys.stderr)
        sys.exit(1)
