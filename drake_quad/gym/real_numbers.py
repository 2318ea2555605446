"""Checks and conversions of the actions, rewards and observations of an environment."""

from typing import Any

import numpy as np

# A larger action indicates an error, such as a network that diverged. Observations may contain recent actions in single
# precision, whose range squares of larger numbers could exceed.
MAX_ACTION = 1e6


def real_numbers(values: Any) -> np.ndarray | None:
    """Return real numbers as an array of floats; None if the values are not real numbers that form an array.

    Text, times and complex numbers are rejected, although NumPy would convert them.
    """
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):
        return None
    return array.astype(float) if np.can_cast(array.dtype, float, "same_kind") else None


def single_precision(numbers: np.ndarray) -> np.ndarray:
    """Return numbers as `float32`; numbers that exceed its range, as of a crashed vehicle, become infinite."""
    with np.errstate(over="ignore"):
        return numbers.astype(np.float32)
