"""Sines, logarithms and the like with the same bits on every machine.

A C library computes them as its processor likes, and the last bit differs between x86-64 and aarch64, between glibc and
musl, even between two PCs. These use only what IEEE 754 fixes to the last bit: + - * / and square roots, in a fixed
order. So a recording replays to the same numbers everywhere. Kernels call
these; the translator to C rejects `math.sin`.

sin, cos, atan, exp and log are within 1 ulp of the exact value, the others within 2, erf within 10. Infinities, NaN and
signed zeros are as in C; outside its domain a function returns NaN, and none raises. An angle beyond 1e6 rad is first
reduced by the double nearest to 2 pi, so n turns cost n * 2.4e-16 rad.

Source: the argument reductions and coefficients are those of fdlibm (Sun Microsystems, 1993, freely distributable); the
error function is its power series and its continued fraction (Abramowitz and Stegun 7.1.6, 7.1.14).
"""

import math

import numpy as np

from .bits import float_bits, float_of_bits
from .jit import kernel

_MANTISSA_BITS, _BIAS = 52, 1023
_FRACTION = (1 << _MANTISSA_BITS) - 1
_ROUNDER = 6755399441055744.0  # 1.5 * 2^52: added and subtracted, it rounds to an integer
_TURN = 2.0 * math.pi
_LARGE_ANGLE = 1e6
_TWO_OVER_PI = 2.0 / math.pi
# pi / 2 in three parts, the first two of 33 bits, so that n times them is exact
_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21
_HALF_PI, _HALF_PI_LOW = math.pi / 2.0, 6.12323399573676603587e-17  # as two doubles
_LN2 = 0.693147180559945309417
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_LARGEST_EXP, _LEAST_EXP = 709.782712893383973096, -745.133219101941108420
_SIN = (
    *(-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04),
    *(2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10),
)
_COS = (
    *(4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05),
    *(-2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11),
)
_EXP = (
    *(1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05),
    *(-1.65339022054652515390e-06, 4.13813679705723846039e-08),
)
_LOG = (
    *(6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01),
    *(1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01),
)
_ATAN = (
    *(3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01),
    *(-1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02),
    *(6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02),
    *(-3.65315727442169155270e-02, 1.62858201153657823623e-02),
)
_ATAN_AT = (0.463647609000806093515, math.pi / 4.0, 0.982793723247329054082)  # of 0.5, 1 and 1.5
_ATAN_AT_LOW = (2.26987774529616870924e-17, 3.06161699786838301793e-17, 1.39033110312309984516e-17)
_TWO_OVER_ROOT_PI = 1.1283791670955126
_SERIES_UP_TO = 2.5  # from here on the continued fraction of erfc needs fewer terms
_SATURATED_ERF = 6.0  # 1 - erf(6) is 2e-17


@kernel
def _reduced(x: float) -> tuple[float, float, float]:
    """x less the nearest multiple of pi / 2, in two parts, and that multiple modulo 4."""
    if abs(x) > _LARGE_ANGLE:
        x = np.fmod(x, _TURN)
    n = (x * _TWO_OVER_PI + _ROUNDER) - _ROUNDER
    left = x - n * _HALF_PI_1
    second = n * _HALF_PI_2
    high = left - second
    low = ((left - high) - second) - n * _HALF_PI_3
    r = high + low
    return r, (high - r) + low, n - 4.0 * math.floor(0.25 * n)


@kernel
def _sin_near_zero(x: float, low: float) -> float:
    """The sine of x + low, |x| <= pi / 4."""
    z = x * x
    v = z * x
    r = _SIN[1] + z * (_SIN[2] + z * (_SIN[3] + z * (_SIN[4] + z * _SIN[5])))
    return x - ((z * (0.5 * low - v * r) - low) - v * _SIN[0])


@kernel
def _cos_near_zero(x: float, low: float) -> float:
    """The cosine of x + low, |x| <= pi / 4."""
    z = x * x
    r = z * (_COS[0] + z * (_COS[1] + z * (_COS[2] + z * (_COS[3] + z * (_COS[4] + z * _COS[5])))))
    half = 0.5 * z
    w = 1.0 - half
    return w + (((1.0 - w) - half) + (z * r - x * low))


@kernel
def sin(x: float) -> float:
    """The sine of an angle in rad."""
    r, low, quadrant = _reduced(x)
    value = _sin_near_zero(r, low) if quadrant in (0.0, 2.0) else _cos_near_zero(r, low)
    return x if x == 0.0 else (-value if quadrant >= 2.0 else value)


@kernel
def cos(x: float) -> float:
    """The cosine of an angle in rad."""
    r, low, quadrant = _reduced(x)
    value = _cos_near_zero(r, low) if quadrant in (0.0, 2.0) else _sin_near_zero(r, low)
    return -value if quadrant in (1.0, 2.0) else value


@kernel
def tan(x: float) -> float:
    """The tangent of an angle in rad."""
    return sin(x) / cos(x)


@kernel
def atan(x: float) -> float:
    """The angle in rad, -pi/2 to pi/2, whose tangent this is."""
    a = abs(x)
    if a < 0.4375:
        at, low, t = 0.0, 0.0, a
    elif a < 0.6875:
        at, low, t = _ATAN_AT[0], _ATAN_AT_LOW[0], (2.0 * a - 1.0) / (2.0 + a)
    elif a < 1.1875:
        at, low, t = _ATAN_AT[1], _ATAN_AT_LOW[1], (a - 1.0) / (a + 1.0)
    elif a < 2.4375:
        at, low, t = _ATAN_AT[2], _ATAN_AT_LOW[2], (a - 1.5) / (1.0 + 1.5 * a)
    else:
        at, low, t = _HALF_PI, _HALF_PI_LOW, -1.0 / a
    z = t * t
    w = z * z
    even = z * (_ATAN[0] + w * (_ATAN[2] + w * (_ATAN[4] + w * (_ATAN[6] + w * (_ATAN[8] + w * _ATAN[10])))))
    odd = w * (_ATAN[1] + w * (_ATAN[3] + w * (_ATAN[5] + w * (_ATAN[7] + w * _ATAN[9]))))
    value = t - t * (even + odd) if at == 0.0 else at - ((t * (even + odd) - low) - t)
    return math.copysign(value, x)


@kernel
def atan2(y: float, x: float) -> float:
    """The angle in rad, -pi to pi, from the positive x axis to the point (x, y)."""
    if math.isnan(x) or math.isnan(y):
        return x + y
    a, b = abs(y), abs(x)
    if a == 0.0:
        angle = 0.0
    elif math.isinf(a) and math.isinf(b):
        angle = 0.25 * math.pi
    elif b == 0.0:
        angle = _HALF_PI
    else:
        angle = atan(a / b)
    if math.copysign(1.0, x) < 0.0:
        angle = math.pi - (angle - 2.0 * _HALF_PI_LOW)
    return math.copysign(angle, y)


@kernel
def asin(x: float) -> float:
    """The angle in rad, -pi/2 to pi/2, whose sine this is; NaN beyond 1."""
    return atan2(x, math.sqrt((1.0 - x) * (1.0 + x))) if abs(x) <= 1.0 else math.nan


@kernel
def acos(x: float) -> float:
    """The angle in rad, 0 to pi, whose cosine this is; NaN beyond 1."""
    return atan2(math.sqrt((1.0 - x) * (1.0 + x)), x) if abs(x) <= 1.0 else math.nan


@kernel
def _power_of_two(n: int) -> float:
    """2^n for n from -1022 to 1023."""
    return float_of_bits((n + _BIAS) << _MANTISSA_BITS)


@kernel
def exp(x: float) -> float:
    """e to the power of x."""
    if math.isnan(x):
        return x
    if x > _LARGEST_EXP:
        return math.inf
    if x < _LEAST_EXP:
        return 0.0
    n = math.floor(x / _LN2 + 0.5)
    high, low = x - n * _LN2_HIGH, n * _LN2_LOW
    r = high - low
    z = r * r
    c = r - z * (_EXP[0] + z * (_EXP[1] + z * (_EXP[2] + z * (_EXP[3] + z * _EXP[4]))))
    y = 1.0 - ((low - (r * c) / (2.0 - c)) - high)
    half = n >> 1  # in two steps: 2^n alone may be out of range
    return y * _power_of_two(half) * _power_of_two(n - half)


@kernel
def log(x: float) -> float:
    """The natural logarithm; -inf at zero, NaN below it."""
    if not x > 0.0:
        return -math.inf if x == 0.0 else math.nan
    if math.isinf(x):
        return x
    shift = 0
    if x < 2.2250738585072014e-308:  # subnormal
        x, shift = x * 18014398509481984.0, 54
    bits = float_bits(x)
    k = (bits >> _MANTISSA_BITS) - _BIAS - shift
    m = float_of_bits((bits & _FRACTION) | (_BIAS << _MANTISSA_BITS))  # 1 to 2
    if m > 1.4142135623730951:
        m, k = 0.5 * m, k + 1
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    odd = w * (_LOG[1] + w * (_LOG[3] + w * _LOG[5]))
    even = z * (_LOG[0] + w * (_LOG[2] + w * (_LOG[4] + w * _LOG[6])))
    half = 0.5 * f * f
    return k * _LN2_HIGH - ((half - (s * (half + odd + even) + k * _LN2_LOW)) - f)


@kernel
def hypot(x: float, y: float) -> float:
    """The length of the vector (x, y); infinite if either is."""
    if math.isinf(x) or math.isinf(y):
        return math.inf
    if math.isnan(x) or math.isnan(y):
        return x + y
    a, b = max(abs(x), abs(y)), min(abs(x), abs(y))
    if 1e-140 < a < 1e140:
        return math.sqrt(a * a + b * b)
    ratio = b / a if a > 0.0 else 0.0
    return a * math.sqrt(1.0 + ratio * ratio)


@kernel
def erf(x: float) -> float:
    """The error function: the probability that a normal variable of variance 1/2 is within +-x, with the sign of x."""
    a = abs(x)
    if math.isnan(x):
        return x
    if a >= _SATURATED_ERF:
        return math.copysign(1.0, x)
    if a < _SERIES_UP_TO:
        term, total, n = a, a, 0
        while term > 1e-18 * total:
            n += 1
            term *= 2.0 * a * a / (2 * n + 1)
            total += term
        return math.copysign(_TWO_OVER_ROOT_PI * exp(-a * a) * total, x)
    fraction = a
    for k in range(60, 0, -1):
        fraction = a + 0.5 * k / fraction
    return math.copysign(1.0 - 0.5 * _TWO_OVER_ROOT_PI * exp(-a * a) / fraction, x)
