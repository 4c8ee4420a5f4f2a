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
"""Prediction compared with measurements through the rig's own instruments and analysis, as in a campaign."""

from __future__ import annotations

import math

import attrs
import numpy as np
import pytest

from impact_rig_studies.campaign.job import execute
from qualification.prediction import Compared, compared, job

WITHIN, WITHIN_DEGREES = 0.01, 2.0


def by_test(frequency_hz: float, gap_m: float) -> Compared:
    one = job(frequency_hz, gap_m)
    return compared(one, execute(one))


@pytest.mark.parametrize(
    ("frequency_hz", "gap_mm"), [(8.8, 12.0), (8.8, 26.0), (9.1, 12.5), (9.1, 30.0), (9.4, 12.0), (9.4, 26.0)]
)
def test_motions_with_two_symmetric_impacts_agree_with_the_prediction(frequency_hz, gap_mm):
    found = by_test(frequency_hz, gap_mm * 1e-3)
    assert found.two_per_cycle
    assert found.predicted_dt == pytest.approx(found.dt, rel=WITHIN)
    assert math.degrees(found.predicted_phase_rad - found.phase_rad) == pytest.approx(0.0, abs=WITHIN_DEGREES)


@pytest.mark.heavy
@pytest.mark.parametrize(("frequency_hz", "gap_mm"), [(8.8, 28.0), (9.4, 28.0), (9.1, 32.0)])
def test_no_motion_with_two_impacts_is_found_where_none_is_predicted(frequency_hz, gap_mm):
    found = by_test(frequency_hz, gap_mm * 1e-3)
    assert not found.predicted
    assert not found.two_per_cycle


def test_an_unsettled_point_is_reported():
    one = attrs.evolve(job(9.1, 20e-3), current_a=40.0)
    found = compared(one, execute(one))
    assert np.isnan(found.dt)
    assert found.regime == ""
    assert not found.two_per_cycle
