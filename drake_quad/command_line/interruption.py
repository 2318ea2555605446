"""Ctrl-C while a command begins.

The imports of a command take a second. Until `run` takes over, Ctrl-C ends the command with a sentence. As an
exception it would be raised inside a library, which might show it, take it for an error of its own, or swallow it.
`main` has this module imported, by `running`, before everything that takes long. What is loaded only when it is used is
interrupted as the computation is.
"""

import multiprocessing
import os
import signal
import sys
from typing import Any

SENTENCE = "interrupted: nothing was written"


def raise_interruptions() -> None:
    """Make Ctrl-C raise KeyboardInterrupt from now on, which is the default of Python."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_: Any) -> None:
    print(SENTENCE, file=sys.stderr, flush=True)
    os._exit(1)


if multiprocessing.current_process().name == "MainProcess":  # workers leave Ctrl-C to their parent
    signal.signal(signal.SIGINT, _end)
