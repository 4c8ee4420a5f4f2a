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
"""Part of `qualification/coverage_of_uncertainties.py`: rows of the rig's instruments compared with the truth.

It includes a point of `qualification/resting_places.py`.
"""

from __future__ import annotations

import runpy
from pathlib import Path

import attrs
import numpy as np
import pytest
from scipy.stats import chi2

from impact_rig.analysis.settings import TrackerSettings

TOOLS = Path(__file__).parents[2] / "qualification"
TOOL = runpy.run_path(str(TOOLS / "coverage_of_uncertainties.py"))
PLACES = runpy.run_path(str(TOOLS / "resting_places.py"))
SEEDS = range(1, 17)
CHANCE = 1e-4


def judged(case, seeds=SEEDS):
    _, cells, refused = TOOL["judged"](case, seeds)
    return {name: np.array([one.error / one.u for one in found]) for name, found in cells.items()}, refused


@pytest.mark.parametrize(("bits", "seeds"), [(12, 6), (16, 16), pytest.param(12, 16, marks=pytest.mark.slow)])
@pytest.mark.repeats
def test_errors_of_reductions_agree_with_their_stated_uncertainty(bits, seeds):
    """At 16 bits, errors scatter: a sum of (error/u)² is a chi-square. At 12 bits, steps limit them: few exceed 2u."""
    case = next(case for case in TOOL["reduction_cases"]() if case.label == (f"{bits}",))
    found, _ = judged(
        attrs.evolve(case, gaps_m=(0.0, 0.008, 0.002), span_s=14.0), range(1, seeds + 1)
    )  # time for two rows
    assert set(found) == {(f"{bits}", gap, count) for gap in ("2", "8") for count in ("1", "2")}
    low, high = chi2.ppf((CHANCE, 1.0 - CHANCE), seeds)
    for name, off in found.items():
        assert np.sum(off**2) < high, (name, off)
        assert bits < 16 or np.sum(off**2) > low, (name, off)


@pytest.mark.parametrize(
    ("base_um", "bits", "noise", "measured"),
    [("50", "12", "on", True), ("5", "16", "on", True), ("5", "16", "off", True), ("2", "12", "on", False)],
)
@pytest.mark.repeats
def test_small_signals_are_covered_by_their_uncertainty_or_rejected(base_um, bits, noise, measured):
    """At 6 Hz, x_1 is 1.8 times the base: 9 µm or less with laser steps of 8 µm, 4 µm with converter steps of 10 µm."""
    case = next(case for case in TOOL["small_cases"]((6.0,)) if case.label[1:] == (base_um, bits, noise))
    found, refused = judged(case)
    if not measured:
        assert found == {}
        assert set(refused) <= {"below_resolution", "constant", "no_signal", "silence", "too_uncertain"}
        return
    for name, off in found.items():
        assert len(off) >= len(SEEDS) - 2
        assert np.mean(np.abs(off) <= 2.0) >= 0.75, (name, off)


@pytest.mark.heavy
def test_a_sphere_that_drifts_for_twenty_seconds_is_not_called_at_rest():
    """At 18 mm and 10.85 Hz, it leaves a wall at less than 1 mm/s: a wait of 16 s would miss its next impact."""
    config = PLACES["configuration"](18.0)
    (motion,) = PLACES["driven"](config, 10.85, 40.0)
    struck, _ = PLACES["strikes"]([motion])
    deceived = PLACES["ends_of_rest"](config, 10.85, motion, TrackerSettings(slowest_speed=1e-3))
    assert deceived
    assert struck.max() > deceived[-1]
    assert PLACES["ends_of_rest"](config, 10.85, motion, TrackerSettings()) == []
