"""Delay of a sampled signal by a whole number of ticks."""

from typing import Any, NamedTuple

from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import FleetSystem, StateGroup
from drake_quad.signals import Row


class DelayLine(NamedTuple):
    """States of a system that delays a signal.

    A sample becomes the output `delay` ticks after it was taken, and is held until the next sample:

        tick                        0          1          2
        sample                      u₀         u₁         u₂
        output, 1 tick of delay     initial    u₀         u₁

    Attributes:
        out: state with the output.
        in_transit: state with a tuple of the samples in transit, the latest first; an empty tuple if the largest
            possible delay is zero.
    """

    out: StateGroup
    in_transit: Any


def declare_delay_line(system: FleetSystem, name: str, initial: Any, longest: int) -> DelayLine:
    """Declare the states of a delay line.

    Args:
        system: system that declares the states.
        name: name of the state with the output. The samples in transit are in the state `{name}_in_transit`.
        initial: function that returns the output before the first sample, given the parameters of the system.
        longest: largest possible delay, in ticks.
    """
    out = system.state(name, initial)
    waiting = system.state(f"{name}_in_transit", lambda parameters: (initial(parameters),) * longest) if longest else ()
    return DelayLine(out, waiting)


def latest_sample(out: Any, in_transit: tuple[Any, ...]) -> Any:
    """Return the latest sample of a delay line, which is the output if there is no delay."""
    for sample in in_transit:
        return sample
    return out


def delay_line_step(sample: Any, in_transit: tuple[Any, ...], delay: Row) -> tuple[Any, tuple[Any, ...]]:
    """Return the output of a delay line and the samples in transit after a tick.

    Args:
        sample: sample of this tick, a record.
        in_transit: samples in transit, latest sample first.
        delay: delay, a whole number of ticks.
    """
    out = sample
    for ticks, earlier in enumerate(in_transit, start=1):
        out = where(delay == float(ticks), earlier, out)
    return out, (sample, *in_transit)[: len(in_transit)]
