"""Cache that is safe to share between threads."""

import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class ThreadSafeCache(Generic[Value]):
    """Cache that computes each value only once per process, even if several threads request it at the same time.

    If several threads request a value before it is cached, `functools.cache` computes it in each of them and keeps only
    one result. This wastes time if a value takes seconds to compute, and is wrong for values that own memory outside
    Python, such as machine code.

    Reading a cached value never waits. Only one thread computes a value at a time: other threads that need to compute a
    value wait, even if the keys differ. The computation of a value may use other values of the same cache.

    Args:
        max_values: largest number of cached values; a further value replaces the oldest one. None for no limit.
    """

    def __init__(self, max_values: int | None = None) -> None:
        self._max_values = max_values
        self._values: dict[Hashable, Value] = {}
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._values)

    def clear(self) -> None:
        """Delete all values from the cache."""
        with self._lock:
            self._values.clear()

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the cached value of a key, or compute it with `make` and cache it. Exceptions are not cached."""
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
