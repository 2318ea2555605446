"""One axis of a PID loop.

    u = sat(k_p e + i - k_d ẏ_f + k_ff r),      e = r - y

Here r is the setpoint, y is the measurement, and `sat` saturates the output. The derivative acts on the measurement, so
that a step of the setpoint causes no derivative kick. An optional low-pass filter smooths the derivative. The integral
term i has the unit of the output. It changes by h k_i e per tick of period h, and is saturated. For large errors, this
change can be reduced by the factor 1 - (e / e₀)², as in PX4. A loop skips the computation of each term that is None.
"""

from typing import NamedTuple

from drake_quad.framework.elementary import maximum, minimum, wrap_angle
from drake_quad.pid.filters import EMPTY_FILTER, FilterState, LowPass, filter_step
from drake_quad.signals import Row, Time


class Integral(NamedTuple):
    """Integral term.

    Attributes:
        k_i: integral gain.
        limit: largest absolute value of the term, in the unit of the output.
        max_integrated_error: error e₀ from which on the term stays constant; None to integrate errors of any size.
    """

    k_i: Row
    limit: Row
    max_integrated_error: Row | None = None


class Derivative(NamedTuple):
    """Derivative term.

    Attributes:
        k_d: derivative gain.
        low_pass: filter of the derivative; None without a filter.
    """

    k_d: Row
    low_pass: LowPass | None = None


class Terms(NamedTuple):
    """Terms of a loop in addition to the proportional term; None for each term that the loop does not have.

    Attributes:
        integral: integral term.
        derivative: derivative term.
        k_ff: feed-forward gain on the setpoint.
        limit: largest absolute value of the output.
    """

    integral: Integral | None = None
    derivative: Derivative | None = None
    k_ff: Row | None = None
    limit: Row | None = None


class LastMeasurement(NamedTuple):
    """Measurement of the previous tick.

    Attributes:
        value: measured value.
        known: 1 from the first tick on; 0 before the first tick, when no measurement exists.
    """

    value: Row
    known: Row


class Memory(NamedTuple):
    """State of a loop. A field is None if no term of the loop needs it.

    Attributes:
        integral: integral term.
        measured: measurement of the previous tick.
        filter_state: state of the derivative's filter.
    """

    integral: Row | None = None
    measured: LastMeasurement | None = None
    filter_state: FilterState | None = None

    @classmethod
    def of(cls, terms: Terms | None) -> "Memory":
        """Return the state of a PID loop before its first tick."""
        integral, derivative, *_ = terms or Terms()
        return cls(
            None if integral is None else 0.0,
            None if derivative is None else LastMeasurement(0.0, 0.0),
            None if derivative is None or derivative.low_pass is None else EMPTY_FILTER,
        )


def saturate(value: Row, limit: Row) -> Row:
    """Return a value, saturated to the range from -limit to limit."""
    return maximum(minimum(value, limit), -limit)


def integrate(term: Row, error: Row, integral: Integral, period: Time) -> Row:
    """Return the integral term after adding the error of one tick."""
    change = integral.k_i * error * period
    if integral.max_integrated_error is not None:
        fraction = error / integral.max_integrated_error
        change = change * maximum(1.0 - fraction * fraction, 0.0)
    return saturate(term + change, integral.limit)


def differentiate(
    measured: Row, derivative: Derivative, memory: Memory, period: Time, *, is_angle: bool = False
) -> tuple[Row, Memory]:
    """Return the filtered derivative of the measurement, which is 0 at the first tick, and the updated memory."""
    last = memory.measured
    assert last is not None
    change = measured - last.value
    rate = last.known * (wrap_angle(change) if is_angle else change) / period
    filter_state = memory.filter_state
    if derivative.low_pass is not None:
        assert filter_state is not None
        rate, filter_state = filter_step(rate, derivative.low_pass, filter_state)
    return rate, Memory(memory.integral, LastMeasurement(measured, 1.0), filter_state)


def pid(
    setpoint: Row,
    measured: Row,
    k_p: Row,
    terms: Terms | None,
    memory: Memory,
    period: Time,
    *,
    is_angle: bool = False,
    integrates_first: bool = False,
) -> tuple[Row, Memory]:
    """Return the output of a loop at a tick, and the memory for the next tick.

    Args:
        setpoint: setpoint r.
        measured: measurement y.
        k_p: proportional gain.
        terms: other terms; None for a proportional controller.
        memory: memory after the previous tick.
        period: tick period h, s.
        is_angle: True if the signals are angles, so that differences are wrapped to [-π, π].
        integrates_first: True if the integral in the output includes the error of this tick.
    """
    error = wrap_angle(setpoint - measured) if is_angle else setpoint - measured
    output = k_p * error
    if terms is None:
        return output, memory
    if terms.derivative is not None:
        rate, memory = differentiate(measured, terms.derivative, memory, period, is_angle=is_angle)
        output = output - terms.derivative.k_d * rate
    if terms.integral is not None:
        assert memory.integral is not None
        term = integrate(memory.integral, error, terms.integral, period)
        output = output + (term if integrates_first else memory.integral)
        memory = memory._replace(integral=term)
    if terms.k_ff is not None:
        output = output + terms.k_ff * setpoint
    if terms.limit is not None:
        output = saturate(output, terms.limit)
    return output, memory
