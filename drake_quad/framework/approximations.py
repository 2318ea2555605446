"""The elementary functions of symbols, in arithmetic that processors do for many vehicles at once.

They agree with those of a mathematical library within two units in the last place. Other than there, angles beyond a
million are not a number, and what is smaller than 1e-307 may be zero. They reduce the argument; sine and
cosine take the minimax approximations of S. L. Moshier, "Methods and Programs for Mathematical Functions", 1989, as
in his Cephes library, the others Chebyshev fits that were made with mpmath.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drake_quad.framework.symbols import Symbol, SymbolKind, lifted, number, operation, truth

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

# π/2 in two parts.
_QUARTER = (1.5707963267948966, 6.123233995736766e-17)
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
# (arctan t - t) / t³ as a function of t², for |t| up to the tangent of π/8, within 6e-18.
_ARCTAN = (
    -0.3333333333333333,
    0.199999999999955,
    -0.14285714284662226,
    0.11111111014909221,
    -0.09090904564022367,
    0.07692182863309693,
    -0.06664506835133263,
    0.05858108856106755,
    -0.05085240174154878,
    0.03922560559586107,
    -0.019169476385361265,
)
# The same for |t| up to 1/8, within 1e-18.
_SMALL_ARCTAN = (
    -0.33333333333333287,
    0.19999999999790477,
    -0.14285714129116034,
    0.1111106826170422,
    -0.09085599506798686,
    0.07387718384425714,
)
# (arcsin x - x) / x³ as a function of x², for |x| up to 1/2, within 6e-18 of arcsin x.
_ARCSIN = (
    0.16666666666666669,
    0.07499999999998433,
    0.04464285714635543,
    0.030381944138531247,
    0.02237217294214989,
    0.017352392720869973,
    0.013971212973552933,
    0.011479177415184906,
    0.01032281435018578,
    0.005457506718640358,
    0.01740087944269402,
    -0.014851887071247204,
    0.028757851367421566,
)
# (tanh x - x) / x³ as a function of x², for |x| up to 5/8, within 5e-17 of tanh x.
_TANH = (
    -0.3333333333333332,
    0.13333333333326658,
    -0.05396825396139557,
    0.021869488260559115,
    -0.008863229830925709,
    0.0035920589774734554,
    -0.001455309297534642,
    0.0005874372860094381,
    -0.00023077616269519857,
    7.959955735264808e-05,
    -1.724487449484433e-05,
)
_SMALL_OF_TANH = 0.625
# Polynomial of (erf x - 2/√π x) / x³ in x², for |x| <= 1. Its error in erf x is below 8e-18.
_ERF_COEFFICIENTS = (
    -0.37612638903183754,
    0.11283791670955111,
    -0.026866170645123838,
    0.005223977625303518,
    -0.0008548327010033328,
    0.00012055332214716276,
    -1.4925622504489842e-05,
    1.6461446656928561e-06,
    -1.6355118610877705e-07,
    1.4692484859133263e-08,
    -1.1500357159785296e-09,
    6.174097221305255e-11,
)
_ERF_SLOPE_MINUS_ONE = 0.1283791670955126  # 2/√π - 1
# Polynomial of exp(x²) erfc x in 14.4 / (x + 3) - 2.6, for 1 <= x <= 6. Its error in erf x is below 5e-18.
_ERFC_COEFFICIENTS = (
    0.20798329133342885,
    0.15436117429436919,
    0.04969844540339464,
    0.012713147695692198,
    0.002479314697078186,
    0.0003316029605764125,
    1.9563583246137112e-05,
    -2.4255574719050315e-06,
    -5.541274478467714e-07,
    4.526700764248741e-09,
    1.1339538061744706e-08,
    2.6381508985080735e-10,
    -2.571511429603255e-10,
    -6.047405945991704e-12,
    6.0857915906870915e-12,
)
_MAX_ERF_ARGUMENT = 6.0  # erf x is 1 in double precision for larger x
_TAN_EIGHTH, _TAN_3_EIGHTHS = math.tan(math.pi / 8.0), math.tan(3.0 * math.pi / 8.0)


def select(mask: Symbol, x: Any, y: Any) -> Symbol:
    """Return x where the mask is true, else y; a truth value is converted to a number if the other is a number."""
    _, x, y = lifted(mask, x, y)
    if x.kind is not y.kind:
        x, y = number(x), number(y)
    return operation("select", truth(mask), x, y, kind=x.kind)


def fused(x: Symbol, y: Any, z: Any) -> Symbol:
    """X y + z, rounded once."""
    return operation("multiply_add", x, y, z)


def polynomial(x: Symbol, coefficients: Sequence[float]) -> Symbol:
    """Return the polynomial with at least four coefficients, that of the power 0 first.

    Even and odd powers are summed apart, so that neither sum waits for the other.
    """
    z = x * x
    return fused(x, polynomial_in_turn(z, coefficients[1::2]), polynomial_in_turn(z, coefficients[::2]))


def polynomial_in_turn(x: Symbol, coefficients: Sequence[float]) -> Symbol:
    """Return the polynomial with at least two coefficients, by Horner's rule."""
    *others, before, last = coefficients
    result = fused(x, last, before)
    for coefficient in reversed(others):
        result = fused(x, result, coefficient)
    return result


def _odd(x: Symbol, coefficients: Sequence[float]) -> Symbol:
    """Return x + x³ p(x²) for a polynomial p with these coefficients, that of the power 0 first."""
    z = x * x
    return fused(x * z, polynomial(z, coefficients), x)


def sqrt(x: Symbol) -> Symbol:
    """Square root; not a number for a negative one."""
    return operation("square_root", x)


def nearest(x: Symbol) -> Symbol:
    """The nearest whole number, the even one of two."""
    return operation("nearest", x)


def copysign(x: Any, y: Symbol) -> Symbol:
    """The size of x with the sign of y."""
    return operation("copy_sign", x, y, kind=SymbolKind.NUMBER)


def sin_cos(x: Symbol) -> tuple[Symbol, Symbol]:
    """Sine and cosine of an angle in radians."""
    rounded = fused(x, 2.0 / math.pi, _ROUNDING)
    quarters, bits = rounded - _ROUNDING, bits_of(rounded)
    r = fused(quarters, -_QUARTER[1], fused(quarters, -_QUARTER[0], x))
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


def tanh(x: Symbol) -> Symbol:
    """Hyperbolic tangent."""
    size = abs(x)
    large = 1.0 - 2.0 / (exp(2.0 * size) + 1.0)
    return select(size < _SMALL_OF_TANH, _odd(x, _TANH), copysign(large, x))


def erf(x: Symbol) -> Symbol:
    """Return the error function of x."""
    size, z = abs(x), x * x
    clamped = select(size > _MAX_ERF_ARGUMENT, _MAX_ERF_ARGUMENT, size)
    large = 1.0 - exp(-(clamped * clamped)) * polynomial(14.4 / (clamped + 3.0) - 2.6, _ERFC_COEFFICIENTS)
    small = fused(x, fused(z, polynomial(z, _ERF_COEFFICIENTS), _ERF_SLOPE_MINUS_ONE), x)
    return select(size < 1.0, small, copysign(large, x))


def log(x: Symbol, *, normal: bool) -> Symbol:
    """Natural logarithm; quicker of what is known to be a positive, normal number."""
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
    if normal:
        return result
    result = select(x >= _SMALLEST_NORMAL, result, select(x >= 0.0, -math.inf, math.nan))
    return select(x < math.inf, result, x)


def log_of_1_plus(x: Symbol) -> Symbol:
    """Natural logarithm of 1 + x, accurate for small x, which must not be negative."""
    rounded = 1.0 + x
    lost = rounded == 1.0
    # What was lost in the sum is lost in the difference, too.
    return select(lost, x, log(rounded, normal=False) * (x / select(lost, 1.0, rounded - 1.0)))


def arctan(x: Symbol, *, small: bool) -> Symbol:
    """Return the inverse tangent, rad; it is quicker if |x| is known to be at most 1/8: small."""
    if small:
        return _odd(x, _SMALL_ARCTAN)
    return copysign(_slope_angle(abs(x), 1.0), x)


def arctan2(y: Any, x: Any) -> Symbol:
    """Angle of the point (x, y), rad."""
    y, x = lifted(y, x)
    angle = _slope_angle(abs(y), abs(x))
    return copysign(select(copysign(1.0, x) < 0.0, math.pi - angle, angle), y)


def _slope_angle(rise: Symbol, run: Any) -> Symbol:
    """The angle of a slope, rad; zero where neither is larger than zero."""
    flat, steep = rise <= _TAN_EIGHTH * run, rise > _TAN_3_EIGHTHS * run
    # With one division for the three ranges: the angle, the angle less π/4, or less π/2.
    above = select(flat, rise, select(steep, -run, rise - run))
    below = select(flat, run, select(steep, rise, rise + run))
    t = above / select(below == 0.0, 1.0, below)
    z = t * t
    base = select(flat, 0.0, select(steep, _QUARTER[0], 0.5 * _QUARTER[0]))
    rest = select(flat, 0.0, select(steep, _QUARTER[1], 0.5 * _QUARTER[1]))
    return base + (fused(t * z, polynomial(z, _ARCTAN), t) + rest)


def arcsin(x: Symbol, *, small: bool) -> Symbol:
    """Return the inverse sine, rad, NaN outside [-1, 1]; it is quicker if |x| is known to be at most 1/2: small."""
    if small:
        return _odd(x, _ARCSIN)
    return arctan2(x, sqrt((1.0 - x) * (1.0 + x)))


def wrapped(angle: Symbol) -> Symbol:
    """The same angle in [-π, π], rad."""
    return angle - math.tau * nearest(angle * (1.0 / math.tau))


def float_of(word: Symbol) -> Symbol:
    """The number that a word below 2**52 is."""
    return _number_of(word | _BITS_OF_WHOLE) - _WHOLE


def word_of(x: Symbol) -> Symbol:
    """The word of a whole number from 0 on, below 2**52."""
    return bits_of(x + _WHOLE) ^ _BITS_OF_WHOLE


def bits_of(x: Symbol) -> Symbol:
    """The bits of a number."""
    return operation("bits_of", x, kind=SymbolKind.WORD)


def _number_of(bits: Symbol) -> Symbol:
    return operation("number_of", bits, kind=SymbolKind.NUMBER)


def _is_negative(bits: Symbol) -> Symbol:
    """Whether the sign bit is set."""
    return operation("sign_bit", bits, kind=SymbolKind.TRUTH)
