"""How the vehicle is believed to follow commanded accelerations: whole ticks of delay, then a lag of first order.

What carries a command out is more than that: an attitude loop, rotors, a filter in front of what is measured. One time
constant stands for all of them, as in the models of most estimators that fly. What is fed forward with its derivatives
does not wait for the attitude loop, and has a time constant of its own.
"""

from typing import NamedTuple

from drake_quad.framework.elementary import exp
from drake_quad.signals import Row


class Moved(NamedTuple):
    """What a lag of first order does from one tick to the next.

    Attributes:
        after: at the end of the tick, m/s².
        speed: its integral over the tick, m/s.
        distance: its integral, integrated once more, m.
    """

    after: Row
    speed: Row
    distance: Row


class AxisCommand(NamedTuple):
    """A commanded acceleration on an axis, or how the vehicle follows it, m/s².

    Attributes:
        feedback: what depends on measurements.
        feed_forward: what follows from the reference alone.
    """

    feedback: Row
    feed_forward: Row


def lagging(before: Row, target: Row, lag: Row, period: float) -> Moved:
    """A lag a' = (target - a) / lag under a target that is held, exactly.

    Args:
        before: a at the tick, m/s².
        target: m/s².
        lag: time constant, s.
        period: of the ticks, s.
    """
    share = 1.0 - exp(-period / lag)
    off = before - target
    speed = lag * share * off
    distance = 0.5 * period * period * target + lag * (period * off - speed)
    return Moved(before - share * off, period * target + speed, distance)


def responded(
    before: AxisCommand, command: AxisCommand, lags: AxisCommand, period: float
) -> tuple[AxisCommand, Row, Row]:
    """How the vehicle follows a command a tick later, and the velocity (m/s) and distance (m) that it gains.

    Args:
        before: how it follows at the tick.
        command: that is there at the tick.
        lags: time constants, s.
        period: of the ticks, s.
    """
    feedback, feed_forward = (
        lagging(a, target, lag, period) for a, target, lag in zip(before, command, lags, strict=True)
    )
    after = AxisCommand(feedback.after, feed_forward.after)
    return after, feedback.speed + feed_forward.speed, feedback.distance + feed_forward.distance
