"""Condition on the moments of inertia of a rigid body.

For a rigid body, I_xx + I_yy - I_zz = 2 ∫ z² dm is not negative. The same holds for the other axes. No moment is
therefore larger than the sum of the other two. The moment about the normal axis of a flat plate equals this sum.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

# Data sheets and papers round moments to two or three digits, so the published moments of a flat body may slightly
# violate the condition.
_SUM_TOLERANCE = 0.01
_MOMENT_NAMES = ("I_xx", "I_yy", "I_zz")


def explain_invalid_inertia(moments: Sequence[float]) -> str:
    """Return the reason why no rigid body has these moments of inertia, within 1 %; empty if they are possible.

    Args:
        moments: I_xx, I_yy, I_zz, kg m².
    """
    *others, (largest, name) = sorted(zip(moments, _MOMENT_NAMES, strict=True))
    sum_of_others = sum(moment for moment, _ in others)
    if largest <= (1.0 + _SUM_TOLERANCE) * sum_of_others:
        return ""
    names = " + ".join(sorted(other for _, other in others))
    return f"{name}, {largest:.4g}, is larger than {names}, {sum_of_others:.4g} kg m²"


def nearest_rigid_inertia(
    moments: Sequence[ArrayLike],
    lowest: Sequence[ArrayLike] = (0.0, 0.0, 0.0),
    highest: Sequence[ArrayLike] | None = None,
) -> np.ndarray:
    """Return the nearest moments of inertia, within bounds, that a rigid body can have.

    Moments that a rigid body can have are returned unchanged. Otherwise the largest moment is decreased and the other
    two are increased by the same amount, up to their bounds.

    Args:
        moments: I_xx, I_yy, I_zz, each a number or an (N,) array, kg m².
        lowest: lower bounds, each a number or an (N,) array, kg m²; equal lower and upper bounds fix a moment.
        highest: upper bounds, each a number or an (N,) array, kg m²; unbounded if not given.

    Returns:
        (3,) or (3, N) moments, kg m².
    """
    shape = np.broadcast_shapes(*map(np.shape, moments))
    nearest, low, high = (
        np.array([np.broadcast_to(each, shape) for each in values], dtype=float)
        for values in (moments, lowest, [np.inf] * len(moments) if highest is None else highest)
    )
    # Each pass either removes the excess or moves one more moment to its bound, so three passes suffice.
    for _ in _MOMENT_NAMES:
        largest = nearest == nearest.max(axis=0)
        excess = np.maximum(0.0, 2.0 * nearest.max(axis=0) - nearest.sum(axis=0))
        room = np.where(largest, nearest - low, high - nearest)
        fraction = excess / np.maximum((room > 0.0).sum(axis=0), 1)
        nearest = nearest + np.where(largest, -1.0, 1.0) * np.minimum(room, fraction)
    return nearest
