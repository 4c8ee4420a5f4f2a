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
"""Arithmetic with 70 digits, for constants that are computed once and rounded once: the same bits on every machine.

`decimal` rounds +, −, ×, ÷, sqrt, exp and ln correctly by its specification, so its results depend on no library of the
machine. Cancellation does no harm, because the constants are rounded to only 16 digits.

    polynomial p(s) = Σ c_j s^j                    roots by Aberth's method: Newton steps that repel each other
    resolvent (s I − M)⁻¹ = Σ_j B_j s^j / p(s)     B and p by the recurrence of Faddeev and LeVerrier
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from decimal import MAX_EMAX, MIN_EMIN, ROUND_HALF_EVEN, Context, Decimal, DivisionByZero, InvalidOperation
from decimal import localcontext as local_context
from typing import ParamSpec, TypeVar

import attrs

DIGITS = 70
CONTEXT = Context(
    prec=DIGITS, rounding=ROUND_HALF_EVEN, Emin=MIN_EMIN, Emax=MAX_EMAX, traps=[InvalidOperation, DivisionByZero]
)
_SETTLED = Decimal("1e-30")
"""Relative size of a root's last correction below which the root is final; the next correction is of the order of its
square.
"""
_BLUR = Decimal("1e-40")  # an imaginary part below this part of the root counts as zero
_MOST_CORRECTIONS = 120

ZERO, ONE, TWO = Decimal(0), Decimal(1), Decimal(2)
Matrix = Sequence[Sequence[Decimal]]
P = ParamSpec("P")
R = TypeVar("R")


def with_70_digits(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function so that it computes with `DIGITS` (70) digits.

    The decimal context of the caller has no effect.
    """

    @functools.wraps(function)
    def in_context(*args: P.args, **kwargs: P.kwargs) -> R:
        with local_context(CONTEXT):
            return function(*args, **kwargs)

    return in_context


@attrs.frozen
class Complex:
    """Complex number with Decimals as parts.

    Its operators use the decimal context of the caller.
    """

    real: Decimal
    imag: Decimal = ZERO

    def __add__(self, other: Complex) -> Complex:
        return Complex(self.real + other.real, self.imag + other.imag)

    def __sub__(self, other: Complex) -> Complex:
        return Complex(self.real - other.real, self.imag - other.imag)

    def __mul__(self, other: Complex) -> Complex:
        return Complex(self.real * other.real - self.imag * other.imag, self.real * other.imag + self.imag * other.real)

    def __truediv__(self, other: Complex) -> Complex:
        size = other.square()
        return Complex(
            (self.real * other.real + self.imag * other.imag) / size,
            (self.imag * other.real - self.real * other.imag) / size,
        )

    def __neg__(self) -> Complex:
        return Complex(-self.real, -self.imag)

    def __complex__(self) -> complex:
        return complex(float(self.real), float(self.imag))

    def square(self) -> Decimal:
        """Return the squared modulus, real² + imag²."""
        return self.real * self.real + self.imag * self.imag

    def conjugate(self) -> Complex:
        """Return the complex conjugate."""
        return Complex(self.real, -self.imag)


def exactly(value: complex) -> Complex:
    """Convert a float or a complex to a `Complex` without rounding."""
    return Complex(Decimal(value.real), Decimal(value.imag))


def product(factors: Iterable[Complex]) -> Complex:
    """Return the product of the factors, or 1 if there are none.

    The computation uses the decimal context of the caller.
    """
    total = Complex(ONE)
    for factor in factors:
        total = total * factor
    return total


@functools.cache
@with_70_digits
def pi() -> Decimal:
    """Return π to `DIGITS` digits, as 16 atan(1/5) − 4 atan(1/239) (Machin)."""
    return 16 * _arc_tangent_of_inverse(5) - 4 * _arc_tangent_of_inverse(239)


def _arc_tangent_of_inverse(n: int) -> Decimal:
    power, total, k = ONE / n, ZERO, 0
    while total + power / (2 * k + 1) != total:
        total += power / (2 * k + 1)
        power /= -n * n
        k += 1
    return total


@with_70_digits
def unit(angle: Decimal) -> Complex:
    """Return e^{i angle}, the angle in radians, to `DIGITS` digits for an angle of at most a few turns."""
    term, total, k = Complex(ONE), Complex(ONE), 0
    while True:
        k += 1
        term = Complex(-term.imag * angle / k, term.real * angle / k)
        following = total + term
        if following == total and k > abs(angle):
            return total
        total = following


def evaluate(coefficients: Sequence[Decimal], s: Complex) -> Complex:
    """Return the polynomial p(s) = Σ c_j s^j with the coefficients c_j, constant first.

    The computation uses the decimal context of the caller.
    """
    value = Complex(ZERO)
    for c in reversed(coefficients):
        value = value * s
        value = Complex(value.real + c, value.imag)
    return value


def evaluate_with_slope(coefficients: Sequence[Decimal], s: Complex) -> tuple[Complex, Complex]:
    """Return p(s) and p'(s) of the polynomial p(s) = Σ c_j s^j with the coefficients c_j, constant first.

    The computation uses the decimal context of the caller.
    """
    value, slope = Complex(ZERO), Complex(ZERO)
    for c in reversed(coefficients):
        slope = slope * s + value
        value = value * s
        value = Complex(value.real + c, value.imag)
    return value, slope


@with_70_digits
def roots(coefficients: Sequence[Decimal], start: Sequence[complex]) -> list[Complex] | None:
    """Return the roots of a real polynomial, or None if the iteration fails.

    The iteration fails, for example, if roots are too close together. Real roots are listed first, in descending order.
    Then one root of each conjugate pair follows (imaginary part > 0), in ascending order of the imaginary part.

    Args:
        coefficients: constant first.
        start: approximate values of all roots, in any order; they do not affect the first 30 digits of the roots.
    """
    found = [exactly(z * complex(1.0, 1e-14 * k)) for k, z in enumerate(start)]  # equal values are moved apart
    for _ in range(_MOST_CORRECTIONS):
        settled = True
        for k, z in enumerate(found):
            step = _correction(coefficients, z, [other for j, other in enumerate(found) if j != k])
            if step is None:
                return None
            found[k] = z - step
            settled = settled and step.square() <= _SETTLED * _SETTLED * z.square()
        if settled:
            return _paired(found)
    return None


def _correction(coefficients: Sequence[Decimal], z: Complex, others: list[Complex]) -> Complex | None:
    """Return Aberth's step p / (p' − p Σ 1 / (z − other)) for the approximation z of one root of a polynomial p.

    The step improves z and is to be subtracted from it. `coefficients` are those of p, constant first, and `others` are
    the approximations of the other roots. The step is 0 if z is a root. Otherwise it is None if z equals one of
    `others`, or if the denominator is 0.
    """
    value, slope = evaluate_with_slope(coefficients, z)
    if not value.square():
        return value
    repelled = slope
    for other in others:
        apart = z - other
        if not apart.square():
            return None
        repelled = repelled - value / apart
    return value / repelled if repelled.square() else None


def _paired(found: list[Complex]) -> list[Complex] | None:
    """Return the real roots, then the roots with a positive imaginary part, both sorted as `roots` returns them.

    A root counts as real, and loses its imaginary part, if the imaginary part is at most `_BLUR` times the real part.
    The result is None if the complex roots are not in conjugate pairs, judged by their number.
    """
    real = [Complex(z.real) for z in found if abs(z.imag) <= _BLUR * abs(z.real)]
    upper = [z for z in found if z.imag > _BLUR * abs(z.real)]
    if len(real) + 2 * len(upper) != len(found):
        return None
    return sorted(real, key=lambda z: -z.real) + sorted(upper, key=lambda z: z.imag)


@with_70_digits
def resolvent(matrix: Matrix) -> tuple[list[Decimal], list[list[list[Decimal]]]]:
    """Return p and B of the resolvent (s I − M)⁻¹ = Σ_j B_j s^j / p(s) of an n × n matrix M.

    The shapes are (n + 1,) and (n, n, n), constants first. p is the characteristic polynomial Σ c_j s^j. B_{n−1} = I
    and c_n = 1. Then c_j = −trace(M B_j) / (n − j) and B_{j−1} = M B_j + c_j I, for j = n − 1, …, 0. The computation
    has `DIGITS` digits.
    """
    n = len(matrix)
    places = range(n)
    polynomial = [ZERO] * n + [ONE]
    adjugate = [[[ONE if i == j else ZERO for j in places] for i in places]]
    for j in reversed(places):
        moved = [[dot(matrix[i], [row[m] for row in adjugate[0]]) for m in places] for i in places]
        polynomial[j] = -sum((moved[i][i] for i in places), ZERO) / (n - j)
        if j:
            for i in places:
                moved[i][i] += polynomial[j]
            adjugate.insert(0, moved)
    return polynomial, adjugate


def dot(first: Sequence[Decimal], second: Sequence[Decimal]) -> Decimal:
    """Return Σ first_i second_i; products with a zero are skipped."""
    return sum((a * b for a, b in zip(first, second, strict=True) if a and b), ZERO)


def modulus(z: Complex) -> Decimal:
    """Return |z| of a complex number."""
    return z.square().sqrt()


def square_root(z: Complex) -> Complex:
    """Return the square root of z whose real part is >= 0.

    If Re z >= 0, it is a/2 + i Im z / a with a² = 2 (|z| + Re z), and 0 for z = 0. Otherwise it follows from the root
    of −z.
    """
    if z.real < 0:
        mirrored = square_root(-z)
        return Complex(abs(mirrored.imag), mirrored.real.copy_sign(z.imag))
    real = ((modulus(z) + z.real) / 2).sqrt()
    return Complex(real, z.imag / (2 * real) if real else ZERO)
