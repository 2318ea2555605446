"""One axis of a PID loop.

    u = k_p e + i - k_d ẏ_f + k_ff r,  limited,      e = r - y

The derivative is of the measurement, so that a step of the setpoint does not kick, and is filtered if it has a filter.
The integral i has the unit of the output. It grows by h k_i e and is kept within its limit; its growth can fade where
the error is large, as in PX4, by the factor 1 - (e / e₀)². Terms that a loop does not have are None and cost nothing.
"""

from typing import NamedTuple

from drake_quad.framework.elementary import maximum, minimum, wrap_angle
from drake_quad.pid.filters import EMPTY, Delayed, LowPass, filtered
from drake_quad.signals import Row, Time


class Integral(NamedTuple):
    """Integral term.

    Attributes:
        k_i: gain.
        limit: largest size of the term, in the unit of the output.
        fade: e₀, error from which on the term does not grow; None if it always grows.
    """

    k_i: Row
    limit: Row
    fade: Row | None = None


class Derivative(NamedTuple):
    """Derivative term.

    Attributes:
        k_d: gain.
        low_pass: filter of the derivative; None without one.
    """

    k_d: Row
    low_pass: LowPass | None = None


class Terms(NamedTuple):
    """Terms of a loop beside the proportional one, each of which may be None.

    Attributes:
        integral: integral term.
        derivative: derivative term.
        k_ff: gain of the setpoint.
        limit: largest size of the output.
    """

    integral: Integral | None = None
    derivative: Derivative | None = None
    k_ff: Row | None = None
    limit: Row | None = None


class LastMeasurement(NamedTuple):
    """Measurement of the tick before.

    Attributes:
        value: in the unit of the measurement.
        known: 0 before the first tick, 1 after it.
    """

    value: Row
    known: Row


class Memory(NamedTuple):
    """State of a loop, in which parts that its terms do not need are None.

    Attributes:
        integral: integral term.
        measured: measurement of the tick before.
        delayed: state of the filter of the derivative.
    """

    integral: Row | None = None
    measured: LastMeasurement | None = None
    delayed: Delayed | None = None

    @classmethod
    def of(cls, terms: Terms | None) -> "Memory":
        """Return the state before the first tick."""
        integral, derivative, *_ = terms or Terms()
        return cls(
            None if integral is None else 0.0,
            None if derivative is None else LastMeasurement(0.0, 0.0),
            None if derivative is None or derivative.low_pass is None else EMPTY,
        )


def within(value: Row, limit: Row) -> Row:
    """Return the value between minus the limit and the limit."""
    return maximum(minimum(value, limit), -limit)


def integrated(term: Row, error: Row, integral: Integral, period: Time) -> Row:
    """Return the integral term after the error of one more tick."""
    growth = integral.k_i * error * period
    if integral.fade is not None:
        share = error / integral.fade
        growth = growth * maximum(1.0 - share * share, 0.0)
    return within(term + growth, integral.limit)


def differentiated(
    measured: Row, derivative: Derivative, memory: Memory, period: Time, *, turns: bool = False
) -> tuple[Row, Memory]:
    """Return the filtered rate of the measurement, 0 at the first tick, and the memory with it."""
    before = memory.measured
    assert before is not None
    moved = measured - before.value
    rate = before.known * (wrap_angle(moved) if turns else moved) / period
    delayed = memory.delayed
    if derivative.low_pass is not None:
        assert delayed is not None
        rate, delayed = filtered(rate, derivative.low_pass, delayed)
    return rate, Memory(memory.integral, LastMeasurement(measured, 1.0), delayed)


def pid(
    setpoint: Row,
    measured: Row,
    k_p: Row,
    terms: Terms | None,
    memory: Memory,
    period: Time,
    *,
    turns: bool = False,
    integrates_first: bool = False,
) -> tuple[Row, Memory]:
    """Return the output of a loop at a tick, and its memory.

    Args:
        setpoint: r.
        measured: y.
        k_p: proportional gain.
        terms: other terms; None for a proportional loop.
        memory: of the tick before.
        period: h, s.
        turns: True for angles of which whole turns do not count.
        integrates_first: True if the output has the integral with the error of its own tick.
    """
    error = wrap_angle(setpoint - measured) if turns else setpoint - measured
    output = k_p * error
    if terms is None:
        return output, memory
    if terms.derivative is not None:
        rate, memory = differentiated(measured, terms.derivative, memory, period, turns=turns)
        output = output - terms.derivative.k_d * rate
    if terms.integral is not None:
        assert memory.integral is not None
        term = integrated(memory.integral, error, terms.integral, period)
        output = output + (term if integrates_first else memory.integral)
        memory = memory._replace(integral=term)
    if terms.k_ff is not None:
        output = output + terms.k_ff * setpoint
    if terms.limit is not None:
        output = within(output, terms.limit)
    return output, memory
