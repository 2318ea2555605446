"""Metric `command_jerk`: rate of change of the commanded acceleration."""

from typing import Any, NamedTuple

import numpy as np

from drake_quad.framework.elementary import minimum
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.metrics.metric import metric
from drake_quad.signals import Acceleration, Row


class JerkSums(NamedTuple):
    """Sum of squared changes of the commanded acceleration, and the command of the previous tick."""

    squares: Row = 0.0
    last: PerAxis = PerAxis(0.0, 0.0, 0.0)


def _rms_jerk(sums: JerkSums, ticks: Any, period: float) -> Any:
    """Return the root mean square of the change per tick, divided by the tick period."""
    return np.sqrt(sums.squares / np.where(ticks > 1.0, ticks - 1.0, np.nan)) / period


@metric("m/s³", initial=JerkSums(), value=_rms_jerk, label="RMS jerk of the command", value_range="nonnegative")
def command_jerk(sums: JerkSums, acceleration_command: Acceleration, ticks: Row) -> JerkSums:
    """Root mean square of the rate of change of the commanded acceleration."""
    started, squares = minimum(ticks, 1.0), sums.squares
    for u, last in zip(acceleration_command, sums.last, strict=True):
        squares = squares + started * ((u - last) * (u - last))
    return JerkSums(squares, PerAxis(*acceleration_command))
