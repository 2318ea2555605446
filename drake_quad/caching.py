"""A cache that threads share."""

import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class ThreadSafeCache(Generic[Value]):
    """Values by key, each made once in a process, whatever number of threads asks for it.

    `functools.cache` calls its function in every thread that asks before the first one is done, and keeps one of the
    results. That is enough for plain values that are cheap to compute. It is wrong for values that own foreign memory,
    such as machine code, and it is wasteful for values that take seconds.

    A value that is there is returned without waiting. While a thread makes a value, other threads that need to make
    one wait for it, also for another key. A value may be made of other values of the same cache.

    Args:
        max_values: number of values that are kept; the oldest is dropped for a new one. Unlimited if not given.
    """

    def __init__(self, max_values: int | None = None) -> None:
        self._max_values = max_values
        self._values: dict[Hashable, Value] = {}
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._values)

    def clear(self) -> None:
        """Drop all values."""
        with self._lock:
            self._values.clear()

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the value of a key, which `make` makes if there is none; what `make` raises is not kept."""
        try:
            return self._values[key]
        except KeyError:
            pass
        with self._lock:
            if key not in self._values:
                value = make()
                if self._max_values is not None and len(self._values) >= self._max_values:
                    del self._values[next(iter(self._values))]
                self._values[key] = value
            return self._values[key]
