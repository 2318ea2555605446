"""Which moments of inertia a rigid body can have.

About its centre of mass a body has I_xx + I_yy - I_zz = 2 ∫ z² dm, which is not negative; likewise for the other axes.
So no moment is larger than the sum of the other two. A flat plate has as much about its normal.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

# Data sheets and papers give moments to two digits or three, which a flat body may round to a little more.
_ROUNDING = 0.01
_NAMES = ("I_xx", "I_yy", "I_zz")


def inertia_flaw(moments: Sequence[float]) -> str:
    """Return why no rigid body has moments of inertia, in words; empty if one has, up to rounding.

    Args:
        moments: I_xx, I_yy, I_zz, kg m².
    """
    *others, (largest, name) = sorted(zip(moments, _NAMES, strict=True))
    together = sum(moment for moment, _ in others)
    if largest <= (1.0 + _ROUNDING) * together:
        return ""
    names = " + ".join(sorted(other for _, other in others))
    return f"{name}, {largest:.4g}, is larger than {names}, {together:.4g} kg m²"


def nearest_rigid(
    moments: Sequence[ArrayLike],
    lowest: Sequence[float] = (0.0, 0.0, 0.0),
    highest: Sequence[float] | None = None,
) -> np.ndarray:
    """Return the nearest moments of inertia, within bounds, that a rigid body can have: (3,) or (3, N), kg m².

    Moments that a body can have stay as they are, to the bit. Otherwise the largest shrinks and the others grow by as
    much, up to their bounds.

    Args:
        moments: I_xx, I_yy, I_zz, kg m²; each a number or an (N,) array.
        lowest: bounds from below, kg m²; a moment between equal bounds is fixed.
        highest: bounds from above, kg m²; none if not given.
    """
    found = np.array(np.broadcast_arrays(*moments), dtype=float)
    columns = (-1, *[1] * (found.ndim - 1))
    low = np.reshape(lowest, columns)
    high = np.full_like(low, np.inf) if highest is None else np.reshape(highest, columns)
    # In each pass a moment reaches its bound, or nothing is left to do.
    for _ in _NAMES:
        largest = found == found.max(axis=0)
        excess = np.maximum(0.0, 2.0 * found.max(axis=0) - found.sum(axis=0))
        room = np.where(largest, found - low, high - found)
        share = excess / np.maximum((room > 0.0).sum(axis=0), 1)
        found = found + np.where(largest, -1.0, 1.0) * np.minimum(room, share)
    return found
