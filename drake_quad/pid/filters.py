"""Low-pass filters of derivatives and of gyroscopes, as flight controllers compute them.

A filter is y = (b₀ + b₁ z⁻¹ + b₂ z⁻²) / (1 + a₁ z⁻¹ + a₂ z⁻²) u. Given a bandwidth, this module designs the two types
that PX4 (`LowPassFilter2p` and `AlphaFilter`) and the Crazyflie's firmware (`lpf2p`) use.
"""

from typing import Any, Literal, NamedTuple

import numpy as np

from drake_quad.signals import AngleRate, Number, Row, Time

Order = Literal[1, 2]


class LowPass(NamedTuple):
    """Coefficients of a low-pass filter."""

    b_0: Number
    b_1: Number
    b_2: Number
    a_1: Number
    a_2: Number


class FilterState(NamedTuple):
    """State of a low-pass filter, in direct form II.

    The state consists of past samples of w = u / (1 + a₁ z⁻¹ + a₂ z⁻²), where u is the input of the filter.

    Attributes:
        last: w one period ago.
        second_last: w two periods ago.
    """

    last: Row
    second_last: Row


EMPTY_FILTER = FilterState(0.0, 0.0)
"""State of a filter before its first sample."""


def butterworth(bandwidth: AngleRate, period: Time) -> LowPass:
    """Return the Butterworth filter of second order with unit DC gain, by the prewarped bilinear transform.

    Args:
        bandwidth: angular frequency ω at which the gain is 1/√2; a number or an (N,) array.
        period: sampling period, s.
    """
    warped: Any = np.tan(0.5 * np.asarray(bandwidth) * period)
    squared, damping = warped * warped, np.sqrt(2.0) * warped
    scale = 1.0 + damping + squared
    b_0 = squared / scale
    return LowPass(b_0, 2.0 * b_0, b_0, 2.0 * (squared - 1.0) / scale, (1.0 - damping + squared) / scale)


def first_order(bandwidth: AngleRate, period: Time) -> LowPass:
    """Return the filter y⁺ = y + α (u⁺ - y) with α = ω h / (1 + ω h); the arguments are those of `butterworth`."""
    angle: Any = np.asarray(bandwidth) * period
    fraction = angle / (1.0 + angle)
    zero = 0.0 * fraction
    return LowPass(fraction, zero, zero, fraction - 1.0, zero)


def low_pass(bandwidth: AngleRate, period: Time, order: Order) -> LowPass:
    """Return the low-pass filter of a given order; the other arguments are those of `butterworth`."""
    return first_order(bandwidth, period) if order == 1 else butterworth(bandwidth, period)


def filter_step(sample: Row, low_pass: LowPass, state: FilterState) -> tuple[Row, FilterState]:
    """Return the output of a filter for one sample, and its next state."""
    current = sample - low_pass.a_1 * state.last - low_pass.a_2 * state.second_last
    output = low_pass.b_0 * current + low_pass.b_1 * state.last + low_pass.b_2 * state.second_last
    return output, FilterState(current, state.last)
