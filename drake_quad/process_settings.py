"""Settings of the whole process that the library changes for a while.

Each is changed inside a `with` statement, as in `with single_threaded_blas():`.
"""

import functools
import io
import logging
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, redirect_stdout
from typing import Any

from threadpoolctl import ThreadpoolController


class ProcessSetting:
    """A setting of the whole process that is changed as long as any thread needs the change.

    The first thread to enter changes the setting and the last one to leave restores it. If each thread saved and
    restored the setting by itself, threads that overlap could leave it changed for ever.

    Args:
        change: returns a context manager that changes the setting, and restores it at its end.
    """

    def __init__(self, change: Callable[[], AbstractContextManager[Any]]) -> None:
        self._change = change
        self._lock = threading.Lock()
        self._num_users = 0
        self._changed: AbstractContextManager[Any]

    @contextmanager
    def __call__(self) -> Iterator[None]:
        """Have the setting changed inside a `with` statement."""
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
def _linear_algebra() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def _drake_at_warning() -> Iterator[None]:
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)


single_threaded_blas = ProcessSetting(lambda: _linear_algebra().limit(limits=1, user_api="blas"))
"""One thread for linear algebra: with a few numbers, two threads take up to a hundred times as long."""

without_drake_remarks = ProcessSetting(_drake_at_warning)
"""Drake logs warnings and errors only, not what its solvers tried and where its servers listen."""

without_prints = ProcessSetting(lambda: redirect_stdout(io.StringIO()))
"""Nothing is printed to the standard output."""

without_warnings = ProcessSetting(lambda: warnings.catch_warnings(action="ignore"))
"""Python's warnings are not shown."""
