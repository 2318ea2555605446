"""Process-wide settings that the library changes temporarily.

A `with` statement such as `with single_threaded_blas():` changes a setting, and restores it when the statement ends.
"""

import functools
import gc
import io
import logging
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

from threadpoolctl import ThreadpoolController

_STDERR_DESCRIPTOR = 2  # file descriptor of the standard error stream


class ProcessSetting:
    """Context manager that changes a process-wide setting while at least one thread is inside it.

    The first thread to enter changes the setting and the last thread to leave restores it. If each thread saved and
    restored the setting itself, threads that overlap in time could leave the setting changed forever.

    Args:
        change: function that returns a context manager, which changes the setting and restores it on exit.
    """

    def __init__(self, change: Callable[[], AbstractContextManager[Any]]) -> None:
        self._change = change
        self._lock = threading.Lock()
        self._num_users = 0
        self._changed: AbstractContextManager[Any]

    @contextmanager
    def __call__(self) -> Iterator[None]:
        """Return a context manager for a `with` statement, inside which the setting is changed."""
        with self._lock:
            if not self._num_users:
                self._changed = self._change()
                self._changed.__enter__()
            self._num_users += 1
        try:
            yield
        finally:
            with self._lock:
                self._num_users -= 1
                if not self._num_users:
                    self._changed.__exit__(None, None, None)


@functools.cache
def _blas_controller() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def _drake_warnings_only() -> Iterator[None]:
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)


@contextmanager
def _garbage_collection_paused() -> Iterator[None]:
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def current_processor() -> int:
    """Return the number of the processor on which the calling thread runs; requires Linux."""
    # The name of the program, in parentheses, may contain spaces. The fields after it begin with field 3.
    fields = Path("/proc/thread-self/stat").read_text().rpartition(")")[2].split()
    return int(fields[39 - 3])


@contextmanager
def on_processor(number: int) -> Iterator[None]:
    """Run the calling thread, and the processes that it starts, on one processor; requires Linux."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {number})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


single_threaded_blas = ProcessSetting(lambda: _blas_controller().limit(limits=1, user_api="blas"))
"""Restriction of BLAS to one thread; on small matrices, two threads can take a hundred times as long."""

without_drake_remarks = ProcessSetting(_drake_warnings_only)
"""Log level at which Drake logs warnings and errors, but neither solver progress nor server addresses."""


without_prints = ProcessSetting(lambda: redirect_stdout(io.StringIO()))
"""Redirection that discards everything that Python prints on the standard output."""


@contextmanager
def _error_output_discarded() -> Iterator[None]:
    original, null = os.dup(_STDERR_DESCRIPTOR), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, _STDERR_DESCRIPTOR)
        yield
    finally:
        os.dup2(original, _STDERR_DESCRIPTOR)
        os.close(original)
        os.close(null)


without_error_output = ProcessSetting(_error_output_discarded)
"""Redirection that discards the standard error output of the process, including the output of compiled libraries."""

without_warnings = ProcessSetting(lambda: warnings.catch_warnings(action="ignore"))
"""Filter that hides Python's warnings."""

without_garbage_collection = ProcessSetting(_garbage_collection_paused)
"""Pause of Python's garbage collector, which can take a third of the time of code that creates many small objects."""
