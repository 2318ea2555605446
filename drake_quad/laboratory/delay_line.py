"""Whole ticks of delay for a sampled signal."""

from typing import Any, NamedTuple

from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import FleetSystem, StateGroup
from drake_quad.signals import Row


class DelayLine(NamedTuple):
    """The states of a system in which a signal waits for its time.

    What is sampled at a tick is out `delay` ticks later, and stays out until the next one is:

        tick            0          1          2
        sampled         u₀         u₁         u₂
        1 tick of delay initial    u₀         u₁

    Attributes:
        out: what is out.
        under_way: a tuple of the last samples, the newest first; an empty tuple where there can be no delay.
    """

    out: StateGroup
    under_way: Any


def declare_delay_line(system: FleetSystem, name: str, initial: Any, longest: int) -> DelayLine:
    """Declares the states of a delay line.

    Args:
        system: that they are declared in.
        name: of what is out; what is under way is called after it.
        initial: a recipe for the record that is out before the first sample is.
        longest: delay that there will ever be, in ticks.
    """
    out = system.state(name, initial)
    waiting = system.state(f"{name}_under_way", lambda numbers: (initial(numbers),) * longest) if longest else ()
    return DelayLine(out, waiting)


def newest(out: Any, under_way: tuple[Any, ...]) -> Any:
    """What was sampled last."""
    for sample in under_way:
        return sample
    return out


def carried(sample: Any, under_way: tuple[Any, ...], delay: Row) -> tuple[Any, tuple[Any, ...]]:
    """What a delay line holds a tick later: what is out, and what is under way if there can be a delay.

    Args:
        sample: a record, taken at this tick.
        under_way: the last samples, the newest first.
        delay: in whole ticks.
    """
    out = sample
    for ticks, earlier in enumerate(under_way, start=1):
        out = where(delay == float(ticks), earlier, out)
    return out, (sample, *under_way)[: len(under_way)]
