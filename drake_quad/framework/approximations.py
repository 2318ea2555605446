"""Elementary functions of symbols, in vector arithmetic that computes several vehicles at once.

The results agree with a mathematical library to within two units in the last place, with two exceptions: sines and
cosines of angles beyond a million radians are NaN, and results below 1e-307 may be zero.

Each function reduces its argument to a small range and evaluates a polynomial. The polynomials for sine and cosine are
the minimax approximations from S. L. Moshier, "Methods and Programs for Mathematical Functions", 1989, as in the Cephes
library. All other polynomials are Chebyshev fits that were computed with mpmath.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from drake_quad.framework.symbols import (
    Symbol,
    SymbolKind,
    add_function,
    as_number,
    as_truth_value,
    operation,
    to_symbols,
)

_Formula = TypeVar("_Formula", bound=Callable[..., Any])

# Adding this number to a float rounds the float to a whole number. The lowest bits of the sum are the lowest bits of
# this whole number.
_ROUNDING_OFFSET = 1.5 * 2.0**52
# Layout of a double: a sign bit, 11 bits of the biased exponent, and 52 bits of the mantissa.
_EXPONENT_SHIFT = np.uint64(52)  # number of bits below the exponent
_EXPONENT_BIAS = np.uint64(1023)  # biased exponent of 1.0
_MANTISSA_MASK = np.uint64(2**52 - 1)  # mask of the 52 bits of the mantissa
_SIGN_MASK = np.uint64(1 << 63)  # mask of the sign bit
# Left shifts of a 64-bit word.
_SIGN_SHIFT = np.uint64(63)  # moves the lowest bit to the sign bit
_BELOW_SIGN_SHIFT = np.uint64(62)  # moves the second lowest bit to the sign bit
_ONE_BIT = np.uint64(1)  # 64-bit word whose only set bit is the lowest one
_MIN_NORMAL = 2.0**-1022  # smallest positive normal double
_BITS_OF_ONE = np.uint64(1023 << 52)  # bits of the double 1.0
_BITS_OF_SQRT_HALF = np.float64(math.sqrt(0.5)).view(np.uint64)  # bits of the double √½
# The lowest bits of the sum of 2**52 and a smaller whole number are the bits of this whole number.
_TWO_52 = 2.0**52
_BITS_OF_TWO_52 = np.uint64(1075 << 52)  # bits of the double 2⁵²

# π/2 as a sum of two doubles.
_HALF_PI_PARTS = (1.5707963267948966, 6.123233995736766e-17)
_MAX_ANGLE = 2.0**20  # rad; sines and cosines of larger angles are NaN
_SINE_COEFFICIENTS = (
    -1.66666666666666307295e-1,
    8.33333333332211858878e-3,
    -1.98412698295895385996e-4,
    2.75573136213857245213e-6,
    -2.50507477628578072866e-8,
    1.58962301576546568060e-10,
)
_COSINE_COEFFICIENTS = (
    4.16666666666665929218e-2,
    -1.38888888888730564116e-3,
    2.48015872888517045348e-5,
    -2.75573141792967388112e-7,
    2.08757008419747316778e-9,
    -1.13585365213876817300e-11,
)
# ln 2 as a sum of two doubles. The first double has few digits, so that its products with whole numbers are exact.
_LN_2_PARTS = (6.93145751953125e-1, 1.42860682030941723212e-6)
# Polynomial of (exp r - 1 - r) / r² in r, for |r| <= ln 2 / 2. Its error in exp r is below 1.3e-17.
_EXP_COEFFICIENTS = (
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
# The argument of exp is clipped to these limits.
_MAX_EXP_ARGUMENT = 710.0  # the computed exp of this argument is infinity
_MIN_EXP_ARGUMENT = -709.1  # the computed exp of this argument is zero
# Polynomial of (ln((1 + s) / (1 - s)) - 2 s) / s³ in s², for (1 + s) / (1 - s) from √½ to √2. Its error is below 1e-17.
_LOG_COEFFICIENTS = (
    0.666666666666667,
    0.399999999998992,
    0.2857142862611452,
    0.22222211112104948,
    0.1818289077802613,
    0.15331666676597175,
    0.146171283998073,
)
# Polynomial of (arctan t - t) / t³ in t², for |t| <= tan(π/8). Its error is below 6e-18.
_ARCTAN_COEFFICIENTS = (
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
# Polynomial of (arctan t - t) / t³ in t², for |t| <= 1/8. Its error is below 1e-18.
_SMALL_ARCTAN_COEFFICIENTS = (
    -0.33333333333333287,
    0.19999999999790477,
    -0.14285714129116034,
    0.1111106826170422,
    -0.09085599506798686,
    0.07387718384425714,
)
# Polynomial of (arcsin x - x) / x³ in x², for |x| <= 1/2. Its error in arcsin x is below 6e-18.
_ARCSIN_COEFFICIENTS = (
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
# Polynomial of (tanh x - x) / x³ in x², for |x| <= 5/8. Its error in tanh x is below 5e-17.
_TANH_COEFFICIENTS = (
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
_MAX_SMALL_TANH_ARGUMENT = 0.625  # largest |x| for which tanh is computed by its polynomial
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
_MAX_ERF_ARGUMENT = 6.0  # for larger x, erf x is 1 in double precision
_TAN_PI_8 = math.tan(math.pi / 8.0)  # limit between the slopes of the first and the second range in `_slope_angle`
_TAN_3_PI_8 = math.tan(3.0 * math.pi / 8.0)  # limit between the second and the third range


def select(mask: Symbol, x: Any, y: Any) -> Symbol:
    """Return x where the mask is true, else y. If only one of x and y is a boolean, it is converted to a number."""
    _, x, y = to_symbols(mask, x, y)
    if x.kind is not y.kind:
        x, y = as_number(x), as_number(y)
    return operation("select", as_truth_value(mask), x, y, kind=x.kind)


def multiply_add(x: Symbol, y: Any, z: Any) -> Symbol:
    """Return x y + z, rounded only once."""
    return operation("multiply_add", x, y, z)


def polynomial(x: Symbol, coefficients: Sequence[float]) -> Symbol:
    """Evaluate a polynomial with at least four coefficients, in increasing order of powers.

    Even and odd powers are summed separately, so that a processor can compute both sums in parallel.
    """
    z = x * x
    return multiply_add(x, horner(z, coefficients[1::2]), horner(z, coefficients[::2]))


def horner(x: Symbol, coefficients: Sequence[float]) -> Symbol:
    """Evaluate a polynomial with at least two coefficients, in increasing order of powers, by Horner's rule."""
    *lower, second_last, last = coefficients
    result = multiply_add(x, last, second_last)
    for coefficient in reversed(lower):
        result = multiply_add(x, result, coefficient)
    return result


def _function(approximation: _Formula) -> _Formula:
    """Decorate the approximation of an elementary function.

    If `calls_functions` is set in the listing of the arguments, the decorated function records a call instead of the
    operations of the approximation. The name of the called function consists of the formula's name and the names of the
    options that are true.
    """

    @functools.wraps(approximation)
    def function(*arguments: Any, **options: bool) -> Any:
        if not any(argument.__class__ is Symbol and argument.listing.calls_functions for argument in arguments):
            return approximation(*arguments, **options)
        name = "_".join([approximation.__name__, *[option for option, value in options.items() if value]])
        return add_function(name, functools.partial(approximation, **options), arguments)

    return function  # type: ignore[return-value]


def _odd(x: Symbol, coefficients: Sequence[float]) -> Symbol:
    """Return x + x³ p(x²), given the coefficients of the polynomial p in increasing order of powers."""
    z = x * x
    return multiply_add(x * z, polynomial(z, coefficients), x)


def sqrt(x: Symbol) -> Symbol:
    """Return the square root; NaN for a negative number."""
    return operation("square_root", x)


def nearest(x: Symbol) -> Symbol:
    """Round to the nearest whole number, with ties to even."""
    return operation("nearest", x)


def copysign(x: Any, y: Symbol) -> Symbol:
    """Return the absolute value of x with the sign of y."""
    return operation("copy_sign", x, y, kind=SymbolKind.NUMBER)


@_function
def sin_cos(x: Symbol) -> tuple[Symbol, Symbol]:
    """Return sine and cosine of an angle, rad."""
    rounded = multiply_add(x, 2.0 / math.pi, _ROUNDING_OFFSET)
    quadrant, bits = rounded - _ROUNDING_OFFSET, float_bits(rounded)
    r = multiply_add(quadrant, -_HALF_PI_PARTS[1], multiply_add(quadrant, -_HALF_PI_PARTS[0], x))
    r = select(abs(x) <= _MAX_ANGLE, r, math.nan)
    z = r * r
    sine = multiply_add(r * z, polynomial(z, _SINE_COEFFICIENTS), r)
    cosine = multiply_add(z * z, polynomial(z, _COSINE_COEFFICIENTS), multiply_add(z, -0.5, 1.0))
    odd = _is_negative(bits << _SIGN_SHIFT)
    # Sines are negative in the third and fourth quadrant, cosines in the second and third.
    sine_flag, cosine_flag = bits << _BELOW_SIGN_SHIFT, (bits + _ONE_BIT) << _BELOW_SIGN_SHIFT
    return _flip_sign(select(odd, cosine, sine), sine_flag), _flip_sign(select(odd, sine, cosine), cosine_flag)


def _flip_sign(x: Symbol, flag: Symbol) -> Symbol:
    """Return x with its sign flipped where the highest bit of the 64-bit word `flag` is set."""
    return _number_of(float_bits(x) ^ (flag & _SIGN_MASK))


@_function
def exp(x: Symbol) -> Symbol:
    """Return the exponential of x, which is infinite for x of at least 709.4."""
    # Both comparisons are false for NaN, so that NaN remains NaN.
    clamped = select(x < _MIN_EXP_ARGUMENT, _MIN_EXP_ARGUMENT, x)
    clamped = select(clamped > _MAX_EXP_ARGUMENT, _MAX_EXP_ARGUMENT, clamped)
    rounded = multiply_add(clamped, 1.0 / math.log(2.0), _ROUNDING_OFFSET)
    exponent = rounded - _ROUNDING_OFFSET
    r = multiply_add(exponent, -_LN_2_PARTS[1], multiply_add(exponent, -_LN_2_PARTS[0], clamped))
    mantissa = 1.0 + multiply_add(r * r, polynomial(r, _EXP_COEFFICIENTS), r)
    return mantissa * _number_of((float_bits(rounded) + _EXPONENT_BIAS) << _EXPONENT_SHIFT)


@_function
def tanh(x: Symbol) -> Symbol:
    """Return the hyperbolic tangent of x."""
    magnitude = abs(x)
    large = 1.0 - 2.0 / (exp(2.0 * magnitude) + 1.0)
    return select(magnitude < _MAX_SMALL_TANH_ARGUMENT, _odd(x, _TANH_COEFFICIENTS), copysign(large, x))


@_function
def erf(x: Symbol) -> Symbol:
    """Return the error function of x."""
    magnitude, z = abs(x), x * x
    clamped = select(magnitude > _MAX_ERF_ARGUMENT, _MAX_ERF_ARGUMENT, magnitude)
    large = 1.0 - exp(-(clamped * clamped)) * polynomial(14.4 / (clamped + 3.0) - 2.6, _ERFC_COEFFICIENTS)
    small = multiply_add(x, multiply_add(z, polynomial(z, _ERF_COEFFICIENTS), _ERF_SLOPE_MINUS_ONE), x)
    return select(magnitude < 1.0, small, copysign(large, x))


@_function
def log(x: Symbol, *, normal: bool) -> Symbol:
    """Return the natural logarithm of x; `normal` selects a faster variant for positive normal numbers."""
    # This addition increments the exponent of numbers whose mantissa is at least √2. Reduced mantissas are then from √½
    # to √2.
    bits = float_bits(x) + (_BITS_OF_ONE - _BITS_OF_SQRT_HALF)
    f = _number_of((bits & _MANTISSA_MASK) + _BITS_OF_SQRT_HALF) - 1.0
    # The exponent is converted to a float by adding it to the bits of the rounding offset.
    exponent = _number_of((bits >> _EXPONENT_SHIFT) + np.float64(_ROUNDING_OFFSET).view(np.uint64)) - (
        _ROUNDING_OFFSET + 1023.0
    )
    # 1 + f = (1 + s) / (1 - s), and 2 s = f - f²/2 + s f²/2.
    s = f / (2.0 + f)
    z, half = s * s, 0.5 * f * f
    rest = multiply_add(exponent, _LN_2_PARTS[1], s * (half + z * polynomial(z, _LOG_COEFFICIENTS)))
    result = multiply_add(exponent, _LN_2_PARTS[0], f - (half - rest))
    if normal:
        return result
    result = select(x >= _MIN_NORMAL, result, select(x >= 0.0, -math.inf, math.nan))
    return select(x < math.inf, result, x)


@_function
def log1p(x: Symbol) -> Symbol:
    """Return the natural logarithm of 1 + x for x >= 0; it is accurate for small x."""
    rounded = 1.0 + x
    is_tiny = rounded == 1.0
    # The factor x / (rounded - 1) corrects the rounding error of the sum 1 + x.
    return select(is_tiny, x, log(rounded, normal=False) * (x / select(is_tiny, 1.0, rounded - 1.0)))


@_function
def arctan(x: Symbol, *, small: bool) -> Symbol:
    """Return the inverse tangent, rad; `small` selects a faster variant for |x| up to 1/8."""
    if small:
        return _odd(x, _SMALL_ARCTAN_COEFFICIENTS)
    return copysign(_slope_angle(abs(x), 1.0), x)


@_function
def arctan2(y: Any, x: Any) -> Symbol:
    """Return the angle of the point (x, y), rad."""
    y, x = to_symbols(y, x)
    angle = _slope_angle(abs(y), abs(x))
    return copysign(select(copysign(1.0, x) < 0.0, math.pi - angle, angle), y)


def _slope_angle(rise: Symbol, run: Any) -> Symbol:
    """Return the angle, rad, of a slope with a non-negative rise and run; zero if both are zero."""
    flat, steep = rise <= _TAN_PI_8 * run, rise > _TAN_3_PI_8 * run
    # A single division covers three ranges: t is the tangent of the angle, of the angle minus π/4, or of the angle
    # minus π/2.
    numerator = select(flat, rise, select(steep, -run, rise - run))
    denominator = select(flat, run, select(steep, rise, rise + run))
    t = numerator / select(denominator == 0.0, 1.0, denominator)
    z = t * t
    base = select(flat, 0.0, select(steep, _HALF_PI_PARTS[0], 0.5 * _HALF_PI_PARTS[0]))
    rest = select(flat, 0.0, select(steep, _HALF_PI_PARTS[1], 0.5 * _HALF_PI_PARTS[1]))
    return base + (multiply_add(t * z, polynomial(z, _ARCTAN_COEFFICIENTS), t) + rest)


@_function
def arcsin(x: Symbol, *, small: bool) -> Symbol:
    """Return the inverse sine, rad, NaN outside [-1, 1]; `small` selects a faster variant for |x| up to 1/2."""
    if small:
        return _odd(x, _ARCSIN_COEFFICIENTS)
    return arctan2(x, sqrt((1.0 - x) * (1.0 + x)))


def wrap_angle(angle: Symbol) -> Symbol:
    """Wrap an angle to [-π, π], rad."""
    return angle - math.tau * nearest(angle * (1.0 / math.tau))


def from_uint64(word: Symbol) -> Symbol:
    """Convert a 64-bit unsigned integer below 2**52 to a float."""
    return _number_of(word | _BITS_OF_TWO_52) - _TWO_52


def to_uint64(x: Symbol) -> Symbol:
    """Convert a whole number from 0 to 2**52 - 1 to a 64-bit unsigned integer."""
    return float_bits(x + _TWO_52) ^ _BITS_OF_TWO_52


def float_bits(x: Symbol) -> Symbol:
    """Return the bits of a float as a 64-bit word."""
    return operation("float_bits", x, kind=SymbolKind.WORD)


def _number_of(bits: Symbol) -> Symbol:
    return operation("number_of", bits, kind=SymbolKind.NUMBER)


def _is_negative(bits: Symbol) -> Symbol:
    """Return whether the sign bit of a 64-bit word is set."""
    return operation("sign_bit", bits, kind=SymbolKind.TRUTH)
