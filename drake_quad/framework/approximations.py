"""The elementary functions of symbols, in arithmetic that processors do for many vehicles at once.

They agree with those of a mathematical library within two units in the last place. Other than there, angles beyond a
million are not a number, and what is smaller than 1e-307 may be zero. They reduce the argument and take the minimax
approximations of S. L. Moshier, "Methods and Programs for Mathematical Functions", 1989, as in his Cephes library.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drake_quad.framework.symbols import Kind, Symbol, lifted, operation

# Added and taken away again, it rounds to a whole number, which then stands in the lowest bits.
_ROUNDING = 1.5 * 2.0**52
_EXPONENT_BITS, _BIAS = np.uint64(52), np.uint64(1023)
_SMALLEST_NORMAL = 2.0**-1022
_MANTISSA, _HALF = np.uint64(2**52 - 1), np.uint64(1022 << 52)

# π/2 in three parts, of which the first two have zeros enough at their end for exact multiples up to 2**20.
_QUARTER = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_LARGEST_ANGLE = 2.0**20
_SINE = (
    -1.66666666666666307295e-1,
    8.33333333332211858878e-3,
    -1.98412698295895385996e-4,
    2.75573136213857245213e-6,
    -2.50507477628578072866e-8,
    1.58962301576546568060e-10,
)
_COSINE = (
    4.16666666666665929218e-2,
    -1.38888888888730564116e-3,
    2.48015872888517045348e-5,
    -2.75573141792967388112e-7,
    2.08757008419747316778e-9,
    -1.13585365213876817300e-11,
)
# ln 2 in two parts.
_LN_2 = (6.93145751953125e-1, 1.42860682030941723212e-6)
_EXP_P = (9.99999999999999999910e-1, 3.02994407707441961300e-2, 1.26177193074810590878e-4)
_EXP_Q = (
    2.00000000000000000009e0,
    2.27265548208155028766e-1,
    2.52448340349684104192e-3,
    3.00198505138664455042e-6,
)
_LARGEST_EXPONENT, _LEAST_EXPONENT = 709.0, -708.0
# ln 2 in two parts, the first of few digits.
_LN_2_OF_LOG = (0.693359375, -2.121944400546905827679e-4)
_LOG_P = (
    7.70838733755885391666e0,
    1.79368678507819816313e1,
    1.44989225341610930846e1,
    4.70579119878881725854e0,
    4.97494994976747001425e-1,
    1.01875663804580931796e-4,
)
_LOG_Q = (
    2.31251620126765340583e1,
    7.11544750618563894466e1,
    8.29875266912776603211e1,
    4.52279145837532221105e1,
    1.12873587189167450590e1,
    1.0,
)
_ATAN_P = (
    -6.485021904942025371773e1,
    -1.228866684490136173410e2,
    -7.500855792314704667340e1,
    -1.615753718733365076637e1,
    -8.750608600031904122785e-1,
)
_ATAN_Q = (
    1.945506571482613964425e2,
    4.853903996359136964868e2,
    4.328810604912902668951e2,
    1.650270098316988542046e2,
    2.485846490142306297962e1,
    1.0,
)
_TAN_3_EIGHTH, _TAN_EIGHTH = math.tan(3.0 * math.pi / 8.0), 0.66
# What π/2 is more than its nearest number.
_MORE_THAN_HALF_PI = 6.123233995736765886130e-17


def select(mask: Symbol, x: Any, y: Any) -> Symbol:
    """X where the mask is true, else y."""
    kind = x.kind if x.__class__ is Symbol else y.kind if y.__class__ is Symbol else Kind.NUMBER
    return operation("select", mask, x, y, kind=kind)


def fused(x: Symbol, y: Any, z: Any) -> Symbol:
    """X y + z, rounded once."""
    return operation("multiply_add", x, y, z)


def polynomial(x: Symbol, coefficients: Sequence[float]) -> Symbol:
    """The polynomial with these coefficients, that of the power 0 first."""
    *others, before, last = coefficients
    result = fused(x, last, before)
    for coefficient in reversed(others):
        result = fused(x, result, coefficient)
    return result


def sqrt(x: Symbol) -> Symbol:
    """Square root; not a number for a negative one."""
    return operation("square_root", x)


def nearest(x: Symbol) -> Symbol:
    """The nearest whole number, the even one of two."""
    return operation("nearest", x)


def copysign(x: Any, y: Symbol) -> Symbol:
    """The size of x with the sign of y."""
    return operation("copy_sign", x, y, kind=Kind.NUMBER)


def sin_cos(x: Symbol) -> tuple[Symbol, Symbol]:
    """Sine and cosine of an angle in radians."""
    quarters = nearest(x * (2.0 / math.pi))
    r = fused(quarters, -_QUARTER[2], fused(quarters, -_QUARTER[1], fused(quarters, -_QUARTER[0], x)))
    z = r * r
    sine = fused(r * z, polynomial(z, _SINE), r)
    cosine = fused(z * z, polynomial(z, _COSINE), fused(z, -0.5, 1.0))
    halves = nearest(fused(quarters, 0.5, -0.25))
    odd, turned = quarters - 2.0 * halves > 0.5, halves - 2.0 * nearest(fused(halves, 0.5, -0.25))
    sign = select(abs(x) <= _LARGEST_ANGLE, 1.0 - 2.0 * turned, math.nan)
    return sign * select(odd, cosine, sine), sign * select(odd, -sine, cosine)


def exp(x: Symbol) -> Symbol:
    """Exponential."""
    clamped = select(x > _LEAST_EXPONENT, x, _LEAST_EXPONENT)
    clamped = select(clamped < _LARGEST_EXPONENT, clamped, _LARGEST_EXPONENT)
    power = clamped * (1.0 / math.log(2.0)) + _ROUNDING
    twos = power - _ROUNDING
    r = fused(twos, -_LN_2[1], fused(twos, -_LN_2[0], clamped))
    z = r * r
    odd = r * polynomial(z, _EXP_P)
    mantissa = 1.0 + 2.0 * odd / (polynomial(z, _EXP_Q) - odd)
    scale = _number_of((bits_of(power) + _BIAS) << _EXPONENT_BITS)
    result = select(x < _LEAST_EXPONENT, 0.0, mantissa * scale)
    result = select(x > _LARGEST_EXPONENT, math.inf, result)
    return select(x == x, result, x)


def log(x: Symbol) -> Symbol:
    """Natural logarithm."""
    bits = bits_of(x)
    mantissa = _number_of((bits & _MANTISSA) | _HALF)
    # The exponent as a float: its bits in the lowest place of a number that rounds to a whole one.
    exponent = _number_of((bits >> _EXPONENT_BITS) + np.float64(_ROUNDING).view(np.uint64)) - (_ROUNDING + 1022.0)
    small = mantissa < math.sqrt(0.5)
    exponent = select(small, exponent - 1.0, exponent)
    r = select(small, 2.0 * mantissa - 1.0, mantissa - 1.0)
    z = r * r
    y = r * (z * polynomial(r, _LOG_P) / polynomial(r, _LOG_Q))
    y = fused(z, -0.5, fused(exponent, _LN_2_OF_LOG[1], y))
    result = fused(exponent, _LN_2_OF_LOG[0], r + y)
    result = select(x >= _SMALLEST_NORMAL, result, select(x >= 0.0, -math.inf, math.nan))
    return select(x < math.inf, result, x)


def log_of_1_plus(x: Symbol) -> Symbol:
    """Natural logarithm of 1 + x, accurate for small x, which must not be negative."""
    rounded = 1.0 + x
    lost = rounded == 1.0
    # What was lost in the sum is lost in the difference, too.
    return select(lost, x, log(rounded) * (x / select(lost, 1.0, rounded - 1.0)))


def arctan(x: Symbol) -> Symbol:
    """Inverse tangent, rad."""
    size = abs(x)
    steep, middling = size > _TAN_3_EIGHTH, size > _TAN_EIGHTH
    # One division for the three ranges.
    above = select(steep, -1.0, select(middling, size - 1.0, size))
    argument = above / select(steep, size, select(middling, size + 1.0, 1.0))
    base = select(steep, 0.5 * math.pi, select(middling, 0.25 * math.pi, 0.0))
    rest = select(steep, _MORE_THAN_HALF_PI, select(middling, 0.5 * _MORE_THAN_HALF_PI, 0.0))
    z = argument * argument
    part = fused(argument, z * polynomial(z, _ATAN_P) / polynomial(z, _ATAN_Q), argument)
    return copysign(base + (part + rest), x)


def arctan2(y: Any, x: Any) -> Symbol:
    """Angle of the point (x, y), rad."""
    y, x = lifted(y, x)
    across, along = abs(y), abs(x)
    steep = across > along
    ratio = select(steep, along, across) / select(steep, across, along)
    angle = arctan(select(across + along == 0.0, 0.0, ratio))
    angle = select(steep, 0.5 * math.pi - angle, angle)
    angle = select(copysign(1.0, x) < 0.0, math.pi - angle, angle)
    return copysign(angle, y)


def arcsin(x: Symbol) -> Symbol:
    """Inverse sine, rad; not a number outside [-1, 1]."""
    return arctan2(x, sqrt((1.0 - x) * (1.0 + x)))


def wrapped(angle: Symbol) -> Symbol:
    """The same angle in [-π, π], rad."""
    return angle - math.tau * nearest(angle / math.tau)


def float_of(word: Symbol) -> Symbol:
    """The nearest floating-point number of a word below 2**53."""
    return operation("float_of", word, kind=Kind.NUMBER)


def word_of(x: Symbol) -> Symbol:
    """The word of a whole number."""
    return operation("word_of", x, kind=Kind.WORD)


def bits_of(x: Symbol) -> Symbol:
    """The bits of a number."""
    return operation("bits_of", x, kind=Kind.WORD)


def _number_of(bits: Symbol) -> Symbol:
    return operation("number_of", bits, kind=Kind.NUMBER)
