"""Checks and conversions of the actions, rewards and observations of an environment."""

from typing import Any

import numpy as np

# Largest accepted absolute value of an action. A larger action indicates an error, such as a diverged network.
# Observations may contain recent actions in single precision, and the squares of much larger numbers could exceed its
# range.
MAX_ACTION = 1e6


def real_numbers(values: Any) -> np.ndarray | None:
    """Return an array of floats; None if the values are not real numbers or do not form an array.

    Text, times and complex numbers are rejected, although NumPy could convert them, and so are masked values.
    """
    if isinstance(values, np.ma.MaskedArray):
        return None
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):
        return None
    if not np.can_cast(array.dtype, float, "same_kind"):
        return None
    with np.errstate(over="ignore"):  # numbers beyond the range of a float become infinite, and are rejected later
        return array.astype(float)


def single_precision(numbers: np.ndarray) -> np.ndarray:
    """Return numbers as `float32`. Numbers that exceed its range, as for a crashed vehicle, become infinite."""
    with np.errstate(over="ignore"):
        return numbers.astype(np.float32)
