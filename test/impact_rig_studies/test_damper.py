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
"""Energy that the impacts take from the structure, from DT with and without the sphere: it agrees joule by joule."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.tracker import Tracker
from impact_rig.rig.config import RigConfig
from impact_rig.testing import LocalRig
from impact_rig_studies.reduction import damper_effect

FREQUENCY_HZ, CURRENT_A, SECONDS = 9.1, 0.52, 20.0


def measured(parameters: dict[str, object]) -> tuple[NDArray[np.void], LocalRig]:
    """Return the last settled row of a rig, and the rig itself."""
    rig = LocalRig({"daq.rate_hz": 5000, "daq.block_scans": 500, **parameters})
    rig.command(frequency_hz=FREQUENCY_HZ, current_a=CURRENT_A)
    rig.run(SECONDS)
    tracker = Tracker()
    tracker.configure(rig.tables(topics.INFO.name)[0])
    for table in rig.tables(topics.APPLIED.name):
        tracker.on_applied(table)
    rows = [row for scan in rig.tables() for table in tracker.feed(scan).measurements for row in table.rows]
    return np.array([[row for row in rows if row["settled"]][-1]]), rig


@pytest.mark.heavy
@pytest.mark.parametrize("gap_m", [0.004, 0.006])
def test_the_loss_factor_agrees_with_the_energy_lost_in_impacts(gap_m: float) -> None:
    without, _ = measured({"sphere.present": False})
    row, rig = measured({"barriers.gap_m": gap_m})
    found = damper_effect(without, row, Calibration.from_info(rig.tables(topics.INFO.name)[0].rows))
    cycles = 40
    end = rig.time_s
    lost = sum(
        float(table.rows["energy_lost"].sum())
        for table in rig.tables(topics.IMPACTS_TRUTH.name)
        if end - cycles / FREQUENCY_HZ < table.stamp_ns / 1e9 <= end
    )
    stored = 0.5 * RigConfig().structure.mass_kg * (2 * math.pi * FREQUENCY_HZ * float(row["laser_amplitude"][0])) ** 2
    truth = lost / cycles / (2 * math.pi * stored)
    assert abs(found.loss_factor - truth) <= 3 * found.u_loss_factor + 0.02 * truth
    assert 0.0 < found.added_mass < 0.02
