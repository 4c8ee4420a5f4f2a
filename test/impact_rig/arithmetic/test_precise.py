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
"""Arithmetic with many digits, compared with mpmath; it does not depend on the decimal context of the thread."""

from __future__ import annotations

import decimal
from decimal import Decimal
from fractions import Fraction

import pytest

from impact_rig.arithmetic import precise
from impact_rig.arithmetic.precise import CONTEXT, DIGITS, Complex

mpmath = pytest.importorskip("mpmath")
LAST = mpmath.mpf(10) ** (3 - DIGITS)


@pytest.fixture(autouse=True)
def more_digits():
    with mpmath.workdps(DIGITS + 20):
        yield


def exact(z: Complex):
    return mpmath.mpc(str(z.real), str(z.imag))


@pytest.mark.parametrize("angle", ["0", "0.1", "-2.5", "6.28", "1e-20"])
def test_points_of_the_unit_circle_have_all_requested_digits(angle):
    assert abs(exact(precise.unit(Decimal(angle))) - mpmath.expj(mpmath.mpf(angle))) < LAST


def test_pi_has_all_requested_digits():
    assert abs(mpmath.mpf(str(precise.pi())) - mpmath.pi) < 10 * LAST


@pytest.mark.parametrize("z", [(3, -2), (-3, -2), (-3, 2), (-4, 0), (0, 0), (0, 2)])
def test_square_roots_have_all_requested_digits(z):
    with decimal.localcontext(CONTEXT):
        root = precise.square_root(Complex(Decimal(z[0]), Decimal(z[1])))
    assert root.real >= 0
    assert abs(exact(root) ** 2 - mpmath.mpc(*z)) < 10 * LAST


def test_distinct_roots_are_found_from_rough_values():
    wanted = [-(mpmath.mpf(2) ** 40), mpmath.mpc(-3, 1000), mpmath.mpc(-3, -1000), mpmath.mpf("-1e-9")]
    polynomial = [mpmath.mpf(1)]
    for root in wanted:
        polynomial = [b - root * a for a, b in zip([*polynomial, 0], [0, *polynomial], strict=True)]
    coefficients = [Decimal(mpmath.nstr(mpmath.re(c), DIGITS + 10)) for c in polynomial]
    for rough in (0.9, 1.0, 1.3):
        found = precise.roots(coefficients, [complex(root) * rough for root in wanted])
        assert [complex(z) for z in found] == [-1e-9, -(2.0**40), complex(-3, 1000)]


def test_coinciding_roots_are_rejected():
    assert precise.roots([Decimal(4), Decimal(4), Decimal(1)], [-2.0, -2.0]) in (None, [Complex(Decimal(-2))] * 2)


def test_the_resolvent_is_exact_for_whole_numbers():
    matrix = [[Decimal(v) for v in row] for row in ((1, 2, 0), (-3, 1, 4), (5, -1, 2))]
    polynomial, adjugate = precise.resolvent(matrix)
    s = Fraction(7, 3)
    p = sum(Fraction(c) * s**k for k, c in enumerate(polynomial))
    adj = [[sum(Fraction(b[i][j]) * s**k for k, b in enumerate(adjugate)) for j in range(3)] for i in range(3)]
    shifted = [[s * (i == j) - Fraction(matrix[i][j]) for j in range(3)] for i in range(3)]
    product = [[sum(shifted[i][k] * adj[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    assert product == [[p * (i == j) for j in range(3)] for i in range(3)]


def test_results_do_not_depend_on_the_decimal_context_of_the_thread():
    before = precise.unit(Decimal(1))
    with decimal.localcontext(decimal.Context(prec=5, rounding=decimal.ROUND_UP)):
        assert precise.unit(Decimal(1)) == before
