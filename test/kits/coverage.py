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
"""Comparison of stated uncertainties with the spread of draws, with fewer draws than counting alone would need."""

from __future__ import annotations

import numpy as np

WITHIN_2U = 0.9545


def assert_covers(off):
    """Assert that deviations divided by their standard uncertainties, shape (n, quantities), have the stated size.

    Their root mean square must be 1 within three of its own standard deviations, and the right share must be within ±2.
    With 300 draws, the first detects an uncertainty that is wrong by 12 %; counting alone would need 1,200.
    """
    off = np.asarray(off)
    spread, shares = np.sqrt(np.mean(np.square(off), axis=0)), np.mean(np.abs(off) < 2.0, axis=0)
    assert np.all(np.abs(spread - 1.0) < 3.0 / np.sqrt(2.0 * len(off))), spread
    assert np.all(np.abs(shares - WITHIN_2U) < 3.0 * np.sqrt(WITHIN_2U * (1.0 - WITHIN_2U) / len(off))), shares
