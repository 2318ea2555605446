"""Metric `settling_time`: time until the position error stays small."""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from drake_quad.framework.elementary import where
from drake_quad.scenario.metrics.metric import metric
from drake_quad.scenario.quantities import FixedPositive
from drake_quad.signals import Reference, Row, State


class SettlingSums(NamedTuple):
    """Times from which the settling time is computed.

    Attributes:
        outside: last time at which the error was too large, s since the first tick; negative if there is none.
        elapsed: time between the first and the present tick, s.
    """

    outside: Row = -1.0
    elapsed: Row = 0.0


def _settled(sums: SettlingSums, ticks: Any, period: float) -> Any:
    """Return the time after which the error stays small, or infinity if it is too large at the last tick."""
    settled = np.where(sums.outside < 0.0, 0.0, sums.outside + period)
    return np.where(sums.outside >= sums.elapsed, math.inf, settled) * np.where(ticks > 0.0, 1.0, np.nan)


@metric("s", initial=SettlingSums(), value=_settled, label="settling time", value_range="nonnegative")
def settling_time(
    sums: SettlingSums,
    state: State,
    reference: Reference,
    ticks: Row,
    period: float,
    *,
    radius: Annotated[FixedPositive, Field(description="largest distance from the reference (m)")] = 0.1,
) -> SettlingSums:
    """Time from the start of the metrics window until the distance from the reference stays below a radius.

    It is infinite if the vehicle is outside the radius at the end of the window.
    """
    elapsed = ticks * period
    x, y, z = state.x - reference.x, state.y - reference.y, state.z - reference.z
    outside = where(x * x + y * y + z * z <= radius * radius, sums.outside, elapsed)
    return SettlingSums(outside, elapsed)
