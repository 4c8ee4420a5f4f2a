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
"""Coefficients of Radau IIA collocation with five stages (order 9) and of Gauss–Legendre quadrature with eight points.

Radau IIA integrates the contacts (`contact_step`), Gauss–Legendre the energies (`energy`). Stage i of a step of length
h lies at c_i h (STAGE_AT). With slopes f_j at the stages, y_i = y_0 + h Σ_j A_ij f_j (A is MATRIX), and the last stage
is the end of the step. Source: Hairer & Wanner (1996), Solving Ordinary Differential Equations II, section IV.5.

The numbers are written out because a root finder may end in another last bit on another machine. test_collocation.py
recomputes them to 40 digits.
"""

from __future__ import annotations

import numpy as np

STAGES = 5
LAST = STAGES - 1
STAGE_AT = np.array([0.05710419611451768, 0.2768430136381238, 0.5835904323689168, 0.8602401356562195, 1.0])
MATRIX = np.array(
    [
        [0.07299886431790333, -0.02673533110794557, 0.018676929763984353, -0.01287910609330644, 0.005042839233882015],
        [0.15377523147918246, 0.14621486784749352, -0.03644456890512809, 0.02123306311930472, -0.007935579902728777],
        [0.14006304568480987, 0.29896712949128346, 0.16758507013524895, -0.03396910168661774, 0.010944288744192253],
        [0.14489430810953477, 0.2765000687601592, 0.32579792291042103, 0.12875675325490976, -0.015708917378805327],
        [0.14371356079122594, 0.28135601514946207, 0.31182652297574126, 0.22310390108357075, 0.04],
    ]
)
INVERSE = np.array(
    [
        [8.755923977938362, 2.8919426153801173, -0.8751863962002651, 0.3997052079399655, -0.13370616384921583],
        [-7.161380720145387, 1.8060777240836443, 2.3637971760686085, -0.8659007802831346, 0.2743380777751942],
        [4.122165246243374, -4.4960171258133945, 0.8567652453971776, 2.5183209492110645, -0.6570627571343601],
        [-3.8786632197240105, 3.3931519180649543, -5.188340906407187, 0.5812330525808164, 2.809983655279712],
        [8.41242422359429, -6.970256116656661, 8.777114204150473, -18.2192823110881, 13.0],
    ]
)
"""Inverse of MATRIX, which Newton's method for the stages of a step needs."""
TO_START = np.array([1.5864079001863283, -1.008117881498373, 0.7309748661597875, -0.5092648848477427, 0.2])
"""Weights whose sum over the values of a quantity at the five stages extrapolates that quantity to the start of the
step.
"""
TO_POLYNOMIAL = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-25.0, 27.78093394406464, -3.641478498049213, 1.2525477211691187, -0.5920031671845428, 0.2],
        [150.0, -208.02785730090133, 77.88337605511782, -29.167414317829696, 14.111895563613205, -4.8],
        [-350.0, 524.1878839694918, -264.89491356822634, 137.90290440413477, -72.39587480540027, 25.2],
        [350.0, -543.8283560361325, 317.67586907995275, -202.09087094360743, 123.04335789978718, -44.8],
        [-126.0, 199.88739542347736, -127.022853068795, 92.10283313613321, -64.16737549081559, 25.2],
    ]
)
"""Matrix from six values of a quantity, at the start and at the five stages of a step, to the six coefficients of the
polynomial through them. Its variable is 0 at the start and 1 at the end of the step; the constant coefficient comes
first.
"""
REAL_EIGENVALUE = 0.15906584442746913
"""Real eigenvalue of MATRIX. The error estimate of a step is filtered with it, so that motion which decays within the
step hardly counts.
"""

POINTS = 8
GAUSS_NODES = np.array(
    [
        -0.9602898564975363, -0.7966664774136267, -0.525532409916329, -0.1834346424956498,
        0.1834346424956498, 0.525532409916329, 0.7966664774136267, 0.9602898564975363,
    ]
)  # fmt: skip
GAUSS_WEIGHTS = np.array(
    [
        0.10122853629037626, 0.22238103445337448, 0.31370664587788727, 0.362683783378362,
        0.362683783378362, 0.31370664587788727, 0.22238103445337448, 0.10122853629037626,
    ]
)  # fmt: skip
