# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A slice of `tools/coverage_of_reductions.py`: reductions through the rig's own instruments, drawn anew, and truth."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

TOOL = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "coverage_of_reductions.py"))
CHANCE = 1e-4


@pytest.mark.parametrize("seeds", [12, pytest.param(48, marks=pytest.mark.slow)])
@pytest.mark.repeats
def test_reductions_are_off_by_what_they_state(seeds):
    """The sum of (error/u)² over sets of instruments is a chi-square, at both gaps, from one row and from two."""
    found = {}
    for seed in range(1, seeds + 1):
        for gap_m, count, one in TOOL["deviations"](10_000, seed):
            found.setdefault((gap_m, count), []).append((one.error / one.u) ** 2)
    assert set(found) == {(gap_m, count) for gap_m in (0.002, 0.008) for count in (1, 2)}
    low, high = chi2.ppf((CHANCE, 1.0 - CHANCE), seeds)
    assert all(low < np.sum(squares) < high for squares in found.values()), {k: np.mean(v) for k, v in found.items()}
