"""The elementary functions of symbols, in arithmetic that processors do for many vehicles at once.

They agree with those of a mathematical library within two units in the last place. Other than there, angles beyond a
million are not a number, and what is smaller than 1e-307 may be zero. They reduce the argument; sine, cosine and
arctangent take the minimax approximations of S. L. Moshier, "Methods and Programs for Mathematical Functions", 1989, as
in his Cephes library, exponential and logarithm Chebyshev fits that were made with mpmath.
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
_MANTISSA, _SIGN = np.uint64(2**52 - 1), np.uint64(1 << 63)
_ONE_BIT, _SIGN_BIT, _BEFORE_SIGN_BIT = np.uint64(1), np.uint64(63), np.uint64(62)
# The bits of 1 and of the square root of a half.
_ONE, _ROOT_OF_HALF = np.uint64(1023 << 52), np.float64(math.sqrt(0.5)).view(np.uint64)
# 2**52, in whose lowest bits stands what is added, and its bits.
_WHOLE, _BITS_OF_WHOLE = 2.0**52, np.uint64(1075 << 52)

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
# ln 2 in two parts, the first of few digits.
_LN_2 = (6.93145751953125e-1, 1.42860682030941723212e-6)
# (exp r - 1 - r) / r² for |r| up to half of ln 2, within 1.3e-17 of exp r.
_EXP = (
    0.5000000000000001,
    0.16666666666666669,
    0.04166666666662399,
    0.008333333333330051,
    0.0013888888917281794,
    0.00019841269863105968,
    2.480152119021773e-05,
    2.7557268378684192e-06,
    2.7620138719733994e-07,
    2.5100424157005067e-08,
)
# Beyond them the power of two is that of infinity or zero.
_LARGEST_EXPONENT, _LEAST_EXPONENT = 710.0, -709.1
# (ln((1 + s) / (1 - s)) - 2 s) / s³ as a function of s², for (1 + s) / (1 - s) from √½ to √2, within 1e-17.
_LOG = (
    0.666666666666667,
    0.399999999998992,
    0.2857142862611452,
    0.22222211112104948,
    0.1818289077802613,
    0.15331666676597175,
    0.146171283998073,
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
    """The polynomial with these coefficients, that of the power 0 first.

    By Estrin's scheme, pair by pair: no sum has to wait for many others.
    """
    terms: list[Any] = list(coefficients)
    while len(terms) > 1:
        pairs = [fused(x, high, low) for low, high in zip(terms[::2], terms[1::2])]
        terms = [*pairs, terms[-1]] if len(terms) % 2 else pairs
        x = x * x
    result: Symbol = terms[0]
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
    rounded = fused(x, 2.0 / math.pi, _ROUNDING)
    quarters, bits = rounded - _ROUNDING, bits_of(rounded)
    r = fused(quarters, -_QUARTER[2], fused(quarters, -_QUARTER[1], fused(quarters, -_QUARTER[0], x)))
    r = select(abs(x) <= _LARGEST_ANGLE, r, math.nan)
    z = r * r
    sine = fused(r * z, polynomial(z, _SINE), r)
    cosine = fused(z * z, polynomial(z, _COSINE), fused(z, -0.5, 1.0))
    odd = _is_negative(bits << _SIGN_BIT)
    # Sines are negative in the third and fourth quarter, cosines in the second and third.
    of_sine, of_cosine = bits << _BEFORE_SIGN_BIT, (bits + _ONE_BIT) << _BEFORE_SIGN_BIT
    return _turned(select(odd, cosine, sine), of_sine), _turned(select(odd, sine, cosine), of_cosine)


def _turned(x: Symbol, sign: Symbol) -> Symbol:
    """X with its sign changed where that bit of a word is set."""
    return _number_of(bits_of(x) ^ (sign & _SIGN))


def exp(x: Symbol) -> Symbol:
    """Exponential; infinite from 709.4 on."""
    # So that what is not a number stays so.
    clamped = select(x < _LEAST_EXPONENT, _LEAST_EXPONENT, x)
    clamped = select(clamped > _LARGEST_EXPONENT, _LARGEST_EXPONENT, clamped)
    rounded = fused(clamped, 1.0 / math.log(2.0), _ROUNDING)
    twos = rounded - _ROUNDING
    r = fused(twos, -_LN_2[1], fused(twos, -_LN_2[0], clamped))
    mantissa = 1.0 + fused(r * r, polynomial(r, _EXP), r)
    return mantissa * _number_of((bits_of(rounded) + _BIAS) << _EXPONENT_BITS)


def log(x: Symbol) -> Symbol:
    """Natural logarithm."""
    # With these bits added, the exponent is one more from the square root of a half on.
    bits = bits_of(x) + (_ONE - _ROOT_OF_HALF)
    f = _number_of((bits & _MANTISSA) + _ROOT_OF_HALF) - 1.0
    # The exponent as a float: its bits in the lowest place of a number that rounds to a whole one.
    exponent = _number_of((bits >> _EXPONENT_BITS) + np.float64(_ROUNDING).view(np.uint64)) - (_ROUNDING + 1023.0)
    # 1 + f = (1 + s) / (1 - s), and 2 s = f - f²/2 + s f²/2.
    s = f / (2.0 + f)
    z, half = s * s, 0.5 * f * f
    rest = fused(exponent, _LN_2[1], s * (half + z * polynomial(z, _LOG)))
    result = fused(exponent, _LN_2[0], f - (half - rest))
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
    """The number that a word below 2**52 is."""
    return _number_of(word | _BITS_OF_WHOLE) - _WHOLE


def word_of(x: Symbol) -> Symbol:
    """The word of a whole number from 0 to 2**52."""
    return bits_of(x + _WHOLE) ^ _BITS_OF_WHOLE


def bits_of(x: Symbol) -> Symbol:
    """The bits of a number."""
    return operation("bits_of", x, kind=Kind.WORD)


def _number_of(bits: Symbol) -> Symbol:
    return operation("number_of", bits, kind=Kind.NUMBER)


def _is_negative(bits: Symbol) -> Symbol:
    """Whether the sign bit is set."""
    return operation("negative", bits, kind=Kind.TRUTH)
