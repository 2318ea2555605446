"""Modelled response of the vehicle to commanded accelerations: a delay in whole ticks, then a first-order lag.

The real response depends on the attitude loop, the rotors, and the filters of the measurements. A single time constant
represents all of them, as in most estimators that are used in flight. Commands that are fed forward together with their
derivatives are not delayed by the attitude loop; their response has a separate time constant.
"""

from typing import NamedTuple

from drake_quad.framework.elementary import exp
from drake_quad.signals import Row


class LagStep(NamedTuple):
    """Step of a first-order lag over one tick.

    Attributes:
        after: acceleration at the end of the tick, m/s².
        speed: integral of the acceleration over the tick, m/s.
        distance: second integral of the acceleration over the tick, m.
    """

    after: Row
    speed: Row
    distance: Row


class AxisCommand(NamedTuple):
    """Commanded acceleration on an axis, or the modelled response to it, m/s².

    Attributes:
        feedback: part that depends on measurements.
        feed_forward: part that depends only on the reference.
    """

    feedback: Row
    feed_forward: Row


def lag_step(before: Row, target: Row, lag: Row, period: float) -> LagStep:
    """Integrate a' = (target - a) / lag exactly over one tick with a constant target.

    Args:
        before: a at the start of the tick, m/s².
        target: target acceleration, m/s².
        lag: time constant, s.
        period: tick period, s.
    """
    fraction = 1.0 - exp(-period / lag)
    offset = before - target
    speed = lag * fraction * offset
    distance = 0.5 * period * period * target + lag * (period * offset - speed)
    return LagStep(before - fraction * offset, period * target + speed, distance)


def response_step(
    before: AxisCommand, command: AxisCommand, lags: AxisCommand, period: float
) -> tuple[AxisCommand, Row, Row]:
    """Return the modelled response at the next tick, and its first (m/s) and second (m) integral over the tick.

    Args:
        before: response at the start of the tick.
        command: command during the tick.
        lags: time constants, s.
        period: tick period, s.
    """
    feedback, feed_forward = (
        lag_step(a, target, lag, period) for a, target, lag in zip(before, command, lags, strict=True)
    )
    after = AxisCommand(feedback.after, feed_forward.after)
    return after, feedback.speed + feed_forward.speed, feedback.distance + feed_forward.distance
