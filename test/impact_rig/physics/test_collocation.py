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
"""The integrator's tables, recomputed to 40 digits."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from impact_rig.physics import collocation

DIGITS = 60


def radau_nodes(stages: int) -> list[mp.mpf]:
    """Roots of d^(n−1)/dx^(n−1) [x^(n−1) (x − 1)^n] in (0, 1], the right Radau points."""
    shifted = [mp.mpf(0)] * (2 * stages)  # coefficients of x^(n−1) (x − 1)^n, lowest first
    for k in range(stages + 1):
        shifted[stages - 1 + k] = mp.binomial(stages, k) * (-1) ** (stages - k)
    derivative = shifted
    for _ in range(stages - 1):
        derivative = [n * c for n, c in enumerate(derivative)][1:]
    return sorted(mp.re(root) for root in mp.polyroots(derivative, maxsteps=500, extraprec=500, asc=True))


@pytest.fixture(scope="module")
def tables() -> dict[str, mp.matrix]:
    with mp.workdps(DIGITS):
        nodes = radau_nodes(collocation.STAGES)
        n = len(nodes)
        powers = mp.matrix(n, n)
        integrals = mp.matrix(n, n)
        for i, c in enumerate(nodes):
            for j in range(n):
                powers[i, j] = c**j
                integrals[i, j] = c ** (j + 1) / (j + 1)
        matrix = integrals * powers**-1
        through_start = mp.matrix(n + 1, n + 1)
        for i, c in enumerate([mp.mpf(0), *nodes]):
            for j in range(n + 1):
                through_start[i, j] = mp.mpf(1) if j == 0 else c**j
        start = mp.matrix(1, n)
        start[0, 0] = 1
        eigenvalues, _ = mp.eig(matrix)
        return {
            "STAGE_AT": mp.matrix(nodes),
            "MATRIX": matrix,
            "INVERSE": matrix**-1,
            "TO_START": start * powers**-1,
            "TO_POLYNOMIAL": through_start**-1,
            "REAL_EIGENVALUE": min(eigenvalues, key=lambda value: abs(mp.im(value))),
        }


@pytest.mark.parametrize("name", ["STAGE_AT", "MATRIX", "INVERSE", "TO_START", "TO_POLYNOMIAL"])
def test_each_table_is_the_exact_one_rounded(tables, name):
    exact = tables[name]
    rounded = np.array([[float(mp.re(exact[i, j])) for j in range(exact.cols)] for i in range(exact.rows)])
    assert np.array_equal(np.squeeze(rounded), getattr(collocation, name))


def test_the_filter_of_the_error_estimate_is_the_real_eigenvalue(tables):
    assert float(mp.re(tables["REAL_EIGENVALUE"])) == collocation.REAL_EIGENVALUE


def test_the_quadrature_is_gauss_legendre():
    with mp.workdps(DIGITS):
        legendre = mp.taylor(lambda x: mp.legendre(8, x), 0, 8)
        nodes = sorted(mp.polyroots(legendre, maxsteps=500, extraprec=500, asc=True))
        slopes = [mp.diff(lambda x: mp.legendre(8, x), x) for x in nodes]
        weights = [2 / ((1 - x**2) * slope**2) for x, slope in zip(nodes, slopes, strict=True)]
    assert [float(x) for x in nodes] == list(collocation.GAUSS_NODES)
    assert [float(w) for w in weights] == list(collocation.GAUSS_WEIGHTS)
