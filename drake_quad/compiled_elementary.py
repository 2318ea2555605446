"""What `drake_quad.elementary` is in machine code: plain arithmetic, so that a loop over vehicles becomes vectors.

The functions agree with those of a mathematical library within two units in the last place. Other than there, angles
beyond a million are not a number, and what is smaller than 1e-307 may be zero. They reduce the argument and take the
minimax approximations of S. L. Moshier, "Methods and Programs for Mathematical Functions", 1989, as in his Cephes
library.
"""

import math
from typing import Any

import numpy as np
from numba.extending import overload, register_jitable

from drake_quad import elementary

# How formulas are compiled: into what calls them, without exceptions where NumPy has none; and a product may be rounded
# together with the sum that it is a part of.
INLINED: dict[str, Any] = {"forceinline": True, "error_model": "numpy", "fastmath": {"contract"}}

# Added and taken away again, it rounds to a whole number, which then stands in the lowest bits.
_ROUNDING = 1.5 * 2.0**52
_EXPONENT_BITS, _BIAS = np.int64(52), np.int64(1023)
_SMALLEST_NORMAL = 2.0**-1022
_MANTISSA, _HALF = np.int64(2**52 - 1), np.int64(1022 * 2**52)

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
_EXP_P = (1.26177193074810590878e-4, 3.02994407707441961300e-2, 9.99999999999999999910e-1)
_EXP_Q = (
    3.00198505138664455042e-6,
    2.52448340349684104192e-3,
    2.27265548208155028766e-1,
    2.00000000000000000009e0,
)
_LARGEST_EXPONENT, _LEAST_EXPONENT = 709.0, -708.0
_LOG_P = (
    1.01875663804580931796e-4,
    4.97494994976747001425e-1,
    4.70579119878881725854e0,
    1.44989225341610930846e1,
    1.79368678507819816313e1,
    7.70838733755885391666e0,
)
_LOG_Q = (
    1.12873587189167450590e1,
    4.52279145837532221105e1,
    8.29875266912776603211e1,
    7.11544750618563894466e1,
    2.31251620126765340583e1,
)
_ATAN_P = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_ATAN_Q = (
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)
_TAN_3_EIGHTH = math.tan(3.0 * math.pi / 8.0)
# What π/2 is more than its nearest number.
_MORE_THAN_HALF_PI = 6.123233995736765886130e-17


def _compiles(function: Any) -> Any:
    """Makes a function what another one is in machine code."""

    def decorate(compiled: Any) -> Any:
        overload(
            function, strict=False, jit_options={"forceinline": True, "error_model": "numpy", "fastmath": {"contract"}}
        )(lambda *types: compiled)
        return compiled

    return decorate


@register_jitable(**INLINED)
def _rounded(x: float) -> float:
    """The nearest whole number, of a float below 2**51."""
    return (x + _ROUNDING) - _ROUNDING


@_compiles(elementary.sin_cos)
def _sin_cos(x: float) -> tuple[float, float]:
    quarters = _rounded(x * (2.0 / math.pi))
    r = ((x - quarters * _QUARTER[0]) - quarters * _QUARTER[1]) - quarters * _QUARTER[2]
    z = r * r
    s_1, s_2, s_3, s_4, s_5, s_6 = _SINE
    c_1, c_2, c_3, c_4, c_5, c_6 = _COSINE
    sine = r + r * z * (s_1 + z * (s_2 + z * (s_3 + z * (s_4 + z * (s_5 + z * s_6)))))
    cosine = 1.0 - 0.5 * z + z * z * (c_1 + z * (c_2 + z * (c_3 + z * (c_4 + z * (c_5 + z * c_6)))))
    halves = _rounded(0.5 * quarters - 0.25)
    odd, turned = quarters - 2.0 * halves, halves - 2.0 * _rounded(0.5 * halves - 0.25)
    sign = 1.0 - 2.0 * turned if abs(x) <= _LARGEST_ANGLE else math.nan
    return sign * (cosine if odd > 0.5 else sine), sign * (-sine if odd > 0.5 else cosine)


@_compiles(elementary.exp)
def _exp(x: float) -> float:
    clamped = min(max(x, _LEAST_EXPONENT), _LARGEST_EXPONENT)
    power = np.float64(_ROUNDING + clamped * (1.0 / math.log(2.0)))
    twos = power - _ROUNDING
    r = (clamped - twos * _LN_2[0]) - twos * _LN_2[1]
    z = r * r
    p_1, p_2, p_3 = _EXP_P
    q_1, q_2, q_3, q_4 = _EXP_Q
    odd = r * ((p_1 * z + p_2) * z + p_3)
    mantissa = 1.0 + 2.0 * odd / (((q_1 * z + q_2) * z + q_3) * z + q_4 - odd)
    scale = np.int64((power.view(np.int64) + _BIAS) << _EXPONENT_BITS)
    result: float = mantissa * scale.view(np.float64)
    result = math.inf if x > _LARGEST_EXPONENT else (0.0 if x < _LEAST_EXPONENT else result)
    return result if x == x else x


@_compiles(elementary.log)
def _log(x: float) -> float:
    bits = np.float64(x).view(np.int64)
    mantissa = np.int64((bits & _MANTISSA) | _HALF).view(np.float64)
    # The exponent as a float: its bits in the lowest place of a number that rounds to a whole one.
    exponent = np.int64((bits >> _EXPONENT_BITS) + np.float64(_ROUNDING).view(np.int64)).view(np.float64) - (
        _ROUNDING + 1022.0
    )
    small = mantissa < math.sqrt(0.5)
    exponent = exponent - 1.0 if small else exponent
    r = 2.0 * mantissa - 1.0 if small else mantissa - 1.0
    z = r * r
    p_1, p_2, p_3, p_4, p_5, p_6 = _LOG_P
    q_1, q_2, q_3, q_4, q_5 = _LOG_Q
    above = ((((p_1 * r + p_2) * r + p_3) * r + p_4) * r + p_5) * r + p_6
    below = ((((r + q_1) * r + q_2) * r + q_3) * r + q_4) * r + q_5
    y = r * (z * above / below) - exponent * 2.121944400546905827679e-4 - 0.5 * z
    result: float = (r + y) + exponent * 0.693359375
    result = result if x >= _SMALLEST_NORMAL else (-math.inf if x >= 0.0 else math.nan)
    return result if x < math.inf else x


@_compiles(elementary.log_of_1_plus)
def _log_of_1_plus(x: float) -> float:
    rounded = 1.0 + x
    lost = rounded == 1.0
    # What was lost in the sum is lost in the difference, too.
    return x if lost else elementary.log(rounded) * (x / (1.0 if lost else rounded - 1.0))


@_compiles(elementary.arctan)
def _arctan(x: float) -> float:
    size = abs(x)
    steep, middling = size > _TAN_3_EIGHTH, size > 0.66
    argument = -1.0 / size if steep else ((size - 1.0) / (size + 1.0) if middling else size)
    base = 0.5 * math.pi if steep else (0.25 * math.pi if middling else 0.0)
    rest = _MORE_THAN_HALF_PI if steep else (0.5 * _MORE_THAN_HALF_PI if middling else 0.0)
    z = argument * argument
    p_1, p_2, p_3, p_4, p_5 = _ATAN_P
    q_1, q_2, q_3, q_4, q_5 = _ATAN_Q
    above = (((p_1 * z + p_2) * z + p_3) * z + p_4) * z + p_5
    below = ((((z + q_1) * z + q_2) * z + q_3) * z + q_4) * z + q_5
    result = base + (argument * (z * above / below) + argument + rest)
    return math.copysign(result, x)


@_compiles(elementary.arctan2)
def _arctan2(y: float, x: float) -> float:
    across, along = abs(y), abs(x)
    steep = across > along
    ratio = (along if steep else across) / (across if steep else along)
    angle = elementary.arctan(0.0 if across + along == 0.0 else ratio)
    angle = 0.5 * math.pi - angle if steep else angle
    angle = math.pi - angle if math.copysign(1.0, x) < 0.0 else angle
    return math.copysign(angle, y)


@_compiles(elementary.cos)
def _cos(x: float) -> float:
    return elementary.sin_cos(x)[1]


@_compiles(elementary.arcsin)
def _arcsin(x: float) -> float:
    return elementary.arctan2(x, elementary.sqrt((1.0 - x) * (1.0 + x)))


@_compiles(elementary.sqrt)
def _sqrt(x: float) -> float:
    return math.sqrt(x)


@_compiles(elementary.maximum)
def _maximum(x: float, y: float) -> float:
    return x if x > y else y


@_compiles(elementary.minimum)
def _minimum(x: float, y: float) -> float:
    return x if x < y else y


@_compiles(elementary.where)
def _where(mask: bool, x: Any, y: Any) -> Any:
    return x if mask else y


@_compiles(elementary.wrapped)
def _wrapped(angle: float) -> float:
    return angle - math.tau * np.rint(angle / math.tau)
