"""Handling of Ctrl-C while a command loads its libraries.

The imports of a command take about a second. During this time, Ctrl-C must not raise KeyboardInterrupt, because a
library that is being imported might print the exception, suppress it, or convert it to another error. Instead, the
process ends at once with a message. Python's default behaviour is restored before the command runs.
"""

import multiprocessing
import os
import signal
import sys
from typing import Any

INTERRUPTION_MESSAGE = "interrupted: no file was written"


def raise_interruptions() -> None:
    """Make Ctrl-C raise KeyboardInterrupt, which is Python's default."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _exit_at_once(*_: Any) -> None:
    print(INTERRUPTION_MESSAGE, file=sys.stderr, flush=True)
    os._exit(1)


if multiprocessing.current_process().name == "MainProcess":  # worker processes are ended by their parent
    signal.signal(signal.SIGINT, _exit_at_once)
