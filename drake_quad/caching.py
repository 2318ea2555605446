"""Cache that is safe to share between threads."""

import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class ThreadSafeCache(Generic[Value]):
    """Cache whose values are each computed once per process, however many threads request them.

    `functools.cache` calls its function in every thread that asks before the first call has returned, and keeps one of
    the results. That suffices for plain values that are cheap to compute. It is wrong for values that own foreign
    memory, such as machine code, and it is wasteful for values that take seconds.

    Reading a cached value never waits. While one thread computes a value, other threads that have to compute one wait,
    even if the keys differ. The computation of a value may use other values of the same cache.

    Args:
        max_values: largest number of cached values, above which a new value replaces the oldest one; unlimited if not
            given.
    """

    def __init__(self, max_values: int | None = None) -> None:
        self._max_values = max_values
        self._values: dict[Hashable, Value] = {}
        self._lock = threading.RLock()

    def __len__(self) -> int:
        return len(self._values)

    def clear(self) -> None:
        """Delete all values."""
        with self._lock:
            self._values.clear()

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the value of a key, which `make` computes if it is not cached; its exceptions are not cached."""
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
