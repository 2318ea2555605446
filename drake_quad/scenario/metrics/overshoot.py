"""Metric `overshoot`: largest error beyond the reference after a disturbance."""

from typing import Any, NamedTuple

import numpy as np

from drake_quad.framework.elementary import maximum, sqrt, where
from drake_quad.scenario.metrics.metric import metric
from drake_quad.signals import Reference, Row, State


class OvershootSums(NamedTuple):
    """Position error at the first tick, and the largest error in the opposite direction.

    Attributes:
        x: X component of the position error at the first tick, m.
        y: Y component of the position error at the first tick, m.
        z: Z component of the position error at the first tick, m.
        opposite: largest later error component in the direction opposite to the error at the first tick, m.
    """

    x: Row = 0.0
    y: Row = 0.0
    z: Row = 0.0
    opposite: Row = 0.0


def _opposite(sums: OvershootSums, ticks: Any, _: float) -> Any:
    """Return the largest error in the direction opposite to the initial error, or NaN if there are no ticks."""
    return np.where(ticks > 0.0, sums.opposite, np.nan)


@metric("m", initial=OvershootSums(), value=_opposite, value_range="nonnegative")
def overshoot(sums: OvershootSums, state: State, reference: Reference, ticks: Row) -> OvershootSums:
    """Largest position error in the direction opposite to the error at the start of the metrics window."""
    x, y, z = state.x - reference.x, state.y - reference.y, state.z - reference.z
    started = ticks > 0.0
    x_0, y_0, z_0 = where(started, sums.x, x), where(started, sums.y, y), where(started, sums.z, z)
    size = sqrt(x_0 * x_0 + y_0 * y_0 + z_0 * z_0)
    along = where(size > 0.0, x * x_0 + y * y_0 + z * z_0, 0.0) / where(size > 0.0, size, 1.0)
    return OvershootSums(x_0, y_0, z_0, maximum(sums.opposite, -along))
