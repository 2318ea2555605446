"""Numbers that go into an environment and come out of it: actions, rewards, observations."""

from typing import Any

import numpy as np

# A larger action is a mistake of what makes it, such as a network that diverges: its square would soon be too large for
# single precision, in which a policy may see its last actions.
MAX_ACTION = 1e6


def real_numbers(values: Any) -> np.ndarray | None:
    """Return real numbers of one shape as an array of floats; None if the values are something else.

    Text, times and complex numbers are something else, although NumPy would convert them.
    """
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):
        return None
    return array.astype(float) if array.dtype.kind in "biuf" else None


def single_precision(numbers: np.ndarray) -> np.ndarray:
    """Return numbers as policies see them; those of a lost vehicle may be too large, and are infinite then."""
    with np.errstate(over="ignore"):
        return numbers.astype(np.float32)
