"""Low-pass filters of derivatives and of gyroscopes, as flight controllers compute them.

A filter is y = (b₀ + b₁ z⁻¹ + b₂ z⁻²) / (1 + a₁ z⁻¹ + a₂ z⁻²) u. The functions below make two kinds of it from a
bandwidth, which are those of PX4 (`LowPassFilter2p` and `AlphaFilter`) and of the Crazyflie's firmware (`lpf2p`).
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


class Delayed(NamedTuple):
    """State of a low-pass filter: its inner signal one and two periods ago."""

    once: Row
    twice: Row


EMPTY = Delayed(0.0, 0.0)


def butterworth(bandwidth: AngleRate, period: Time) -> LowPass:
    """Return the Butterworth filter of second order with unit gain at rest, by the prewarped bilinear transform.

    Args:
        bandwidth: ω at which the gain is 1/√2; a number or an (N,) array.
        period: s.
    """
    warped: Any = np.tan(0.5 * np.asarray(bandwidth) * period)
    squared, middle = warped * warped, np.sqrt(2.0) * warped
    scale = 1.0 + middle + squared
    b_0 = squared / scale
    return LowPass(b_0, 2.0 * b_0, b_0, 2.0 * (squared - 1.0) / scale, (1.0 - middle + squared) / scale)


def first_order(bandwidth: AngleRate, period: Time) -> LowPass:
    """Return the filter y⁺ = y + α (u - y) with α = ω h / (1 + ω h); arguments are those of `butterworth`."""
    turn: Any = np.asarray(bandwidth) * period
    share = turn / (1.0 + turn)
    none = 0.0 * share
    return LowPass(share, none, none, share - 1.0, none)


def low_pass(bandwidth: AngleRate, period: Time, order: Order) -> LowPass:
    """Return the filter of an order; other arguments are those of `butterworth`."""
    return first_order(bandwidth, period) if order == 1 else butterworth(bandwidth, period)


def filtered(sample: Row, low_pass: LowPass, state: Delayed) -> tuple[Row, Delayed]:
    """Return the output of a filter, and its next state."""
    inner = sample - low_pass.a_1 * state.once - low_pass.a_2 * state.twice
    output = low_pass.b_0 * inner + low_pass.b_1 * state.once + low_pass.b_2 * state.twice
    return output, Delayed(inner, state.once)
