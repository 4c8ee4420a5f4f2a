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
"""A campaign small enough for every test, and the comparison of two outcomes."""

from __future__ import annotations

import numpy as np

from impact_rig_studies.campaign.job import Outcome

TINY = """\
title: tiny
analysis: {settle_tolerance: 0.01}
studies:
  pair: {frequencies_hz: [9.1, 9.5], gaps_m: [0.006], traces: true}
  sweep: {frequencies_hz: [9.0, 9.2], gaps_m: [0.003], direction: up_down}
  again: {frequencies_hz: 9.1, gaps_m: 0.006, laws: [flores, exact]}
  trip: {frequencies_hz: 9.1, gaps_m: none, currents_a: 18}
  refused: {frequencies_hz: 9.1, gaps_m: none, currents_a: 50}
"""


def assert_same(one: Outcome, other: Outcome) -> None:
    """Compare the values that determine a campaign's numbers, bit for bit (NaN equals NaN)."""
    assert one.failure == other.failure
    assert one.skipped_hz == other.skipped_hz
    assert one.simulated_s == other.simulated_s
    assert len(one.rows) == len(other.rows)
    for name in one.rows.dtype.names or ():
        np.testing.assert_array_equal(one.rows[name], other.rows[name], err_msg=name, strict=True)
    assert set(one.trace) == set(other.trace)
    for name, column in one.trace.items():
        np.testing.assert_array_equal(column, other.trace[name], err_msg=name, strict=True)
