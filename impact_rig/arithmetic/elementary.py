# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Sine and cosine, exponential, logarithm and roots, computed only with +, −, ×, ÷ and sqrt.

The results are the same bits on every machine.

    sin x, cos x    x = k π/2 + r, |r| <= π/4: polynomials of degree 13 and 14 in r          error < 1 ulp
    exp x           x = k ln 2 + r, |r| <= ln 2 / 2: e^r = 1 + 2 r / (2 − c(r²))             error < 1 ulp
    log x           x = 2^k (1 + f): 2 s + s³ R(s²), s = f / (2 + f)                         error < 1 ulp

Argument reductions and polynomials are those of fdlibm (Sun Microsystems 1993), after Cody & Waite (1980), Software
Manual for the Elementary Functions. test/impact_rig/arithmetic compares each function with 40 digits.
"""

from __future__ import annotations

import math

import numpy as np

from impact_rig.kernels import kernel

PI = 3.141592653589793
TWO_PI = 6.283185307179586

_TWO_OVER_PI = 0.6366197723675814
_HALF_PI_1 = 1.5707963267341256  # π/2 in pieces of 33 bits: k times the first two is exact up to k = 2^20
_HALF_PI_2 = 6.077100506303966e-11
_HALF_PI_3 = 2.0222662487959506e-21

_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11

_LN2_HIGH, _LN2_LOW, _PER_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10, 1.44269504088896338700
_P1, _P2, _P3 = 1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05
_P4, _P5 = -1.65339022054652515390e-06, 4.13813679705723846039e-08

_L1, _L2, _L3 = 6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01
_L4, _L5, _L6 = 2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01
_L7 = 1.479819860511658591e-01
_HALF_SQRT_2 = 0.7071067811865476

_LOWEST_EXPONENT, _HIGHEST_EXPONENT = -1022, 1023
_POWERS_OF_TWO = np.array([math.ldexp(1.0, k) for k in range(_LOWEST_EXPONENT, _HIGHEST_EXPONENT + 1)])
_LARGEST_EXPONENT, _SMALLEST_EXPONENT = 709.0, -708.0
_ROUND = 6755399441055744.0  # 1.5 · 2^52: adding and subtracting it rounds to an integer


@kernel
def nearest(x: float) -> float:
    """Return the integer nearest to x, for |x| < 2^51; halfway between two integers, return the even one."""
    return (x + _ROUND) - _ROUND


@kernel
def sincos(x: float) -> tuple[float, float]:
    """Return (sin x, cos x), x in radians.

    The error is within 1 ulp up to |x| = 1.6e6. For larger |x|, up to 2^51, there is an additional error of about the
    spacing of floats at x. Beyond 2^51, the results are meaningless.
    """
    k = (x * _TWO_OVER_PI + _ROUND) - _ROUND
    first, second = x - k * _HALF_PI_1, k * _HALF_PI_2  # both exact
    high = first - second
    low = k * _HALF_PI_3 - ((first - high) - second)
    r = high - low
    rest = (high - r) - low  # r + rest is x − k π/2 to twice the digits
    z = r * r
    s = r * (z * (_S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * _S6)))) + _S1) * z
    sine = r + (s + rest * (1.0 - 0.5 * z))
    c = z * z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * _C6)))))
    half = 0.5 * z
    whole = 1.0 - half
    cosine = whole + (((1.0 - whole) - half) + (c - r * rest))
    quadrant = k - 4.0 * math.floor(0.25 * k)
    if quadrant == 0.0:
        return sine, cosine
    if quadrant == 1.0:
        return cosine, -sine
    if quadrant == 2.0:
        return -sine, -cosine
    return -cosine, sine


@kernel
def exp(x: float) -> float:
    """Return e^x within 1 ulp; 0 below x = −708, infinity from x = 709 on, NaN for NaN."""
    if not x < _LARGEST_EXPONENT:
        return x if x != x else math.inf  # noqa: PLR0124  # only a NaN differs from itself
    if x < _SMALLEST_EXPONENT:
        return 0.0
    k = (x * _PER_LN2 + _ROUND) - _ROUND
    high, low = x - k * _LN2_HIGH, k * _LN2_LOW
    r = high - low
    z = r * r
    c = r - z * (_P1 + z * (_P2 + z * (_P3 + z * (_P4 + z * _P5))))
    value = 1.0 - ((low - (r * c) / (2.0 - c)) - high)
    return value * _POWERS_OF_TWO[int(k) - _LOWEST_EXPONENT]


@kernel
def log(x: float) -> float:
    """Return the natural logarithm of a finite x > 0, within 1 ulp."""
    mantissa, exponent = math.frexp(x)
    if mantissa < _HALF_SQRT_2:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    k = float(exponent)
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    r = z * (_L1 + z * (_L2 + z * (_L3 + z * (_L4 + z * (_L5 + z * (_L6 + z * _L7))))))
    half = 0.5 * f * f
    return k * _LN2_HIGH - ((half - (s * (half + r) + k * _LN2_LOW)) - f)


@kernel
def power(x: float, y: float) -> float:
    """Return x^y for a finite x > 0, with an error within (1 + 3 |y ln x|) ulp; return 0 for x <= 0."""
    return exp(y * log(x)) if x > 0.0 else 0.0


@kernel
def modulus(z: complex) -> float:
    """Return |z| of a complex number; infinity if a square of its parts overflows."""
    return math.sqrt(z.real * z.real + z.imag * z.imag)
