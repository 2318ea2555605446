"""Ctrl-C while a script begins.

What a script imports takes a second or two. Until `run` takes over, an interruption ends it with a sentence; as an
exception, it would come up inside of a library, which might show it, take it for an error of its own, or swallow it.
`command_line` imports this before all that takes long, and scripts import `command_line` first.
"""

import multiprocessing
import os
import signal
import sys
from typing import Any

SENTENCE = "interrupted: nothing was written"


def raise_interruptions() -> None:
    """From now on an interruption is a KeyboardInterrupt, as usual in Python."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_: Any) -> None:
    print(SENTENCE, file=sys.stderr, flush=True)
    os._exit(1)


if multiprocessing.current_process().name == "MainProcess":  # workers leave Ctrl-C to their parent
    signal.signal(signal.SIGINT, _end)
