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
"""Step (resolution) of imported values: the spacing that is due to a converter, to integers or to few digits.

No file format states the step reliably, because values are scaled, printed and truncated before they are imported. It
is computed from the values themselves: all differences of the values are integer multiples of the step (Euclid's
algorithm).
"""

from __future__ import annotations

import math

import numpy as np

from impact_rig_studies.importing.signals import Real

SAMPLES = 20_000  # number of samples used, the last ones of a signal
REPEATED, ALIKE = 12, 1e-9
"""Number of samples after which a sine at 1/2, 1/3, 1/4 or 1/6 of the rate repeats: its values are commensurable
without a step. The second number is the allowed relative departure.
"""
FEW = 20  # number of levels up to which small values count, too
CHANCE = 1e-9  # probability that differences are multiples of a number within their rounding although there is no step


def step_of(values: Real) -> float:
    """Return the step of a signal's values, in their unit; 0 if no step is found.

    All differences of the values are multiples of the step. Only the last `SAMPLES` values are used. Values below half
    of the largest absolute value are ignored if the larger values have more than `FEW` levels. The result is also 0 for
    few values, or if they repeat after every `REPEATED` samples.
    """
    values = values[-SAMPLES:]
    values = values[np.isfinite(values)]
    size = float(np.abs(values).max(initial=0.0))
    if len(values) <= 2 * REPEATED or np.all(np.abs(values[REPEATED:] - values[:-REPEATED]) <= ALIKE * size):
        return 0.0
    large = np.unique(values[np.abs(values) >= 0.5 * size])
    apart = np.diff(large if len(large) > FEW else np.unique(values))
    step = _common_divisor(apart, 2.0 * float(np.spacing(size)))
    for rounding in (2.0 * float(np.spacing(np.float32(size))), step):
        # for numbers in single precision, or printed with more digits than the step needs
        if rounding > 0.0:
            step = max(step, _common_divisor(apart, rounding))
    return step


def _common_divisor(apart: Real, rounding: float) -> float:
    """Return the largest number of which all differences in `apart` are multiples; 0 if there is none.

    `rounding` is the uncertainty of a difference. Differences up to `rounding` are ignored. The result is also 0 if the
    differences may be multiples by chance (`CHANCE`).
    """
    apart = np.sort(apart[apart > rounding])
    step = float(apart[0]) if len(apart) else 0.0
    while step > rounding:
        multiples = apart / step
        within = rounding * (1.0 + multiples)  # the step is as uncertain as the difference from which it was found
        rest = np.abs(apart - step * np.round(multiples))
        uneven = rest[rest > within]
        if not len(uneven):
            chance = float(np.sum(np.log(np.minimum(2.0 * within[1:] / step, 1.0))))
            return step if chance < math.log(CHANCE) else 0.0
        step = float(uneven.min())
    return 0.0
